#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/slam/detail/fixes_on_ground.hpp"
#include "chainslam/slam/georeference.hpp"
#include "chainslam/slam/gravity_measurement.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::detail {

/// A map's factors where closures have a robust kernel, in standard deviations, and odometry is never rejected.
template <class Kernel>
class KernelFactors {
 public:
  using ClosureFactor = BetweenFactor<SE3d, Kernel>;  ///< the factor of a closure
  /// The smoother behind.
  using Smoother = std::conditional_t<std::is_same_v<Kernel, Trivial>, IncrementalSmoother<SE3d>,
                                      IncrementalSmoother<SE3d, ClosureFactor>>;

  /// An empty graph.
  template <class Options>
  [[gnu::cold]] KernelFactors(const Options& options, Kernel kernel)
      : smoother_(options.smoother, NoLag{}), kernel_(std::move(kernel)) {}

  [[nodiscard]] Smoother& smoother() { return smoother_; }              ///< the smoother behind
  [[nodiscard]] const Smoother& smoother() const { return smoother_; }  ///< the smoother behind

  /// Adds a factor.
  void add(const OdometryMeasurement& step) {
    smoother_.add(BetweenFactor<SE3d>{step.from.value, step.to.value, step.T_from_to, step.sqrt_information});
  }
  /// Adds the closure at a position among the map's.
  [[gnu::cold]] void add_closure(const SlamMap& map, Index position) {
    const LoopClosure& closure = map.closures[static_cast<std::size_t>(position)];
    if (!closure.is_factor()) return;
    smoother_.add(
        ClosureFactor{closure.from.value, closure.to.value, closure.T_from_to, closure.sqrt_information, kernel_});
  }

  /// Fixes do not hold a map with kernels.
  void wait(const Keyframe& /*keyframe*/) {}
  void wait_for_fix(const Keyframe& /*keyframe*/) {}  ///< nothing
  void carry(std::span<const Key> /*keyframes*/) {}   ///< nothing: keyframes are carried by the smoother alone
  [[nodiscard]] Index waiting() const { return 0; }   ///< always 0

  /// Nothing waits.
  [[nodiscard]] bool admit() { return false; }

  /// Takes in what was added and makes the estimate better.
  [[nodiscard]] UpdateReport update(const SlamMap& /*map*/) { return smoother_.update(); }
  /// Keys whose estimate the last update changed.
  [[nodiscard]] std::span<const Key> changed() const { return smoother_.changed(); }
  /// Goes on to a local optimum.
  template <class Options, Executor E>
  [[nodiscard]] [[gnu::cold]] ConvergeReport converge(const Options& options, SlamMap& /*map*/, const E& executor) {
    return smoother_.converge(options, executor);
  }
  [[nodiscard]] bool record(SlamMap& /*map*/) const { return false; }  ///< nothing: kernels keep no record of outliers

 private:
  Smoother smoother_;
  [[no_unique_address]] Kernel kernel_;
};

/// Holds a map's keyframes where their GNSS fixes say, once it is known where each frame of the map lies on the Earth.
///
/// That is found out by the estimate, and again when a frame has a quarter more fixes than the last time; so is each
/// session's bias, which would otherwise pull sessions apart that closures have put together.
/// @tparam Gnc  takes the priors as candidates: `IncrementalGnc`. Its keys are the map's keyframes.
template <class Gnc>
class GnssFactors {
 public:
  explicit GnssFactors(const GnssFactorOptions& options) : options_(options) {}  ///< starts without fixes

  /// Takes a keyframe's fix, which the next `add` will put into the graph; none or one of no use: does nothing.
  [[gnu::cold]] void wait(const Keyframe& keyframe) {
    if (options_.enabled && keyframe.gnss && is_usable(*keyframe.gnss, options_)) waiting_.push_back(keyframe.id.value);
  }
  [[nodiscard]] Index waiting() const { return to_index(waiting_.size()); }  ///< fixes that wait for a factor

  /// Keyframes go over to another frame: their fixes wait again.
  [[gnu::cold]] void carry(std::span<const Index> keyframes, Gnc& gnc) {
    for (const Index i : keyframes) {
      if (i >= priors_.size() || priors_[i] < 0) continue;
      gnc.remove(std::exchange(priors_[i], -1));
      waiting_.push_back(i);
    }
  }

  /// Where frames lie on the Earth is determined again by the next `add`.
  void renew() {
    for (Index i = 0; i < on_earth_.size(); ++i) on_earth_[i].fitted = 0;
  }

  /// Puts into the graph what waits.
  [[gnu::cold]] void add(const SlamMap& map, Gnc& gnc) {
    if (!options_.enabled) return;
    on_earth_.resize(to_index(map.sessions.size()));
    biases_.resize(to_index(map.sessions.size()), Eigen::Vector3d::Zero());
    priors_.resize(to_index(map.keyframes.size()), -1);
    const std::vector<Index> fresh = std::exchange(waiting_, {});
    for (const Index i : fresh) ++on_earth_[frame(map, i).value].fixes;
    for (const Session& session : map.sessions)
      if (session.frame == session.id) fit(map, session.id, gnc);
    for (const Index i : fresh)
      if (const Earth& earth = on_earth_[frame(map, i).value]; earth.T_frame_ecef && priors_[i] < 0)
        put(map, i, *earth.T_frame_ecef, gnc);
  }

  /// How much better the fixes of the newest session are explained, in squared deviations, if its path moves by
  /// `T_new_old` from some keyframe on, `last` at the latest.
  [[nodiscard]] [[gnu::cold]] double gain(const SlamMap& map, const SE3d& T_new_old, Index last, const Gnc& gnc) const {
    double sum = 0, best = 0;
    for (Index i = to_index(map.keyframes.size()); i-- > map.sessions.back().first_keyframe;) {
      if (i < priors_.size() && priors_[i] >= 0) {
        const auto& fix = gnc.factor(priors_[i]);
        const SE3d& here = map.keyframes[static_cast<std::size_t>(i)].T_map_body;
        const auto squared = [&](const SE3d& pose) {
          const auto residual = whitened<6, 1>(fix.sqrt_information, (fix.measurement.inverse() * pose).log());
          return std::min(residual.squaredNorm(), gnc.threshold(priors_[i]));
        };
        sum += squared(here) - squared(T_new_old * here);
      }
      if (i <= last) best = std::max(best, sum);
    }
    return best;
  }

  /// Calls visit(k, evidence) for each of a session's last keyframes that a step of odometry leads to: by how many
  /// squared deviations the way that the fixes go is explained better, if that step has failed and what is behind it
  /// lies where its fixes are.
  /// @param join  SE3d(k): carries what is behind the step to where the step by itself would have it
  template <class Join, class Visit>
  [[gnu::cold]] void for_each_failed_step(const SlamMap& map, const Session& session, const Join& join,
                                          Visit&& visit) const {
    constexpr std::size_t behind = 5;  // fixes at least: fewer lie anywhere by chance
    const detail::Table<FixInMap> fixes = last_fixes(map, session);
    const std::span<const FixInMap> all = fixes.all();
    for (std::size_t i = 1; i + behind <= all.size(); ++i) {
      const double failed = squared_differences(all.subspan(i - 1), onto_fixes(all.subspan(i)), options_);
      for (Index k = all[i - 1].keyframe + 1; k <= all[i].keyframe; ++k) {
        const SE3d T = join(k);
        detail::Table<FixInMap> joined(all.subspan(i - 1));
        for (Offset j = 1; j < joined.size(); ++j) joined[j].position = T * joined[j].position;
        visit(k, squared_differences(std::span<const FixInMap>(joined.all()), OnGround(), options_) - failed);
      }
    }
  }

 private:
  /// A frame on the Earth.
  struct Earth {
    std::optional<SE3d> T_frame_ecef;
    Index fixes = 0, fitted = 0;  ///< so far, and when it was found out
  };

  /// The session's last fixes, as many as are looked at, if it is known where its frame lies on the Earth.
  [[nodiscard]] [[gnu::cold]] detail::Table<FixInMap> last_fixes(const SlamMap& map, const Session& session) const {
    constexpr Offset looked_at = 60;
    detail::Table<FixInMap> fixes;
    if (session.frame.value >= on_earth_.size() || !on_earth_[session.frame.value].T_frame_ecef) return fixes;
    for (Index i = session.end_keyframe(); i-- > session.first_keyframe && fixes.size() < looked_at;) {
      const Keyframe& one = map.keyframes[static_cast<std::size_t>(i)];
      if (!one.gnss || !is_usable(*one.gnss, options_)) continue;
      FixInMap fix;
      fix.position = one.T_map_body * options_.antenna;
      fix.ecef = *on_earth_[session.frame.value].T_frame_ecef * one.gnss->position_ecef - biases_[session.id.value];
      fix.keyframe = i;
      fix.time = to_seconds(one.time - map.keyframes[static_cast<std::size_t>(session.first_keyframe)].time);
      fix.variance = one.gnss->covariance_ecef.trace() / 3;
      fixes.push_back(fix);
    }
    std::reverse(fixes.begin(), fixes.end());
    return fixes;
  }

  [[nodiscard]] static SessionId frame(const SlamMap& map, Index i) {
    const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
    return map.sessions[static_cast<std::size_t>(keyframe.session.value)].frame;
  }

  [[gnu::cold]] void fit(const SlamMap& map, SessionId id, Gnc& gnc) {
    Earth& earth = on_earth_[id.value];
    if (earth.fixes <= earth.fitted || 4 * earth.fixes < 5 * earth.fitted) return;
    std::vector<FixedPosition> fixed;
    std::vector<Index> of;
    for (const Keyframe& one : map.keyframes) {
      if (!one.gnss || frame(map, one.id.value) != id || !is_usable(*one.gnss, options_)) continue;
      fixed.push_back({one.T_map_body * options_.antenna, one.gnss->position_ecef});
      of.push_back(one.id.value);
    }
    const std::optional<SE3d> found = georeference(fixed, options_);
    if (!found) return;
    earth.T_frame_ecef = found;
    earth.fitted = earth.fixes;
    find_biases(map, id, fixed, of);
    for (const Index i : of) put(map, i, *found, gnc);
  }

  /// Medians of each session's differences, drawn towards zero where there are few.
  [[gnu::cold]] void find_biases(const SlamMap& map, SessionId id, std::span<const FixedPosition> fixed,
                                 std::span<const Index> of) {
    for (const Session& session : map.sessions) {
      if (session.frame != id) continue;
      std::array<detail::Table<Ranked>, 3> off;
      double independent = 0;  // fixes
      const auto first = std::lower_bound(of.begin(), of.end(), session.first_keyframe) - of.begin();
      for (auto k = static_cast<std::size_t>(first); k < of.size() && of[k] < session.end_keyframe(); ++k) {
        independent += 1 / correlated(map, of[k]);
        const Eigen::Vector3d there = *on_earth_[id.value].T_frame_ecef * fixed[k].ecef;
        for (std::size_t axis = 0; axis < 3; ++axis)
          off[axis].push_back({there.data()[axis] - fixed[k].position.data()[axis], of[k]});
      }
      if (off[0].empty()) continue;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        sort_ranked(off[axis].all());
        biases_[session.id.value].data()[axis] = off[axis][off[axis].size() / 2].rank * independent / (independent + 1);
      }
    }
  }

  /// How many fixes count as one at a keyframe. A session's first counts as if there were one each second.
  [[nodiscard]] [[gnu::cold]] double correlated(const SlamMap& map, Index i) const {
    const auto keyframe = [&](Index k) -> const Keyframe& { return map.keyframes[static_cast<std::size_t>(k)]; };
    const Index first = map.sessions[static_cast<std::size_t>(keyframe(i).session.value)].first_keyframe;
    double since = 1;
    for (Index k = i - 1; k >= first; --k) {
      const double ago = to_seconds(keyframe(i).time - keyframe(k).time);
      if (ago < 2 * options_.correlation_time && !(keyframe(k).gnss && is_usable(*keyframe(k).gnss, options_)))
        continue;
      since = ago;
      break;
    }
    return correlated_fixes(since, options_);
  }

  [[gnu::cold]] void put(const SlamMap& map, Index i, const SE3d& T_frame_ecef, Gnc& gnc) {
    const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
    const Eigen::Vector3d antenna = T_frame_ecef * keyframe.gnss->position_ecef - biases_[keyframe.session.value];
    const double fixes = correlated(map, i);
    const PriorFactor<SE3d> prior = position_prior(i, antenna, *keyframe.gnss, T_frame_ecef.rotation(),
                                                   keyframe.T_map_body.rotation(), fixes, options_);
    if (priors_[i] < 0)
      priors_[i] = gnc.add(prior, {.threshold = options_.threshold / fixes});
    else if (differs(gnc.factor(priors_[i]), prior))
      gnc.replace(priors_[i], prior.mean, prior.sqrt_information);
  }

  /// Whether it is worth the linearization of all that hangs on it to put one prior in place of another.
  template <class Prior>
  [[nodiscard]] static bool differs(const Prior& present, const PriorFactor<SE3d>& next) {
    constexpr double negligible = 0.1;  // standard deviations
    const Vector6d off = (present.measurement.inverse() * next.mean).log();
    return whitened<6, 1>(present.sqrt_information, off).squaredNorm() > negligible * negligible;
  }

  GnssFactorOptions options_;
  std::vector<Index> waiting_;             ///< keyframes whose fixes are to be added
  detail::Table<Index> priors_;            ///< of each keyframe its fix's number among the candidates, -1 if none
  detail::Table<Earth> on_earth_;          ///< of each session that defines a frame
  detail::Table<Eigen::Vector3d> biases_;  ///< of each session's fixes, in its frame, metres
};

/// Holds a map's keyframes upright by what the accelerometer measured between their frames: one direction for each
/// window of time, at the keyframe in its middle.
///
/// Only in frames whose first session measures gravity: these lean no more than it does. Others, such as those of maps
/// without such measurements, stay as they are.
/// @tparam Gnc  takes the priors as candidates: `IncrementalGnc`. Its keys are the map's keyframes.
template <class Gnc>
class GravityFactors {
 public:
  /// Starts without keyframes.
  explicit GravityFactors(const GravityFactorOptions& options) : options_(options) {}

  /// The keyframe will be looked at by the next `add`; keyframes of a session come in their order.
  void wait(KeyframeId id) {
    if (options_.enabled) waiting_.push_back(id.value);
  }

  /// Keyframes go over to another frame: their directions wait again.
  [[gnu::cold]] void carry(std::span<const Index> keyframes, Gnc& gnc) {
    for (const Index i : keyframes) {
      if (i >= known_.size() || !known_[i].measured) continue;
      if (known_[i].prior >= 0) gnc.remove(std::exchange(known_[i].prior, -1));
      waiting_.push_back(i);
    }
  }

  /// Puts into the graph what waits.
  /// @returns sessions whose frames are held upright from now on.
  [[nodiscard]] [[gnu::cold]] std::vector<SessionId> add(const SlamMap& map, Gnc& gnc) {
    std::vector<SessionId> held;
    if (waiting_.empty()) return held;
    known_.resize(to_index(map.keyframes.size()));
    begins_.resize(to_index(map.sessions.size()));
    upright_.resize(to_index(map.sessions.size()), 0);
    for (const Index i : std::exchange(waiting_, {})) {
      if (known_[i].measured)
        put(map, i, gnc, held);
      else if (const Index middle = measure(map, i); middle >= 0)
        put(map, middle, gnc, held);
    }
    return held;
  }

 private:
  struct Known {
    std::optional<GravityMeasurement> measured{};
    Index prior = -1;  ///< its number among the candidates, -1 if none
  };

  /// If a window ends at a keyframe, measures the direction. @returns the keyframe that has it, -1 if none.
  Index measure(const SlamMap& map, Index last) {
    const auto keyframe = [&](Index i) -> const Keyframe& { return map.keyframes[static_cast<std::size_t>(i)]; };
    const Keyframe& end = keyframe(last);
    std::optional<Timestamp>& begin = begins_[end.session.value];
    if (!begin) begin = end.time;
    const double duration = to_seconds(end.time - *begin);
    if (duration < options_.window) return -1;
    const Timestamp from = std::exchange(*begin, end.time);
    const auto measured = measure_gravity(map.frames.between(end.session, from, end.time), options_);
    if (!measured) return -1;
    Index middle = last;
    while (to_seconds(end.time - keyframe(middle).time) < 0.5 * duration) --middle;
    const SO3d& R_odom_body = keyframe(middle).T_odom_body.rotation();
    known_[middle].measured = {R_odom_body.inverse() * measured->up, measured->sigma};
    return middle;
  }

  void put(const SlamMap& map, Index i, Gnc& gnc, std::vector<SessionId>& held) {
    const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
    const SessionId frame = map.sessions[static_cast<std::size_t>(keyframe.session.value)].frame;
    if (keyframe.session == frame && std::exchange(upright_[frame.value], 1) == 0) held.push_back(frame);
    if (upright_[frame.value] != 0 && known_[i].prior < 0)
      known_[i].prior =
          gnc.add(gravity_prior(i, *known_[i].measured, keyframe.T_map_body), {.threshold = options_.threshold});
  }

  GravityFactorOptions options_;
  std::vector<Index> waiting_;
  detail::Table<Known> known_;                      ///< of each keyframe
  detail::Table<std::optional<Timestamp>> begins_;  ///< of each session's window
  detail::Table<char> upright_;                     ///< of each session, whether its frame is held
};

}  // namespace chainslam::detail
