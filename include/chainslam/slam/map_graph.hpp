#pragma once

#include <algorithm>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "chainslam/core/finite.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/map/slam_map.hpp"

namespace chainslam {

/// How far odometry between two keyframes may be off, by the way between them.
struct OdometryNoise {
  double translation = 0.02;             ///< metres per step,
  double translation_per_metre = 0.005;  ///< and per metre travelled
  double rotation = 0.001;               ///< radians per step,
  double rotation_per_metre = 0.0002;    ///< and per metre travelled

  /// Of T_from_to, tangent [translation; rotation].
  [[nodiscard]] NoiseModel<6> operator()(const SE3d& T_from_to) const {
    const double way = T_from_to.translation().norm();
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(translation + translation_per_metre * way),
        Eigen::Vector3d::Constant(rotation + rotation_per_metre * way);
    return NoiseModel<6>::from_sigmas(sigmas);
  }
};

struct MapGraphOptions {
  OdometryNoise odometry_noise{};
  /// Standard deviation of the prior that holds a frame's first keyframe, metres and radians.
  double anchor = 1e-4;
  /// Whether a session that a merge joins to another frame is held there, at its aligned start, by a prior as tight
  /// (the paper); else closures alone tie it to the others.
  bool anchor_joined_sessions = false;
  /// Whether measurements of a loaded map are replaced by what its optimum says of them, as the released code does: the
  /// map then has no residuals, and counts what it knows twice.
  bool remeasure_loaded = false;
  LevenbergMarquardt optimizer{.max_iterations = 50, .relative_tolerance = 1e-6};
};

/// A map and its pose graph: a variable for each keyframe, a prior for each frame, factors for odometry and closures.
///
/// Sessions start in frames of their own. `join` carries one frame over into another.
/// @tparam Kernel  weighs closures down that the rest of the graph contradicts; in standard deviations.
template <class Kernel = Cauchy>
class MapGraph {
  static_assert(RobustCost<Kernel>,
                "BackEnd: Kernel needs `double weight(double squared_residual) const` and `double cost(double "
                "squared_residual) const`, as in Cauchy");

 public:
  using ClosureFactor = BetweenFactor<SE3d, Kernel>;
  using Graph = std::conditional_t<std::is_same_v<Kernel, Trivial>, PoseGraph, FactorGraph<SE3d, ClosureFactor>>;

  explicit MapGraph(const MapGraphOptions& options = {}, Kernel kernel = {})
      : options_(options), kernel_(std::move(kernel)) {}

  [[nodiscard]] const SlamMap& map() const { return map_; }
  [[nodiscard]] const Graph& graph() const { return graph_; }
  /// The session whose start defines the frame of a keyframe's T_map_body.
  [[nodiscard]] SessionId frame(const Keyframe& keyframe) const { return session(keyframe.session).frame; }

  /// Keyframes appended from now on are of a new session, in a frame of its own.
  void begin_session(std::string name) {
    const SessionId id{to_index(map_.sessions.size())};
    map_.sessions.push_back({id, std::move(name), to_index(map_.keyframes.size()), 0, id, {}, {}});
  }

  /// @throws std::invalid_argument if the keyframe's pose is not finite, or so far away that its square is not.
  static void require_finite(const Keyframe& keyframe) {
    const SE3d& T = keyframe.T_odom_body;
    // |a - b|^2 <= 4 max(|a|^2, |b|^2): no way between two keyframes overflows.
    if (!is_finite(T.matrix()) || !is_finite(4 * T.translation().squaredNorm()))
      throw std::invalid_argument("BackEnd: a keyframe's pose is not finite");
  }

  /// Adds the session's next keyframe, where odometry puts it.
  /// @throws std::invalid_argument if its time is not later than the session's last, or T_odom_body is not finite; the
  /// map is then as it was.
  KeyframeId append(Keyframe keyframe) {
    check(keyframe);
    if (map_.sessions.empty()) begin_session({});
    Session& session = map_.sessions.back();
    keyframe.id = KeyframeId{to_index(map_.keyframes.size())};
    keyframe.session = session.id;
    if (session.keyframes == 0) {
      keyframe.T_map_body = keyframe.T_odom_body;
      session.prior = keyframe.T_map_body;
      session.prior_sqrt_information = NoiseModel<6>::from_sigma(options_.anchor).sqrt_information();
    } else {
      const Keyframe& last = map_.keyframes.back();
      const SE3d T_last_new = last.T_odom_body.inverse() * keyframe.T_odom_body;
      keyframe.T_map_body = last.T_map_body * T_last_new;
      map_.odometry.push_back(
          {last.id, keyframe.id, T_last_new, options_.odometry_noise(T_last_new).sqrt_information()});
    }
    graph_.add_value(keyframe.T_map_body);
    if (session.keyframes++ == 0)
      add_prior(session);
    else
      add_factor(map_.odometry.back());
    map_.keyframes.push_back(std::move(keyframe));
    return map_.keyframes.back().id;
  }

  void set_gnss(KeyframeId id, const GnssFix& fix) { map_.keyframes[static_cast<std::size_t>(id.value)].gnss = fix; }

  /// @returns the closure's position among the map's closures.
  Index accept(const LoopClosure& closure) {
    add_factor(closure);
    map_.closures.push_back(closure);
    return to_index(map_.closures.size()) - 1;
  }
  void refuse(const LoopClosure& closure) { map_.refusals.push_back(closure); }

  /// Carries all sessions of the frame `joined` over into `frame`, and makes the graph anew: priors at the aligned
  /// poses, or none.
  void join(SessionId frame, SessionId joined, const SE3d& T_frame_joined) {
    for (Session& session : map_.sessions) {
      if (session.frame != joined) continue;
      session.frame = frame;
      for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i) {
        SE3d& T_map_body = map_.keyframes[static_cast<std::size_t>(i)].T_map_body;
        T_map_body = T_frame_joined * T_map_body;
      }
      session.prior = T_frame_joined * session.prior;
      if (options_.anchor_joined_sessions && session.keyframes > 0)
        session.prior = map_.keyframes[static_cast<std::size_t>(session.first_keyframe)].T_map_body;
      else
        session.prior_sqrt_information.setZero();
    }
    rebuild();
  }

  /// Adds another map: its sessions follow those that are here, in frames of their own, and everything in it keeps the
  /// measurements it had. If the map is empty, all numbers stay the same.
  void load(const SlamMap& other) {
    const Index keyframes = to_index(map_.keyframes.size());
    const Index sessions = to_index(map_.sessions.size());
    const Index closures = to_index(map_.closures.size());
    const auto moved = [&](KeyframeId id) { return KeyframeId{id.value + keyframes}; };
    for (Session session : other.sessions) {
      session.id.value += sessions;
      session.frame.value += sessions;
      session.first_keyframe += keyframes;
      map_.sessions.push_back(std::move(session));
    }
    for (Keyframe keyframe : other.keyframes) {
      keyframe.id = moved(keyframe.id);
      keyframe.session.value += sessions;
      map_.keyframes.push_back(std::move(keyframe));
    }
    for (OdometryMeasurement step : other.odometry) {
      step.from = moved(step.from);
      step.to = moved(step.to);
      map_.odometry.push_back(step);
    }
    const auto append_closures = [&](const std::vector<LoopClosure>& from, std::vector<LoopClosure>& to) {
      for (LoopClosure closure : from) {
        closure.from = moved(closure.from);
        closure.to = moved(closure.to);
        if (closure.cause >= 0) closure.cause += closures;
        to.push_back(closure);
      }
    };
    append_closures(other.closures, map_.closures);
    append_closures(other.refusals, map_.refusals);
    if (options_.remeasure_loaded) remeasure();
    rebuild();
  }

  /// Moves the keyframes to the graph's optimum; leaves them where they are if there is none.
  OptimizeReport optimise() {
    const OptimizeReport report = chainslam::optimise(graph_, options_.optimizer, solver_);
    if (report.ok())
      for (Keyframe& keyframe : map_.keyframes) keyframe.T_map_body = graph_[keyframe.id.value];
    return report;
  }

 private:
  [[nodiscard]] const Session& session(SessionId id) const { return map_.sessions[static_cast<std::size_t>(id.value)]; }

  void check(const Keyframe& keyframe) const {
    require_finite(keyframe);
    if (!map_.sessions.empty() && map_.sessions.back().keyframes > 0 && keyframe.time <= map_.keyframes.back().time)
      throw std::invalid_argument("BackEnd: a keyframe's time is not later than the one before it");
  }

  void remeasure() {
    const auto pose = [&](KeyframeId id) { return map_.keyframes[static_cast<std::size_t>(id.value)].T_map_body; };
    for (OdometryMeasurement& step : map_.odometry) step.T_from_to = pose(step.from).inverse() * pose(step.to);
    for (LoopClosure& closure : map_.closures) closure.T_from_to = pose(closure.from).inverse() * pose(closure.to);
  }

  void rebuild() {
    graph_ = Graph();
    for (const Keyframe& keyframe : map_.keyframes) graph_.add_value(keyframe.T_map_body);
    for (const Session& session : map_.sessions) add_prior(session);
    for (const OdometryMeasurement& step : map_.odometry) add_factor(step);
    for (const LoopClosure& closure : map_.closures) add_factor(closure);
  }

  void add_prior(const Session& session) {
    if (session.keyframes > 0 && !session.prior_sqrt_information.isZero(0))
      graph_.add(PriorFactor<SE3d>{session.first_keyframe, session.prior, session.prior_sqrt_information});
  }
  void add_factor(const OdometryMeasurement& step) {
    graph_.add(BetweenFactor<SE3d>{step.from.value, step.to.value, step.T_from_to, step.sqrt_information});
  }
  void add_factor(const LoopClosure& closure) {
    if (!closure.sqrt_information.isZero(0))
      graph_.add(
          ClosureFactor{closure.from.value, closure.to.value, closure.T_from_to, closure.sqrt_information, kernel_});
  }

  MapGraphOptions options_;
  [[no_unique_address]] Kernel kernel_;
  SlamMap map_;
  Graph graph_;
  BlockCholesky<6> solver_;
};

}  // namespace chainslam
