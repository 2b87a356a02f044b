#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/transform.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/voxel_map.hpp"

namespace chainslam {

namespace detail {

/// Points of the local map about half a metre apart.
template <class Downsampling>
[[nodiscard]] constexpr Downsampling half_metre_apart() {
  if constexpr (std::is_same_v<Downsampling, VoxelMapOptions>)
    return {.voxel_size = 1.0, .max_points_per_voxel = 8, .min_spacing = 0.35};
  else
    return {.voxel_size = 0.5};
}

}  // namespace detail

/// How much of the past a local map holds.
struct LocalMapOptions {
  double radius = 150;                 ///< metres around the body, half the edge of the cube that is kept
  std::size_t max_points = 4'000'000;  ///< beyond, the cube shrinks until what is left fits
};

/// The surroundings that scans are registered to: a search structure that grows with every scan, cut to a cube around
/// the body (FAST-LIO2, section V-A) and to a number of points, so that its memory is bounded however long the drive.
template <IncrementalSearch Map>
class LocalMap {
 public:
  /// How the map downsamples.
  using Downsampling = std::remove_cvref_t<decltype(std::declval<const Map&>().downsampling())>;

  /// An empty map.
  explicit LocalMap(const Downsampling& downsampling = {}, const LocalMapOptions& options = {})
      : options_(options), points_(downsampling) {}

  /// @param scan  body frame. @param T_odom_body  of the scan.
  void extend(const PointCloud<float>& scan, const SE3d& T_odom_body) {
    points_.insert(transformed(scan.positions, T_odom_body));
    const Eigen::Vector3d& center = T_odom_body.translation();
    if (difference_of(center, center_).norm() >= 0.1 * options_.radius) {
      cut(center, options_.radius);
      center_ = center;
    }
    for (double radius = 0.9 * options_.radius; points_.size() > options_.max_points && radius > 1; radius *= 0.9)
      evicted_ += cut(center, radius);
  }

  /// Forgets all points.
  void clear() { points_ = Map(points_.downsampling()); }

  [[nodiscard]] const Map& points() const { return points_; }  ///< the points, in the map's own frame
  /// How many points had to go because there were too many.
  [[nodiscard]] std::int64_t evicted() const { return evicted_; }

 private:
  Index cut(const Eigen::Vector3d& center, double radius) {
    using Box = SearchBox<Map>;
    using Vector = SearchVector<Map>;
    const Eigen::Vector3d half(radius, radius, radius);
    return points_.erase_outside(Box(Vector(converted<typename Map::Scalar>(difference_of(center, half))),
                                     Vector(converted<typename Map::Scalar>(sum_of(center, half)))));
  }

  LocalMapOptions options_;
  Map points_;
  Eigen::Vector3d center_ = Eigen::Vector3d::Zero();  ///< where the map was last cut to its cube
  std::int64_t evicted_ = 0;
};

}  // namespace chainslam
