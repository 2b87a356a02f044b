#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cassert>
#include <cstddef>
#include <limits>
#include <memory>
#include <mutex>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "chainslam/search/leaf_neighbors.hpp"

namespace chainslam {

/// A cloud with the search over its points, as `IndexedCloud`, whose normals are estimated once someone asks for one
/// nearby: what registration takes as a target that meets one source only, which matches a part of it. A target that
/// meets many is better given its normals at once, as an `IndexedCloud`.
///
/// The normals are those of `estimate_normals`, to the bit, in whatever order they are asked for. Const calls may run
/// at the same time on several threads, `normal` among them.
class OrientedOnDemand {
 public:
  using Search = KdTree<float>;  ///< the search over the points
  using Scalar = float;          ///< number type

  /// @param cloud      n points, metres; normals that it has are not looked at.
  /// @param options    `covariances` are not given.
  /// @param viewpoint  where the points were seen from, same frame, metres.
  /// @throws std::invalid_argument as `estimate_normals`.
  explicit OrientedOnDemand(PointCloud<float> cloud, const NormalOptions& options = {.neighbors = 10},
                            const Eigen::Vector3d& viewpoint = Eigen::Vector3d::Zero())
      : options_(options), viewpoint_(viewpoint), cloud_(std::move(cloud)), search_(cloud_) {
    detail::check(options_);
    options_.covariances = false;
    cloud_.normals.assign(cloud_.size(), Eigen::Vector3f::Zero());
    const Index groups = detail::count_chunks(detail::TreeLeaves(search_).count(), detail::leaves_at_once);
    estimated_ = std::make_unique<std::once_flag[]>(static_cast<std::size_t>(groups));
  }

  [[nodiscard]] const Search& search() const { return search_; }  ///< the search over the points
  /// Points that can be found: those of the cloud that are finite.
  [[nodiscard]] std::size_t size() const { return search_.size(); }
  [[nodiscard]] static constexpr bool has_normals() { return true; }  ///< whether there is a normal for each point

  /// Position of point i, metres.
  [[nodiscard]] const Eigen::Vector3f& position(Index i) const { return cloud_.positions[static_cast<std::size_t>(i)]; }
  /// Of a point that can be found.
  [[nodiscard]] const Eigen::Vector3f& normal(Index i) const {
    assert(search_.contains(i));
    const Index group = detail::TreeLeaves(search_).leaf_of(i) / detail::leaves_at_once;
    std::call_once(estimated_[static_cast<std::size_t>(group)], [&] { estimate(group); });
    return cloud_.normals[static_cast<std::size_t>(i)];
  }

  /// As `NearestNeighborSearch` has it.
  Index knn(const Eigen::Vector3f& query, std::span<Neighbor<float>> out,
            float max_distance = std::numeric_limits<float>::infinity()) const {
    return search_.knn(query, out, max_distance);
  }
  /// As `NearestNeighborSearch` has it.
  void within(const Eigen::Vector3f& query, float radius, std::vector<Neighbor<float>>& out) const {
    search_.within(query, radius, out);
  }

 private:
  void estimate(Index group) const {
    const Index begin = group * detail::leaves_at_once;
    const Index end = std::min(begin + detail::leaves_at_once, detail::TreeLeaves(search_).count());
    NormalEstimates no_estimates;
    (void)detail::estimate_in_leaves(search_, detail::NormalWriter{cloud_, no_estimates, options_, viewpoint_}, begin,
                                     end);
  }

  NormalOptions options_;
  Eigen::Vector3d viewpoint_;
  mutable PointCloud<float> cloud_;  ///< the normals of a group are written once, before they are read
  Search search_;
  mutable std::unique_ptr<std::once_flag[]> estimated_;  ///< of each group of leaves
};
static_assert(OrientedSearch<OrientedOnDemand>);

}  // namespace chainslam
