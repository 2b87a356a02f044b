#pragma once

#include <concepts>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/snapshot.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/map/slam_map.hpp"
#include "chainslam/slam/gnss_interpolator.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "chainslam/slam/position_index.hpp"

namespace chainslam {

/// How far odometry between two keyframes may be off, by the way between them.
struct OdometryNoise {
  double translation = 0.02;             ///< metres per step,
  double translation_per_metre = 0.005;  ///< and per metre travelled
  double rotation = 0.001;               ///< radians per step,
  double rotation_per_metre = 0.0002;    ///< and per metre travelled

  /// Covariance of T_from_to, tangent [translation; rotation].
  [[nodiscard]] Matrix6d covariance(const SE3d& T_from_to) const {
    const double way = T_from_to.translation().norm();
    const double t = translation + translation_per_metre * way;
    const double r = rotation + rotation_per_metre * way;
    Vector6d variances;
    variances << Eigen::Vector3d::Constant(t * t), Eigen::Vector3d::Constant(r * r);
    return variances.asDiagonal();
  }
};

struct BackEndOptions {
  OdometryNoise odometry_noise{};
  /// Standard deviations of where a later session starts in the first one's frame, from what its odometry says: metres
  /// and radians. Closures between sessions decide within them.
  double session_translation = 10.0;
  double session_rotation = 0.5;
  LevenbergMarquardt optimizer{.max_iterations = 50, .relative_tolerance = 1e-6};
};

/// Tries to close loops with the newest keyframe, the last of `keyframes`.
///
/// `close(keyframes, index, executor)` gives what was tried, each with its verdict, the accepted ones with a positive
/// definite covariance. `index` holds the positions of all keyframes. It is called once for each keyframe, in order.
template <class C>
concept ClosureFinder = requires(C& closer, std::span<const Keyframe> keyframes, const PositionIndex& index) {
  { closer.close(keyframes, index, Serial{}) } -> std::same_as<std::vector<LoopClosure>>;
};

/// What the back end did so far.
struct BackEndCounts {
  Index optimisations = 0;
  Index failed_optimisations = 0;  ///< the estimates before were kept
  OptimizeReport last;
};

/// Keeps the keyframes of all sessions in one pose graph, closes loops and optimises.
///
/// All work is done inside `add`, in the order of the calls: the same keyframes give the same map, bit for bit. Only
/// one thread may call `add`, `begin_session` and `finish`; `snapshot` and `T_map_odom` may be read by any.
/// The first session's start defines the map's frame. A later one begins where its own odometry says and is moved as a
/// whole by what connects it with the others.
/// @tparam Closer  finds closures: `LoopCloser` with its policies.
/// @tparam Kernel  weighs closures down that the rest of the graph contradicts; in standard deviations.
template <class Closer = LoopCloser<>, class Kernel = Cauchy>
class BackEnd {
  static_assert(ClosureFinder<Closer>,
                "BackEnd: Closer needs `std::vector<LoopClosure> close(keyframes, index, executor)`, as in LoopCloser");
  static_assert(RobustCost<Kernel>,
                "BackEnd: Kernel needs `double weight(double squared_residual) const` and `double cost(double "
                "squared_residual) const`, as in Cauchy");

 public:
  using ClosureFactor = BetweenFactor<SE3d, Kernel>;
  using Graph = std::conditional_t<std::is_same_v<Kernel, Trivial>, PoseGraph, FactorGraph<SE3d, ClosureFactor>>;

  explicit BackEnd(const BackEndOptions& options = {}, Closer closer = Closer{}, Kernel kernel = {})
      : options_(options), closer_(std::move(closer)), kernel_(std::move(kernel)) {}

  /// Keyframes added from now on are of a new session. Without a call, the first keyframe begins one without a name.
  void begin_session(std::string name) {
    gnss_ = GnssInterpolator();  // the clocks of two drives have nothing in common
    const SessionId id{to_index(map_.sessions.size())};
    map_.sessions.push_back({id, std::move(name), to_index(map_.keyframes.size()), 0});
  }

  /// Takes the next keyframe of the session, tries to close a loop with it, and optimises if that succeeds.
  /// @returns its id.
  /// @throws std::invalid_argument if its time is not later than the session's last, or if T_odom_body is not finite;
  /// the map is then as it was.
  template <Executor E = Serial>
  KeyframeId add(Keyframe keyframe, const E& executor = {}) {
    check(keyframe);
    if (map_.sessions.empty()) begin_session({});
    append(std::move(keyframe));
    const KeyframeId id = map_.keyframes.back().id;
    bool closed = false;
    for (LoopClosure& closure : closer_.close(map_.keyframes, positions_, executor)) {
      const bool accepted = closure.verdict == ClosureVerdict::accepted;
      if (accepted) add_factor(closure);
      closed |= accepted;
      (accepted ? map_.closures : map_.refusals).push_back(std::move(closure));
    }
    if (closed) optimise_graph();
    publish_frame();
    return id;
  }

  /// Takes a GNSS fix, which keyframes around its time get a position from.
  void add(const GnssFix& fix) {
    gnss_.add(fix, [&](KeyframeId id, const GnssFix& interpolated) {
      map_.keyframes[static_cast<std::size_t>(id.value)].gnss = interpolated;
    });
  }

  /// Optimises to the end and hands out the map.
  [[nodiscard]] std::shared_ptr<const SlamMap> finish() {
    if (!map_.closures.empty()) optimise_graph();
    publish_frame();
    snapshot_.store(std::make_shared<const SlamMap>(map_));
    return snapshot_.load();
  }

  /// The map as it is; owned by the back end, to be read on the thread that adds.
  [[nodiscard]] const SlamMap& map() const { return map_; }
  /// The map after the last optimisation; null before the first.
  [[nodiscard]] std::shared_ptr<const SlamMap> snapshot() const { return snapshot_.load(); }
  /// Where odometry's frame lies in the map, by the newest keyframe; null before the first.
  [[nodiscard]] std::shared_ptr<const SE3d> T_map_odom() const { return T_map_odom_.load(); }

  [[nodiscard]] const Graph& graph() const { return graph_; }
  [[nodiscard]] const Closer& closer() const { return closer_; }
  [[nodiscard]] const BackEndCounts& counts() const { return counts_; }

 private:
  void check(const Keyframe& keyframe) const {
    if (!is_finite(keyframe.T_odom_body.matrix()))
      throw std::invalid_argument("BackEnd: a keyframe's pose is not finite");
    const bool first = map_.sessions.empty() || map_.sessions.back().keyframes == 0;
    if (!first && keyframe.time <= map_.keyframes.back().time)
      throw std::invalid_argument("BackEnd: a keyframe's time is not later than the one before it");
  }

  /// What is known of the newest session's start before any closure.
  [[nodiscard]] typename Graph::Noise start_noise() const {
    constexpr double anchor = 1e-4;  // metres, radians: the first keyframe of all defines the frame
    if (map_.keyframes.empty()) return Graph::Noise::from_sigma(anchor);
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(options_.session_translation),
        Eigen::Vector3d::Constant(options_.session_rotation);
    return Graph::Noise::from_sigmas(sigmas);
  }

  void append(Keyframe keyframe) {
    Session& session = map_.sessions.back();
    keyframe.id = KeyframeId{to_index(map_.keyframes.size())};
    keyframe.session = session.id;
    if (session.keyframes == 0) {
      keyframe.T_map_body = keyframe.T_odom_body;
      const auto noise = start_noise();
      graph_.add_prior(graph_.add_value(keyframe.T_map_body), keyframe.T_map_body, noise);
    } else {
      const Keyframe& last = map_.keyframes.back();
      const SE3d T_last_new = last.T_odom_body.inverse() * keyframe.T_odom_body;
      keyframe.T_map_body = last.T_map_body * T_last_new;
      const Matrix6d covariance = options_.odometry_noise.covariance(T_last_new);
      const auto noise = Graph::Noise::from_covariance(covariance);
      graph_.add_between(last.id.value, graph_.add_value(keyframe.T_map_body), T_last_new, noise);
      map_.odometry.push_back({last.id, keyframe.id, T_last_new, covariance});
    }
    ++session.keyframes;
    positions_.append(keyframe.T_map_body.translation());
    gnss_.add(keyframe.id, keyframe.time);
    map_.keyframes.push_back(std::move(keyframe));
  }

  void add_factor(const LoopClosure& closure) {
    graph_.add(ClosureFactor{closure.from.value, closure.to.value, closure.T_from_to,
                             Graph::Noise::from_covariance(closure.covariance).sqrt_information(), kernel_});
  }

  void optimise_graph() {
    ++counts_.optimisations;
    counts_.last = optimise(graph_, options_.optimizer, solver_);
    if (!counts_.last.ok()) {
      ++counts_.failed_optimisations;
      return;
    }
    for (Keyframe& keyframe : map_.keyframes) keyframe.T_map_body = graph_[keyframe.id.value];
    positions_.rebuild(map_.keyframes);
    snapshot_.store(std::make_shared<const SlamMap>(map_));
  }

  void publish_frame() {
    if (map_.keyframes.empty()) return;
    const Keyframe& newest = map_.keyframes.back();
    T_map_odom_.store(std::make_shared<const SE3d>(newest.T_map_body * newest.T_odom_body.inverse()));
  }

  BackEndOptions options_;
  Closer closer_;
  [[no_unique_address]] Kernel kernel_;
  SlamMap map_;
  Graph graph_;
  BlockCholesky<6> solver_;
  PositionIndex positions_;
  GnssInterpolator gnss_;
  BackEndCounts counts_;
  Snapshot<SlamMap> snapshot_;
  Snapshot<SE3d> T_map_odom_;
};

}  // namespace chainslam
