#pragma once

#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/features/fpfh.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/registration/icp.hpp"

namespace chainslam {

namespace detail {

template <Cloud T>
[[nodiscard]] PointCloud<float> copy_positions(const T& cloud) {
  PointCloud<float> points;
  points.positions.reserve(cloud_size(cloud));
  for (std::size_t i = 0; i < cloud_size(cloud); ++i) points.positions.push_back(position_f(cloud, i));
  return points;
}

template <class T>
struct PlainCloud {
  /// The points with the cloud's own normals, or with estimated ones.
  template <class Exec>
  [[nodiscard]] static PointCloud<float> oriented(const T& cloud, const Exec& executor) {
    PointCloud<float> points = copy_positions(cloud);
    if constexpr (OrientedCloud<T>) {
      if (carries_normals(cloud)) {
        points.normals.reserve(points.size());
        for (std::size_t i = 0; i < points.size(); ++i)
          points.normals.push_back(normal(cloud, i).template cast<float>());
        return points;
      }
    }
    (void)estimate_normals(points, NormalOptions{.neighbors = 10}, Eigen::Vector3d::Zero(), executor);
    return points;
  }
  template <class Exec>
  [[nodiscard]] static IndexedCloud<> indexed(const T& cloud, bool with_normals, const Exec& executor) {
    return IndexedCloud<>(with_normals ? oriented(cloud, executor) : copy_positions(cloud));
  }
};

}  // namespace detail

/// Aligns two clouds in one go: indexes the target and estimates its normals where they are needed. Keep an
/// `IndexedCloud` where several sources meet one target, and make large clouds smaller with `voxel_downsample`.
template <Cloud Source, Cloud Target, Executor Exec = Serial>
  requires(!NearestNeighborSearch<Target>)
[[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess = {},
                                const Exec& executor = {}) {
  return detail::robust_to_planes.align(source, OrientedOnDemand(detail::copy_positions(target)), guess, executor);
}

/// Two registrations in a row: one that reaches far finds the place, one that looks near settles the pose.
///
/// The result is the second's; where the first finds no overlap, or the deadline ends it, it is the first's. The first
/// looks at some of the points only, since its pose is no more than the second's guess.
template <class Coarse = Icp<PointToPlane, GemanMcClure>, class Fine = Coarse>
struct CoarseToFine {
  Coarse coarse{.max_iterations = 20, .max_distance = 5.0, .kernel = {.width = 1.0}};  ///< far away
  Fine fine{.max_iterations = 50, .max_distance = 2.0, .kernel = {.width = 0.3}};      ///< near the answer
  Index coarse_points = 2048;  ///< of the source, evenly, at least; 0: all

  /// Coarse, then fine, from `guess`; see `Icp::align`.
  template <Cloud Source, AlignTarget Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess,
                                  const Exec& executor = {}, const Deadline& deadline = {}) const;

  /// The first stage alone: cheap, to try several guesses.
  template <Cloud Source, AlignTarget Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult rough(const Source& source, const Target& target, const SE3d& guess,
                                  const Exec& executor = {}, const Deadline& deadline = {}) const;

  /// The second stage alone, for a guess that is off by less than its distance.
  template <Cloud Source, AlignTarget Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult refine(const Source& source, const Target& target, const SE3d& guess,
                                   const Exec& executor = {}, const Deadline& deadline = {}) const {
    return fine.align(source, target, guess, executor, deadline);
  }
};

namespace detail {

/// One of `every` points, with its normal if the cloud has normals.
template <Cloud Points>
[[nodiscard]] PointCloud<float> every_nth(const Points& cloud, std::size_t every) {
  PointCloud<float> some;
  for (std::size_t i = 0; i < cloud_size(cloud); i += every)
    some.positions.push_back(converted<float>(position(cloud, i)));
  if (carries_normals(cloud))
    for (std::size_t i = 0; i < cloud_size(cloud); i += every)
      some.normals.push_back(converted<float>(normal(cloud, i)));
  return some;
}

/// At least `count` points, evenly; all if that is 0.
template <Cloud Points>
[[nodiscard]] PointCloud<float> evenly(const Points& cloud, Index count) {
  const std::size_t every = count > 0 ? cloud_size(cloud) / static_cast<std::size_t>(count) : 1;
  return every_nth(cloud, every > 1 ? every : 1);
}

}  // namespace detail

template <class Coarse, class Fine>
template <Cloud Source, AlignTarget Target, Executor Exec>
AlignResult CoarseToFine<Coarse, Fine>::align(const Source& source, const Target& target, const SE3d& guess,
                                              const Exec& executor, const Deadline& deadline) const {
  const AlignResult first = rough(source, target, guess, executor, deadline);
  if (first.status == AlignStatus::no_overlap || first.status == AlignStatus::too_few_points ||
      first.status == AlignStatus::cancelled)
    return first;
  return fine.align(source, target, first.T_target_source, executor, deadline);
}

template <class Coarse, class Fine>
template <Cloud Source, AlignTarget Target, Executor Exec>
AlignResult CoarseToFine<Coarse, Fine>::rough(const Source& source, const Target& target, const SE3d& guess,
                                              const Exec& executor, const Deadline& deadline) const {
  const std::size_t every = coarse_points > 0 ? cloud_size(source) / static_cast<std::size_t>(coarse_points) : 1;
  return every > 1 ? coarse.align(detail::every_nth(source, every), target, guess, executor, deadline)
                   : coarse.align(source, target, guess, executor, deadline);
}

/// One registration at distances that shrink, as the pose gets better, to the registration's own: each stage but the
/// last takes a few steps from where the one before it ended.
///
/// The result is the last stage's; where an earlier one finds no overlap, or the deadline ends it, it is that one's.
template <class Registration = PointToPlaneIcp>
struct DistanceSchedule {
  Registration registration{};  ///< repeated with each distance
  double first_distance = 4.0;  ///< metres
  double ratio = 0.5;           ///< of one stage's distance to the one before it, in (0, 1)
  Index steps_a_stage = 5;      ///< of the stages before the last

  /// With each distance in turn, from `guess`; see `Icp::align`.
  template <Cloud Source, AlignTarget Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess,
                                  const Exec& executor = {}, const Deadline& deadline = {}) const;
};

template <class Registration>
template <Cloud Source, AlignTarget Target, Executor Exec>
AlignResult DistanceSchedule<Registration>::align(const Source& source, const Target& target, const SE3d& guess,
                                                  const Exec& executor, const Deadline& deadline) const {
  if (!(ratio > 0 && ratio < 1)) throw std::invalid_argument("DistanceSchedule: ratio must lie in (0, 1)");
  SE3d pose = guess;
  Registration stage = registration;
  stage.max_iterations = steps_a_stage;
  for (stage.max_distance = first_distance; stage.max_distance > registration.max_distance;
       stage.max_distance *= ratio) {
    const AlignResult result = stage.align(source, target, pose, executor, deadline);
    if (result.status == AlignStatus::no_overlap || result.status == AlignStatus::too_few_points ||
        result.status == AlignStatus::cancelled)
      return result;
    pose = result.T_target_source;
  }
  return registration.align(source, target, pose, executor, deadline);
}

}  // namespace chainslam
