#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/detail/range_image.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam {

/// The direction in which an alignment determines the position least.
struct WeakestDirection {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitX();  ///< unit vector in the source's frame
  /// As `AlignResult::localizability`, over all directions instead of the axes, per inlier.
  double localizability = 1.0;
};

/// @returns 1 for the localizability if the result has no eigenvalues.
[[nodiscard]] [[gnu::cold]] inline WeakestDirection weakest_direction(const AlignResult& result) {
  constexpr double least = 1e-3;  // lest a direction that leans by a hair towards an unknown one be lost with it
  if (!(result.eigenvalues[5] > 0)) return {};
  Eigen::Matrix3d variance = zeros<Eigen::Matrix3d>();
  for (int i = 0; i < 6; ++i)
    for (int k = 0; k < 9; ++k)
      variance(k / 3, k % 3) +=
          result.eigenvectors(k / 3, i) * result.eigenvectors(k % 3, i) / std::max(result.eigenvalues[i], least);
  const SymmetricEigen3 eigen = symmetric_eigen(variance);
  return {block_of<3, 1>(eigen.vectors, 0, 2), 1.0 / eigen.values[2]};
}

/// Whether a source comes back to its pose when it is aligned from `shift` metres to either side, in the direction that
/// the alignment determines least. Along a street that is the same for a long way, it stays about where it starts.
/// @param distance  metres from the pose within which it has to come back.
template <class Registration, class Source, class Target, Executor Exec = Serial>
[[nodiscard]] [[gnu::cold]] bool is_repeatable(const Registration& registration, const Source& source,
                                               const Target& target, const AlignResult& result, double shift,
                                               double distance, const Exec& executor = {}) {
  for (const double side : {shift, -shift}) {
    const SE3d shifted = result.T_target_source * SE3d(SO3d(), scaled(side, weakest_direction(result).direction));
    const AlignResult again = registration.align(source, target, shifted, executor);
    const SE3d off = result.T_target_source.inverse() * again.T_target_source;
    const bool ended = again.status == AlignStatus::converged || again.status == AlignStatus::degenerate;
    if (!ended || !(off.translation().norm() <= distance)) return false;
  }
  return true;
}

/// How much of two clouds lies together at a pose.
struct Overlap {
  Index inliers = 0;           ///< source points whose nearest target point is near enough
  double share_of_source = 0;  ///< inliers over finite source points, in [0, 1]
  double share_of_target = 0;  ///< inliers over target points; above 1 if the source is that much denser
  double rmse = 0;             ///< of the inliers' distances, metres
};

/// Counts the source points that T_target_source brings to within `max_distance`, metres, of a target point.
///
/// @param source  points in the source's frame; NaN and infinite points are skipped.
/// @param target  search over points in the target's frame.
/// @returns the same to the bit for any executor.
/// @throws std::invalid_argument if `max_distance` is not positive or the pose is not finite.
template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
[[nodiscard]] Overlap measure_overlap(const Source& source, const Target& target, const SE3d& T_target_source,
                                      double max_distance, const Exec& executor = {}) {
  using Scalar = typename Target::Scalar;
  struct Sums {
    Index points = 0, inliers = 0;
    double squared_distance = 0;
  };
  if (!(max_distance > 0)) throw std::invalid_argument("measure_overlap: max_distance must be positive");
  const Eigen::Matrix3d R = T_target_source.rotation().matrix();
  if (!is_finite(T_target_source.translation()) || !is_finite(R))
    throw std::invalid_argument("measure_overlap: the pose is not finite");
  constexpr Index grain = 512;
  const Eigen::Vector3d t = T_target_source.translation();
  const auto sum_chunk = [&](Index begin, Index end) {
    Sums sums;
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      const Eigen::Vector3d p = product(R, position(source, i)) + t;
      if (!is_finite(p)) continue;
      ++sums.points;
      Neighbor<Scalar> nearest;
      const Eigen::Matrix<Scalar, 3, 1> query(static_cast<Scalar>(p[0]), static_cast<Scalar>(p[1]),
                                              static_cast<Scalar>(p[2]));
      if (target.knn(query, {&nearest, 1}, static_cast<Scalar>(max_distance)) == 0) continue;
      ++sums.inliers;
      sums.squared_distance += static_cast<double>(nearest.squared_distance);
    }
    return sums;
  };
  const Sums all = reduce_chunks(executor, to_index(cloud_size(source), "cloud"), grain, Sums{}, sum_chunk,
                                 [](const Sums& left, const Sums& right) {
                                   return Sums{left.points + right.points, left.inliers + right.inliers,
                                               left.squared_distance + right.squared_distance};
                                 });
  if (all.inliers == 0) return {};
  const auto inliers = static_cast<double>(all.inliers);
  return {.inliers = all.inliers,
          .share_of_source = inliers / static_cast<double>(all.points),
          .share_of_target = inliers / static_cast<double>(target.size()),
          .rmse = std::sqrt(all.squared_distance / inliers)};
}

/// How far in front of what a sensor saw a point has to be for the sensor to have seen through it.
struct FreeSpaceOptions {
  double cell = 0.035;         ///< radians, of the range image: about what a downsampled cloud leaves no gaps in
  double margin = 1.0;         ///< metres in front of what was seen, and
  double margin_ratio = 0.05;  ///< metres for each metre of range
  double max_range = 60.0;     ///< metres: points farther off are not looked at
  Index max_points = 4096;     ///< that are looked at, evenly over the cloud
};

/// Points that a sensor had in view, and those of them that it saw something at or saw through. The others are hidden.
struct FreeSpaceCount {
  Index in_view = 0;       ///< points that the target's sensor would see
  Index confirmed = 0;     ///< where it saw something, to within the margin
  Index seen_through = 0;  ///< nearer to it

  /// Share of the points in view that were seen through; 0 if none was in view.
  [[nodiscard]] double share() const { return in_view > 0 ? static_cast<double>(seen_through) / in_view : 0.0; }
  /// Share of the points that are not hidden that were seen through; 0 if there are none.
  [[nodiscard]] double contradiction() const {
    const Index seen = confirmed + seen_through;
    return seen > 0 ? static_cast<double>(seen_through) / seen : 0.0;
  }

  /// Adds the counts of another part.
  FreeSpaceCount& operator+=(const FreeSpaceCount& other) {
    in_view += other.in_view;
    confirmed += other.confirmed;
    seen_through += other.seen_through;
    return *this;
  }
};

/// What a sensor saw from one place, and so what is free space: all that lies between it and what it saw (Bosse and
/// Zlot 2008). Points behind that are hidden and say nothing.
class FreeSpace {
 public:
  /// @param seen  points that the sensor saw from `viewpoint`, in one frame, metres.
  /// @throws std::invalid_argument if an option makes no sense.
  template <Cloud Points>
  [[gnu::cold]] FreeSpace(const Points& seen, const Eigen::Vector3d& viewpoint, const FreeSpaceOptions& options = {})
      : options_(checked(options)), image_(seen, viewpoint, options.cell) {}

  /// @param points        n points of another cloud, metres.
  /// @param T_seen_points from their frame to that of what was seen.
  template <Cloud Points>
  [[nodiscard]] [[gnu::cold]] FreeSpaceCount count(const Points& points, const SE3d& T_seen_points) const {
    FreeSpaceCount count;
    const Eigen::Matrix3d R = T_seen_points.rotation().matrix();
    const std::size_t size = cloud_size(points), most = static_cast<std::size_t>(options_.max_points);
    const std::size_t stride = std::max<std::size_t>(1, (size + most - 1) / most);
    for (std::size_t i = 0; i < size; i += stride) {
      const Eigen::Vector3d p = sum_of(product(R, position(points, i)), T_seen_points.translation());
      const double range = image_.range_of(p);
      if (!(range <= options_.max_range)) continue;
      const double seen = image_.free_range(p);
      if (seen == detail::RangeImage::unknown) continue;
      ++count.in_view;
      const double margin = options_.margin + options_.margin_ratio * seen;
      count.seen_through += range + margin < seen ? 1 : 0;
      count.confirmed += std::abs(range - seen) <= margin ? 1 : 0;
    }
    return count;
  }

 private:
  [[nodiscard]] static const FreeSpaceOptions& checked(const FreeSpaceOptions& options) {
    if (!(options.cell > 0) || !(options.margin >= 0) || options.max_points < 1)
      throw std::invalid_argument("FreeSpace: cell and max_points must be positive, margin not negative");
    return options;
  }

  FreeSpaceOptions options_;
  detail::RangeImage image_;
};

/// Which points are compared, and how.
struct SurfaceFitOptions {
  double max_distance = 1.0;  ///< metres, from a point to the target point whose plane it is measured by
  Index max_points = 4096;    ///< that are looked at, evenly over the cloud
  /// Of what constrains each direction, the share that counts for `SurfaceFit::worst_rmse`: the rest, which lies
  /// farthest off, is taken for something that only one of the clouds has, such as traffic. With 0.8 all of 162 right
  /// poses of real scans (Livox Avia) have a `worst_misfit` of at most 1.5, 98 % of them 0.97, and of 31 wrong ones
  /// two.
  double share = 1.0;
};

/// How well a cloud at some pose lies on the surfaces of another.
///
/// Distances to nearest points depend on the density of clouds as much as on their fit; distances to planes, over those
/// that the target's own points have from each other's planes, do not.
struct SurfaceFit {
  /// Root mean square distance from points to the planes at their nearest target points, metres, over those that have
  /// one.
  double rmse = std::numeric_limits<double>::infinity();
  double overlap = 0;  ///< share of the points that have one
  /// The same distance by those points that constrain one of three directions at right angles, weighted by the fourth
  /// power of the cosine between plane normal and direction, of the direction in which it is largest, metres. Ground
  /// that is the same everywhere does not hide that the few walls across a street are elsewhere.
  double worst_rmse = std::numeric_limits<double>::infinity();

  /// How many times more than the target's own points these lie off the surfaces, over the share that lies near any.
  ///
  /// @param noise  of the target, by `surface_noise`; anything below 5 cm, which is what a laser measures, counts as
  /// that.
  /// @returns infinity where nothing overlaps.
  [[nodiscard]] double misfit(double noise) const { return relative(rmse, noise); }

  /// The same in the worst of three directions: what slid along a street or a courtyard fits in the others.
  ///
  /// `bench_closure_gates` (bench/results.md) compares both on right and wrong alignments of eight sensors.
  [[nodiscard]] double worst_misfit(double noise) const { return relative(worst_rmse, noise); }

 private:
  /// A distance over the target's noise and the overlap.
  [[nodiscard]] double relative(double distance, double noise) const {
    constexpr double least_noise = 0.05;
    return overlap > 0 ? distance / (std::max(noise, least_noise) * overlap) : std::numeric_limits<double>::infinity();
  }
};

namespace detail {

inline void check(const SurfaceFitOptions& options) {
  if (!(options.max_distance > 0 && options.share > 0 && options.share <= 1) || options.max_points < 1)
    throw std::invalid_argument("SurfaceFit: max_distance and max_points must be positive, share must lie in (0, 1]");
}

/// Points about planes.
class PlaneDistances {
 public:
  /// @returns whether point `i` of the target has a normal.
  template <class Target>
  bool add(const Target& target, const Eigen::Vector3f& p, Index i) {
    const Eigen::Vector3f& normal = target.normal(i);
    const Eigen::Vector3f& on_plane = target.position(i);
    Plane plane;
    double length = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      plane.normal[k] = static_cast<double>(normal[static_cast<int>(k)]);
      plane.distance += plane.normal[k] * (static_cast<double>(p[static_cast<int>(k)]) -
                                           static_cast<double>(on_plane[static_cast<int>(k)]));
      length += plane.normal[k] * plane.normal[k];
    }
    if (!(length > 0.5)) return false;
    planes_.push_back(plane);
    return true;
  }

  [[nodiscard]] std::size_t count() const { return planes_.size(); }

  [[nodiscard]] double rmse() const {
    double squared = 0;
    for (const Plane& plane : planes_) squared += plane.distance * plane.distance;
    return planes_.empty() ? std::numeric_limits<double>::infinity()
                           : std::sqrt(squared / static_cast<double>(planes_.size()));
  }

  /// Of three directions at right angles, those in which the normals gather, the one with the largest distance.
  /// @param share  of the weight in each direction that counts, by the points nearest to their planes.
  [[nodiscard]] [[gnu::cold]] double worst_rmse(double share) const {
    if (planes_.empty()) return std::numeric_limits<double>::infinity();
    Eigen::Matrix3d gathered = zeros<Eigen::Matrix3d>();
    for (const Plane& plane : planes_)
      for (int i = 0; i < 9; ++i)
        gathered(i / 3, i % 3) +=
            plane.normal[static_cast<std::size_t>(i / 3)] * plane.normal[static_cast<std::size_t>(i % 3)];
    const SymmetricEigen3 eigen = symmetric_eigen(gathered);
    double worst = 0;
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d direction = block_of<3, 1>(eigen.vectors, 0, k);
      worst = std::max(worst, share < 1 ? nearest_along(direction, share) : rmse_along(direction));
    }
    return worst;
  }

 private:
  struct Plane {
    std::array<double, 3> normal{};
    double distance = 0;
  };

  static constexpr double least_weight = 1;  ///< of one point on a plane across

  /// The fourth power of the cosine between a plane's normal and a direction.
  [[nodiscard]] static double weight_of(const Plane& plane, const Eigen::Vector3d& direction) {
    double cosine = 0;
    for (int k = 0; k < 3; ++k) cosine += plane.normal[static_cast<std::size_t>(k)] * direction[k];
    return cosine * cosine * cosine * cosine;
  }

  /// 0 if hardly a point constrains the direction.
  [[nodiscard]] double rmse_along(const Eigen::Vector3d& direction) const {
    double weights = 0, squared = 0;
    for (const Plane& plane : planes_) {
      const double weight = weight_of(plane, direction);
      weights += weight;
      squared += weight * plane.distance * plane.distance;
    }
    return weights >= least_weight ? std::sqrt(squared / weights) : 0.0;
  }

  /// The same by the points nearest to their planes, up to a share of the weight.
  [[nodiscard]] [[gnu::cold]] double nearest_along(const Eigen::Vector3d& direction, double share) const {
    Table<Ranked> order;
    double all = 0;
    for (std::size_t i = 0; i < planes_.size(); ++i) {
      order.push_back({std::abs(planes_[i].distance), static_cast<Index>(i)});
      all += weight_of(planes_[i], direction);
    }
    sort_ranked(order.all());
    double weights = 0, squared = 0;
    for (const Ranked& one : order) {
      if (weights >= share * all) break;
      const double weight = weight_of(planes_[static_cast<std::size_t>(one.index)], direction);
      weights += weight;
      squared += weight * one.rank * one.rank;
    }
    return weights >= share * least_weight ? std::sqrt(squared / weights) : 0.0;
  }

  std::vector<Plane> planes_;
};

/// Of `count` points one of so many is looked at.
[[nodiscard]] inline std::size_t stride_of(std::size_t count, Index max_points) {
  return std::max<std::size_t>(
      1, (count + static_cast<std::size_t>(max_points) - 1) / static_cast<std::size_t>(max_points));
}

}  // namespace detail

/// @param source  n points in the source's frame, metres; those that are not finite are left out.
/// @param target  search over points with normals, in the target's frame.
/// @throws std::invalid_argument if an option makes no sense.
template <Cloud Source, OrientedSearch Target>
[[nodiscard]] [[gnu::cold]] SurfaceFit surface_fit(const Source& source, const Target& target,
                                                   const SE3d& T_target_source, const SurfaceFitOptions& options = {}) {
  detail::check(options);
  const Eigen::Matrix3d R = T_target_source.rotation().matrix();
  const std::size_t count = cloud_size(source), stride = detail::stride_of(count, options.max_points);
  detail::PlaneDistances near;
  Index finite = 0;
  for (std::size_t i = 0; i < count; i += stride) {
    const Eigen::Vector3d moved = sum_of(product(R, position(source, i)), T_target_source.translation());
    if (!is_finite(moved)) continue;
    ++finite;
    const Eigen::Vector3f p(static_cast<float>(moved[0]), static_cast<float>(moved[1]), static_cast<float>(moved[2]));
    Neighbor<float> nearest;
    if (target.knn(p, std::span(&nearest, 1), static_cast<float>(options.max_distance)) > 0)
      near.add(target, p, nearest.index);
  }
  return SurfaceFit{.rmse = near.rmse(),
                    .overlap = finite > 0 ? static_cast<double>(near.count()) / finite : 0.0,
                    .worst_rmse = near.worst_rmse(options.share)};
}

/// How far a cloud's points lie off each other's planes: root mean square of the distances from points to the plane at
/// the nearest other point, metres; infinite if no two are near each other.
/// @param target  points with normals.
/// @throws std::invalid_argument if an option makes no sense.
template <class Search>
[[nodiscard]] [[gnu::cold]] double surface_noise(const IndexedCloud<Search>& target,
                                                 const SurfaceFitOptions& options = {}) {
  detail::check(options);
  const std::size_t count = target.cloud().size();
  const std::size_t stride = detail::stride_of(count, options.max_points);
  detail::PlaneDistances near;
  for (std::size_t i = 0; i < count; i += stride) {
    const Eigen::Vector3f p = target.position(static_cast<Index>(i));
    if (!is_finite(p)) continue;
    std::array<Neighbor<float>, 2> nearest;
    if (target.knn(p, nearest, static_cast<float>(options.max_distance)) < 2) continue;
    const bool itself = nearest[0].index == static_cast<Index>(i);
    near.add(target, p, nearest[itself ? 1 : 0].index);
  }
  return near.rmse();
}

}  // namespace chainslam
