#pragma once

#include <algorithm>
#include <cstddef>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/square_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/map/slam_map.hpp"
#include "chainslam/slam/odometry_doubt.hpp"

namespace chainslam {

/// Covariance of T_from_to by the graph, tangent [translation; rotation], metres and radians.
///
/// Keyframes at the end of a session that no optimization has taken in yet are as uncertain as odometry is on the way
/// to them, beyond the last one that was. Linear in their number; else the cost of `IncrementalSmoother::covariance`.
/// @param smoother  its variables are the map's keyframes.
template <class Smoother>
[[nodiscard]] [[gnu::cold]] Matrix6d relative_covariance(const Smoother& smoother, const SlamMap& map, KeyframeId from,
                                                         KeyframeId to) {
  const auto pose = [&](Index i) -> const SE3d& { return map.keyframes[static_cast<std::size_t>(i)].T_map_body; };
  const SessionId session = map.keyframes[static_cast<std::size_t>(to.value)].session;
  const Index first = map.sessions[static_cast<std::size_t>(session.value)].first_keyframe;
  Index known = to.value;
  while (known > first && known != from.value && !smoother.has_covariance(known)) --known;
  Matrix6d sum = zeros<Matrix6d>();
  if (smoother.has_covariance(known) && smoother.has_covariance(from.value))
    sum = detail::carried(smoother.relative_covariance(from.value, known), pose(to.value).inverse() * pose(known));
  auto step = std::partition_point(map.odometry.begin(), map.odometry.end(),
                                   [&](const OdometryMeasurement& one) { return one.to.value <= known; });
  for (; step != map.odometry.end() && step->to <= to; ++step) {
    const Matrix6d whitening = step->sqrt_information;
    const Matrix6d information = product(transposed(whitening), whitening);
    const Matrix6d root = solved_right(identity<Matrix6d>(), cholesky(information));
    sum = sum_of(sum, detail::carried(times_transposed(root, root), pose(to.value).inverse() * pose(step->to.value)));
  }
  return sum;
}

/// The same of a graph with `smoother()` and `map()`, such as `MapGraph`.
template <class Graph>
struct RelativeCovariance {
  const Graph& graph;  ///< must outlive this

  /// See `relative_covariance`.
  [[nodiscard]] Matrix6d operator()(KeyframeId from, KeyframeId to) const {
    return relative_covariance(graph.smoother(), graph.map(), from, to);
  }
};

}  // namespace chainslam
