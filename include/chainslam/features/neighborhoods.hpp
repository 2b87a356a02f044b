#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

/// For each point of a cloud those nearby, itself among them: searched for once, and kept for all that is computed from
/// them.
template <class Scalar>
class Neighborhoods {
 public:
  Neighborhoods() = default;

  /// @param cloud          n points, metres; one that is not finite has no neighbours.
  /// @param search         over the same points: its indices are the cloud's.
  /// @param radius         metres; neighbours are not farther.
  /// @param max_neighbors  the nearest of them, the point itself counted; 0: all.
  /// @throws std::invalid_argument if `radius` is not positive or `max_neighbors` negative.
  template <NearestNeighborSearch Search, Executor Exec = Serial>
  Neighborhoods(const PointCloud<float>& cloud, const Search& search, double radius, Index max_neighbors,
                const Exec& executor = {})
      : radius_(radius), size_(to_index(cloud.size(), "cloud")) {
    if (!(radius > 0) || max_neighbors < 0)
      throw std::invalid_argument("Neighborhoods: radius must be positive, max_neighbors not negative");
    blocks_.resize(static_cast<std::size_t>(detail::count_chunks(size_, block_size)));
    executor.for_chunks(size_, block_size, [&](Index begin, Index end) {
      Block& block = blocks_[static_cast<std::size_t>(begin / block_size)];
      std::vector<Neighbor<Scalar>> found;
      for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
        find(search, cloud.positions[i], max_neighbors, found);
        block.neighbors.insert(block.neighbors.end(), found.begin(), found.end());
        block.end.push_back(block.neighbors.size());
      }
    });
  }

  /// Points.
  [[nodiscard]] Index size() const { return size_; }
  [[nodiscard]] double radius() const { return radius_; }
  [[nodiscard]] std::span<const Neighbor<Scalar>> operator[](Index i) const {
    const Block& block = blocks_[static_cast<std::size_t>(i / block_size)];
    const auto place = static_cast<std::size_t>(i % block_size);
    const std::size_t begin = place == 0 ? 0 : block.end[place - 1];
    return std::span(block.neighbors).subspan(begin, block.end[place] - begin);
  }

 private:
  static constexpr Index block_size = 256;
  struct Block {
    std::vector<Neighbor<Scalar>> neighbors;  ///< point after point
    std::vector<std::size_t> end;             ///< of each point's
  };

  template <class Search>
  void find(const Search& search, const Eigen::Vector3f& at, Index max_neighbors,
            std::vector<Neighbor<Scalar>>& found) const {
    const Eigen::Matrix<Scalar, 3, 1> point(static_cast<Scalar>(at[0]), static_cast<Scalar>(at[1]),
                                            static_cast<Scalar>(at[2]));
    found.clear();
    if (!is_finite(at)) return;
    if (max_neighbors == 0) return search.within(point, static_cast<Scalar>(radius_), found);
    found.resize(static_cast<std::size_t>(max_neighbors));
    found.resize(static_cast<std::size_t>(search.knn(point, found, static_cast<Scalar>(radius_))));
  }

  double radius_ = 0;
  Index size_ = 0;
  std::vector<Block> blocks_;
};

template <NearestNeighborSearch Search, class... Rest>
Neighborhoods(const PointCloud<float>&, const Search&, Rest&&...) -> Neighborhoods<typename Search::Scalar>;

namespace detail {

/// The plane through the neighbours of point i that are within the options' radius, or the nearest of them. Sums are
/// taken about the point itself, in double: the neighbours are near it, so a single pass loses nothing.
template <class Scalar>
[[nodiscard]] PlaneFit plane_of(const PointCloud<float>& cloud, Index i, std::span<const Neighbor<Scalar>> neighbors,
                                const NormalOptions& options, std::vector<Neighbor<Scalar>>& nearest) {
  const double squared_radius = options.radius * options.radius;
  if (options.neighbors > 0) {
    nearest.assign(neighbors.begin(), neighbors.end());
    const auto wanted = static_cast<std::size_t>(options.neighbors);
    if (nearest.size() > wanted) {
      std::nth_element(nearest.begin(), nearest.begin() + options.neighbors, nearest.end(),
                       [](const auto& a, const auto& b) { return a.squared_distance < b.squared_distance; });
      nearest.resize(wanted);
    }
    neighbors = nearest;
  }
  const Eigen::Vector3f& center = cloud.positions[static_cast<std::size_t>(i)];
  double x = 0, y = 0, z = 0, xx = 0, xy = 0, xz = 0, yy = 0, yz = 0, zz = 0;
  Index count = 0;
  for (const Neighbor<Scalar>& neighbor : neighbors) {
    if (!(static_cast<double>(neighbor.squared_distance) <= squared_radius)) continue;
    const Eigen::Vector3f& p = cloud.positions[static_cast<std::size_t>(neighbor.index)];
    const std::array<double, 3> d{static_cast<double>(p[0] - center[0]), static_cast<double>(p[1] - center[1]),
                                  static_cast<double>(p[2] - center[2])};
    x += d[0];
    y += d[1];
    z += d[2];
    xx += d[0] * d[0];
    xy += d[0] * d[1];
    xz += d[0] * d[2];
    yy += d[1] * d[1];
    yz += d[1] * d[2];
    zz += d[2] * d[2];
    ++count;
  }
  if (count < std::max(options.min_neighbors, Index{3})) return {};
  const double share = 1.0 / count;
  const Eigen::Vector3d mean(x * share, y * share, z * share);
  const auto about_mean = [&](double products, int row, int column) {
    return products * share - mean[row] * mean[column];
  };
  const Eigen::Matrix3d covariance = symmetric_matrix(about_mean(xx, 0, 0), about_mean(xy, 0, 1), about_mean(xz, 0, 2),
                                                      about_mean(yy, 1, 1), about_mean(yz, 1, 2), about_mean(zz, 2, 2));
  return fit_plane(position(cloud, static_cast<std::size_t>(i)) + mean, covariance);
}

}  // namespace detail

/// `estimate_normals` for a cloud whose neighbourhoods are known: no search. Of them it takes those that `options`
/// name, which cannot be farther than the neighbourhoods reach.
///
/// @throws std::invalid_argument if the neighbourhoods are not the cloud's.
template <class Scalar, Executor Exec = Serial>
NormalEstimates estimate_normals(PointCloud<float>& cloud, const Neighborhoods<Scalar>& neighborhoods,
                                 const NormalOptions& options,
                                 const Eigen::Vector3d& viewpoint = Eigen::Vector3d::Zero(),
                                 const Exec& executor = {}) {
  constexpr Index grain = 256;
  const Index size = to_index(cloud.size(), "cloud");
  if (neighborhoods.size() != size)
    throw std::invalid_argument("estimate_normals: the neighbourhoods are of another cloud");
  NormalEstimates estimates;
  cloud.normals.assign(cloud.size(), Eigen::Vector3f::Zero());
  estimates.planarity.assign(cloud.size(), 0.0F);
  estimates.curvature.assign(cloud.size(), 0.0F);
  const auto estimate_chunk = [&](Index begin, Index end) {
    std::vector<Neighbor<Scalar>> scratch;
    Index without = 0;
    for (Index i = begin; i < end; ++i) {
      const PlaneFit plane = detail::plane_of(cloud, i, neighborhoods[i], options, scratch);
      if (!plane.good()) {
        ++without;
        continue;
      }
      const auto at = static_cast<std::size_t>(i);
      cloud.normals[at] = detail::turned_towards(viewpoint, position(cloud, at), plane.normal);
      estimates.planarity[at] = static_cast<float>(plane.planarity());
      estimates.curvature[at] = static_cast<float>(plane.curvature());
    }
    return without;
  };
  estimates.without_normal = reduce_chunks(executor, size, grain, Index{0}, estimate_chunk,
                                           [](Index left, Index right) { return left + right; });
  return estimates;
}

}  // namespace chainslam
