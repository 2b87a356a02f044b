#pragma once

#include <Eigen/Core>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/kd_tree.hpp"

namespace chainslam {

/// Which neighbours a point's normal is taken from: the `neighbors` nearest, the point itself counted, of those within
/// `radius`.
struct NormalOptions {
  Index neighbors = 20;                                     ///< 0: all within `radius`
  double radius = std::numeric_limits<double>::infinity();  ///< metres
  Index min_neighbors = 5;                                  ///< with fewer, a point gets no normal
};

/// What `estimate_normals` learned besides the normals, for each point.
struct NormalEstimates {
  std::vector<float> planarity;  ///< (l1 - l0) / l2 in [0, 1], see `PlaneFit`; 0 without a normal
  std::vector<float> curvature;  ///< l0 / (l0 + l1 + l2) in [0, 1/3]; 0 without a normal
  Index without_normal = 0;      ///< points that got none: isolated, on a line, NaN
};

namespace detail {

/// The plane through a point's neighbours; `neighbors` and `positions` are scratch memory.
template <NearestNeighborSearch Search>
[[nodiscard]] PlaneFit plane_at(const Search& search, const Eigen::Matrix<typename Search::Scalar, 3, 1>& point,
                                const NormalOptions& options, std::vector<Neighbor<typename Search::Scalar>>& neighbors,
                                std::vector<Eigen::Matrix<typename Search::Scalar, 3, 1>>& positions) {
  const auto radius = static_cast<typename Search::Scalar>(options.radius);
  if (options.neighbors > 0) {
    neighbors.resize(static_cast<std::size_t>(options.neighbors));
    neighbors.resize(static_cast<std::size_t>(search.knn(point, neighbors, radius)));
  } else {
    search.within(point, radius, neighbors);
  }
  if (static_cast<Index>(neighbors.size()) < options.min_neighbors) return {};
  positions.clear();
  for (const auto& neighbor : neighbors) positions.push_back(search.position(neighbor.index));
  return fit_plane(positions);
}

}  // namespace detail

/// Fills `cloud.normals`: for each point the normal of the least-squares plane through its neighbours (Hoppe et al.
/// 1992), turned towards the viewpoint.
///
/// A point whose surroundings are no plane gets the zero vector: as a target of point-to-plane registration it then
/// counts for nothing. The result is the same to the bit for any executor.
/// @param cloud      n points, metres; NaN points get the zero vector.
/// @param search     over the points to take neighbours from, usually the cloud's own, in the same frame.
/// @param viewpoint  where the points were seen from, same frame, metres: the origin for a scan in the sensor's frame.
/// @throws std::invalid_argument if the options set neither a number of neighbours nor a radius.
template <NearestNeighborSearch Search, Executor Exec = Serial>
NormalEstimates estimate_normals(PointCloud<float>& cloud, const Search& search, const NormalOptions& options = {},
                                 const Eigen::Vector3d& viewpoint = Eigen::Vector3d::Zero(), const Exec& exec = {}) {
  constexpr Index grain = 256;
  using Scalar = typename Search::Scalar;
  if (options.neighbors < 0 || !(options.radius > 0) || (options.neighbors == 0 && !is_finite(options.radius)))
    throw std::invalid_argument("estimate_normals: set neighbors > 0, or a finite radius > 0");
  const Index count = to_index(cloud.size(), "cloud");
  NormalEstimates estimates;
  cloud.normals.assign(cloud.size(), Eigen::Vector3f::Zero());
  estimates.planarity.assign(cloud.size(), 0.0f);
  estimates.curvature.assign(cloud.size(), 0.0f);

  const auto estimate_chunk = [&](Index begin, Index end) {
    std::vector<Neighbor<Scalar>> neighbors;
    std::vector<Eigen::Matrix<Scalar, 3, 1>> positions;
    Index without = 0;
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      const Eigen::Matrix<Scalar, 3, 1> point = cloud.positions[i].cast<Scalar>();
      const PlaneFit plane = detail::plane_at(search, point, options, neighbors, positions);
      if (!plane.good()) {
        ++without;
        continue;
      }
      const bool away = plane.normal.dot(viewpoint - position(cloud, i)) < 0;
      cloud.normals[i] = (away ? Eigen::Vector3d(-plane.normal) : plane.normal).cast<float>();
      estimates.planarity[i] = static_cast<float>(plane.planarity());
      estimates.curvature[i] = static_cast<float>(plane.curvature());
    }
    return without;
  };
  estimates.without_normal =
      reduce_chunks(exec, count, grain, Index{0}, estimate_chunk, [](Index left, Index right) { return left + right; });
  return estimates;
}

/// The same among the cloud's own points, over a tree that is built for it.
template <Executor Exec = Serial>
NormalEstimates estimate_normals(PointCloud<float>& cloud, const NormalOptions& options = {},
                                 const Eigen::Vector3d& viewpoint = Eigen::Vector3d::Zero(), const Exec& exec = {}) {
  return estimate_normals(cloud, KdTree<float>(cloud), options, viewpoint, exec);
}

}  // namespace chainslam
