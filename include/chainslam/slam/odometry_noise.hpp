#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <stdexcept>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// How far odometry between two keyframes may be off: by the way and the turn between them, and by what odometry itself
/// says of the two frames.
///
/// Set on real drives with truth, so that chains of steps of 3 m are off by as much as expected over 1, 10 and 100 m,
/// and held on simulated ones: bench/results.md, "Odometry noise". One set serves `LidarOdometry`,
/// `LidarInertialOdometry` and FAST-LIO2, since it is the map, not the filter, that makes most of their errors.
struct OdometryNoise {
  double translation = 0.01;             ///< metres per step,
  double translation_per_metre = 0.007;  ///< and per metre between its ends
  double rotation = 0.0006;              ///< radians per step,
  double rotation_per_metre = 0.0001;    ///< per metre between its ends,
  double rotation_per_radian = 0.012;    ///< and per radian turned: clocks, and sweeps while the rate changes
  /// Share of the deviations that odometry states of its frames which counts for the relative pose. Less than all,
  /// since part of an error is that of both frames: where the local map began, and of filters how the LiDAR is mounted.
  double stated_translation = 0.5;
  double stated_rotation = 0.2;  ///< the same for the rotation

  /// Of T_from_to, tangent [translation; rotation].
  [[nodiscard]] NoiseModel<6> operator()(const SE3d& T_from_to) const {
    return NoiseModel<6>::from_sigmas(sigmas(T_from_to));
  }

  /// The same with covariance beside it.
  /// @param added  positive semi-definite but for rounding.
  [[nodiscard]] NoiseModel<6> operator()(const SE3d& T_from_to, const Matrix6d& added) const {
    constexpr double rounding = 1e-9;
    const Vector6d by_way = sigmas(T_from_to);
    Matrix6d covariance;
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i)
        covariance(i, j) =
            0.5 * (added(i, j) + added(j, i)) + (i == j ? by_way[i] * by_way[i] + rounding * added(i, i) : 0.0);
    return NoiseModel<6>::from_covariance(covariance);
  }

  /// What counts of the covariance that two frames' own make of their relative pose: see `stated_covariance`.
  [[nodiscard]] Matrix6d share_of(Matrix6d stated) const {
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i)
        stated(i, j) *= (i < 3 ? stated_translation : stated_rotation) * (j < 3 ? stated_translation : stated_rotation);
    return stated;
  }

 private:
  [[nodiscard]] Vector6d sigmas(const SE3d& T_from_to) const {
    const double way = T_from_to.translation().norm(), turn = T_from_to.rotation().log().norm();
    Vector6d sigmas;
    for (int i = 0; i < 6; ++i)
      sigmas[i] = i < 3 ? translation + translation_per_metre * way
                        : rotation + rotation_per_metre * way + rotation_per_radian * turn;
    return sigmas;
  }
};

/// The same of odometry that says nothing of its errors, such as another system's recorded one: loose enough for poses
/// that shake, which only a looser rotation takes up. Set on three real drives of NCLT, whose rotations are off by 0.01
/// rad from one keyframe to the next and by not much more after 100 m; held on FAST-LIO2's recorded poses of MulRan
/// KAIST 02.
[[nodiscard]] inline OdometryNoise unknown_odometry_noise() {
  return {.translation = 0.08,
          .translation_per_metre = 0.02,
          .rotation = 0.004,
          .rotation_per_metre = 0.0008,
          .rotation_per_radian = 0.0};
}

namespace detail {

/// The nearest symmetric matrix without negative eigenvalues.
[[nodiscard]] [[gnu::cold]] inline Matrix6d positive_part(const Matrix6d& symmetric) {
  const JacobiEigen<double, 6> eigen = jacobi_eigen(symmetric);
  Matrix6d scaled = eigen.vectors;
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < 6; ++i) scaled(i, j) *= std::max(eigen.values[j], 0.0);
  return product_transposed(scaled, eigen.vectors);
}

/// The covariance of a pose's error, carried along with the body: seen from where `T_to_from` puts it.
[[nodiscard]] [[gnu::cold]] inline Matrix6d carried(const Matrix6d& covariance, const SE3d& T_to_from) {
  const Matrix6d adjoint = T_to_from.adjoint();
  return product_transposed(product(adjoint, covariance), adjoint);
}

}  // namespace detail

/// @throws std::invalid_argument if the keyframe's pose is not finite, or so far away that its square is not.
[[gnu::cold]] inline void require_finite(const Keyframe& keyframe) {
  const SE3d& T = keyframe.T_odom_body;
  // |a - b|^2 <= 4 max(|a|^2, |b|^2): no way between two keyframes overflows.
  if (!is_finite(T.matrix()) || !is_finite(4 * T.translation().squaredNorm()))
    throw std::invalid_argument("BackEnd: a keyframe's pose is not finite");
}

/// @throws std::invalid_argument if the keyframe cannot be the map's next: its pose is not finite, or its time not
/// later.
[[gnu::cold]] inline void require_next(const SlamMap& map, const Keyframe& keyframe) {
  require_finite(keyframe);
  if (!map.sessions.empty() && map.sessions.back().keyframes > 0 && keyframe.time <= map.keyframes.back().time)
    throw std::invalid_argument("BackEnd: a keyframe's time is not later than the one before it");
}

/// @param before  the session's frame before them; null if they are its first.
/// @throws std::invalid_argument if times do not increase or something is not finite.
[[gnu::cold]] inline void require_sound(std::span<const FrameRecord> frames, const FrameRecord* before) {
  for (const FrameRecord& frame : frames) {
    if (before != nullptr && frame.time <= before->time)
      throw std::invalid_argument("BackEnd: a frame's time is not later than the one before it");
    if (!is_finite(frame.T_odom_body.matrix()) || !is_finite(frame.covariance.matrix()))
      throw std::invalid_argument("BackEnd: a frame's pose or covariance is not finite");
    if (frame.delta_velocity && !is_finite(*frame.delta_velocity))
      throw std::invalid_argument("BackEnd: a frame's delta velocity is not finite");
    before = &frame;
  }
}

namespace detail {

/// In place of a covariance that is not finite or huge, one of which sums are: m^2 and rad^2. Beyond, sums with what is
/// known round that off.
[[nodiscard]] [[gnu::cold]] inline Matrix6d bounded(const Matrix6d& covariance) {
  constexpr double unknown = 1e12;
  for (int k = 0; k < 36; ++k)
    if (!is_finite(covariance.data()[k]) || std::abs(covariance.data()[k]) > unknown)
      return scaled(unknown, identity<Matrix6d>());
  return covariance;
}

}  // namespace detail

/// Covariance of the relative pose of two keyframes by what odometry states of the two frames: of poses matched to a
/// local map each by itself, the sum.
///
/// A pose that is known to half a metre only was not matched so: its map was restarted where nothing had confirmed it,
/// and what follows shares that error. Of this counts what it grows by.
/// @param frames  from the first keyframe's to the second's, both among them.
/// @returns tangent [translation; rotation] of the second keyframe's pose; zero if less than two frames say something.
[[nodiscard]] [[gnu::cold]] inline Matrix6d stated_covariance(std::span<const FrameRecord> frames) {
  constexpr double matched = 0.5;  // metres
  if (frames.size() < 2) return zeros<Matrix6d>();
  const FrameRecord &from = frames.front(), &to = frames.back();
  const Matrix6d of_from = from.covariance.matrix(), of_to = to.covariance.matrix();
  const Matrix6d carried = detail::carried(of_from, to.T_odom_body.inverse() * from.T_odom_body);
  const bool shared = std::max({of_from(0, 0), of_from(1, 1), of_from(2, 2)}) > matched * matched;
  return detail::positive_part(detail::bounded(shared ? difference_of(of_to, carried) : sum_of(of_to, carried)));
}

/// How much less than that odometry is trusted where scans were lost, the motion was unknown, or a direction unseen.
struct OdometryInflation {
  bool enabled = true;  ///< else odometry is trusted the same everywhere (the paper)
  /// Share of wrong matches after lost scans: the scan may fit elsewhere. A relative pose that is off as far as it was
  /// predicted with this probability, and else right, has this share of the prediction's variance. (Of 18 losses of up
  /// to eight scans on KITTI 00 all were followed by right ones.)
  double wrong_rematch = 0.1;
  /// Deviations of what the body does in a gap of the scans, each axis: as far astray as filters went without them.
  double gap_speed = 5.0;  ///< m/s
  double gap_rate = 0.1;   ///< rad/s

  /// Covariance that lost and degenerate frames and gaps add to the relative pose of two keyframes, over that of
  /// odometry that sees all it needs. Zero if all frames between are good.
  ///
  /// Of degenerate frames that by which their covariance grows. Of lost ones the same, whole if the local map was
  /// restarted, since nothing ties the keyframes together then; otherwise the share `wrong_rematch`. Of frames matched
  /// after a gap that share of how far the body may have gone in it.
  /// @param frames  from the first keyframe's to the second's, both among them.
  /// @returns tangent [translation; rotation] of the second keyframe's pose.
  [[nodiscard]] [[gnu::cold]] Matrix6d operator()(std::span<const FrameRecord> frames) const {
    Matrix6d doubt = zeros<Matrix6d>(), pending = zeros<Matrix6d>();  // since scans have been lost
    if (!enabled) return doubt;
    for (std::size_t i = 1; i < frames.size(); ++i) {
      const FrameRecord &before = frames[i - 1], &frame = frames[i];
      const bool lost = frame.health.status == FrameStatus::lost;
      if (!lost && frame.health.after_gap) pending = sum_of(pending, after_gap(frames, i));
      if (!lost) add(pending, wrong_rematch, doubt);
      if (frame.health.status == FrameStatus::good) continue;
      const Matrix6d known =
          detail::carried(before.covariance.matrix(), frame.T_odom_body.inverse() * before.T_odom_body);
      const Matrix6d growth = detail::carried(detail::positive_part(difference_of(frame.covariance.matrix(), known)),
                                              frames.back().T_odom_body.inverse() * frame.T_odom_body);
      Matrix6d& grown = lost ? pending : doubt;
      grown = sum_of(grown, growth);
      if (frame.health.map_restarted) add(pending, 1.0, doubt);
    }
    add(pending, 1.0, doubt);
    return detail::bounded(doubt);
  }

 private:
  /// How far a frame may be from where the one before it was, seen from the last.
  [[nodiscard]] [[gnu::cold]] Matrix6d after_gap(std::span<const FrameRecord> frames, std::size_t i) const {
    const double seconds = to_seconds(frames[i].time - frames[i - 1].time);
    Matrix6d moved = zeros<Matrix6d>();
    for (int k = 0; k < 6; ++k) {
      const double deviation = seconds * (k < 3 ? gap_speed : gap_rate);
      moved(k, k) = deviation * deviation;
    }
    return detail::carried(moved, frames.back().T_odom_body.inverse() * frames[i].T_odom_body);
  }

  static void add(Matrix6d& pending, double share, Matrix6d& doubt) {
    doubt = sum_of(doubt, scaled(share, pending));
    pending = zeros<Matrix6d>();
  }
};

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
