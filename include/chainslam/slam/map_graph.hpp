#pragma once

#include <algorithm>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/compiled.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/slam/back_end_options.hpp"
#include "chainslam/slam/detail/graph_factors.hpp"
#include "chainslam/slam/frame_parting.hpp"
#include "chainslam/slam/group_gnc.hpp"
#include "chainslam/slam/odometry_noise.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// A map and its pose graph: a variable for each keyframe, a prior for each frame, factors for odometry and closures.
///
/// Sessions start in frames of their own. `join` carries one frame over into another. What changes the map is called by
/// one thread; `snapshot` may be called by any.
/// What is done once a session, a merge or a load is compiled for size (`gnu::cold`).
/// @tparam Outliers  what becomes of measurements that the rest of the graph contradicts: `GroupGnc`, or a robust
/// kernel of closures, in standard deviations.
template <class Outliers = GroupGnc>
class MapGraph {
  static constexpr bool decides = std::is_same_v<Outliers, GroupGnc>;
  static_assert(decides || RobustCost<Outliers>,
                "BackEnd: Outliers is GroupGnc, or a kernel with `double weight(double squared_residual) const` and "
                "`double cost(double squared_residual) const`, as in Cauchy");
  using Factors = typename std::conditional_t<decides, std::type_identity<GroupGncFactors>,
                                              std::type_identity<detail::KernelFactors<Outliers>>>::type;

 public:
  using ClosureFactor = typename Factors::ClosureFactor;  ///< the factor of a closure
  using Smoother = typename Factors::Smoother;            ///< the smoother behind

  /// An empty map.
  [[gnu::cold]] explicit MapGraph(const MapGraphOptions& options = {}, Outliers outliers = {})
      : options_(options), outliers_(std::move(outliers)), factors_(std::in_place, options, outliers_) {}

  /// For the thread that changes the map.
  [[nodiscard]] const SlamMap& map() const { return map_; }
  /// The map as it is, whole: copied where it has changed since the last call, at the cost of the thread that asks.
  [[nodiscard]] [[gnu::cold]] std::shared_ptr<const SlamMap> snapshot() const {
    const std::scoped_lock lock(changing_);
    if (!snapshot_) snapshot_ = std::make_shared<const SlamMap>(map_);
    return snapshot_;
  }
  /// The map, given away: this has none any more.
  [[nodiscard]] [[gnu::cold]] std::shared_ptr<const SlamMap> release() {
    const Change change(*this);
    return std::make_shared<const SlamMap>(std::move(map_));
  }
  /// The variables are the keyframes, by number.
  [[nodiscard]] const Smoother& smoother() const { return factors_->smoother(); }
  /// The session whose start defines the frame of a keyframe's T_map_body.
  [[nodiscard]] SessionId frame(const Keyframe& keyframe) const { return session(keyframe.session).frame; }

  /// Keyframes appended from now on are of a new session, in a frame of its own.
  [[gnu::cold]] void begin_session(std::string name);

  /// Adds the session's next keyframe, where odometry puts it.
  /// @throws std::invalid_argument if its time is not later than the session's last, or T_odom_body is not finite; the
  /// map is then as it was.
  KeyframeId append(Keyframe keyframe);

  /// Adds the newest session's next frames, with their health. Those up to a keyframe come before it: what they say of
  /// odometry since the last keyframe is in the measurement between the two.
  /// @throws std::invalid_argument if times do not increase or something is not finite; the map is then as it was.
  [[gnu::cold]] void append(std::span<const FrameRecord> frames);

  /// Gives a keyframe a fix, now or `with_previous`: together with that of the keyframe before.
  void set_gnss(KeyframeId id, const GnssFix& fix, bool with_previous = false);
  /// Fixes that the next optimization will take in.
  [[nodiscard]] Index waiting_fixes() const { return factors_->waiting(); }

  /// @returns the closure's position among the map's closures.
  [[gnu::cold]] Index accept(const LoopClosure& closure);
  /// Notes a closure that was refused.
  [[gnu::cold]] void refuse(const LoopClosure& closure) {
    const Change change(*this);
    map_.refusals.push_back(closure);
  }

  /// Carries all sessions of the frame `joined` over into `frame`, as one body: what lies between their keyframes stays
  /// as it is linearized. They keep priors at the aligned poses, or none.
  [[gnu::cold]] void join(SessionId frame, SessionId joined, const SE3d& T_frame_joined);

  /// Joins the frames of a closure's keyframes where it puts them, the later one to the earlier. One frame stays as it
  /// is.
  [[gnu::cold]] void join(const LoopClosure& closure);

  /// Takes closures back, by their positions, with all that they led to, and parts frames that no accepted closure
  /// holds together any more: what leaves a frame goes back to where odometry has it. Poses are to be optimized then.
  /// @returns whether anything changed.
  [[gnu::cold]] bool part(std::span<const Index> withdrawn = {});

  /// Adds another map: its sessions follow those that are here, in frames of their own, and everything in it keeps the
  /// measurements and verdicts it had. If the map is empty, all numbers stay the same.
  [[gnu::cold]] void load(const SlamMap& other);

  /// Takes in what was added, and moves the keyframes to the optimum, as near as the smoother's tolerances say. If that
  /// fails they stay, and what was added waits for the next time.
  [[gnu::cold]] UpdateReport optimize();
  /// Keyframes that the last one moved, some several times.
  [[nodiscard]] std::span<const Key> moved() const { return moved_.all(); }
  /// Whether the last one left something to the next (`MapGraphOptions::largest_work`).
  [[nodiscard]] bool is_unfinished() const { return unfinished_; }

  /// The same, to the end. An executor shares out the work; any gives bit-identical results.
  template <Executor E = Serial>
  [[gnu::cold]] ConvergeReport converge(const E& executor = {});

 private:
  /// While it lives, the map changes, and nobody else reads it.
  class Change {
   public:
    explicit Change(MapGraph& graph) : lock_(graph.changing_) { graph.snapshot_.reset(); }

   private:
    std::scoped_lock<std::mutex> lock_;
  };

  [[nodiscard]] Keyframe& keyframe(Index i) { return map_.keyframes[static_cast<std::size_t>(i)]; }
  [[nodiscard]] const Session& session(SessionId id) const { return map_.sessions[static_cast<std::size_t>(id.value)]; }
  [[nodiscard]] [[gnu::cold]] NoiseModel<6> odometry_noise(const Keyframe& last, const Keyframe& next) const;
  [[gnu::cold]] void remeasure();

  void take(std::span<const Key> keys) {
    for (const Key key : keys) keyframe(key).T_map_body = smoother()[key];
    moved_.append(keys);
  }

  /// What nothing holds, with closures that wait for a forecast taken in: without them there may be nothing to foresee.
  [[nodiscard]] [[gnu::cold]] std::vector<Key> floating() {
    std::vector<Key> keys = factors_->smoother().floating();
    return keys.empty() || !factors_->admit() ? keys : factors_->smoother().floating();
  }

  /// Takes in what is known of gravity. A frame that it holds may lean from where odometry began it.
  [[gnu::cold]] void hold_upright();
  [[gnu::cold]] void rebuild();
  /// Adds all of the map from these positions on.
  [[gnu::cold]] void add_to_smoother(Index sessions, Index keyframes, Index odometry, Index closures);
  [[gnu::cold]] void add_prior(const Session& session);
  MapGraphOptions options_;
  [[no_unique_address]] Outliers outliers_;
  SlamMap map_;
  std::optional<Factors> factors_;  ///< never empty; optional so that `rebuild` can replace them in place
  detail::Table<FactorId> priors_;  ///< of each session
  detail::Table<Key> moved_;        ///< by the last optimization
  bool unfinished_ = false;
  bool may_part_ = false;  ///< whether something that held frames together was lost since `part` looked
  mutable std::mutex changing_;
  mutable std::shared_ptr<const SlamMap> snapshot_;  ///< null where the map has changed since
};

template <class Outliers>
void MapGraph<Outliers>::begin_session(std::string name) {
  const Change change(*this);
  if (options_.remeasure_loaded) remeasure();
  const SessionId id{to_index(map_.sessions.size())};
  priors_.push_back({});
  map_.sessions.push_back({id, std::move(name), to_index(map_.keyframes.size()), 0, id, {}, {}});
}

template <class Outliers>
KeyframeId MapGraph<Outliers>::append(Keyframe keyframe) {
  require_next(map_, keyframe);
  if (map_.sessions.empty()) begin_session({});
  const Change change(*this);
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
    map_.odometry.push_back({last.id, keyframe.id, T_last_new, odometry_noise(last, keyframe).sqrt_information()});
  }
  factors_->smoother().add_value(keyframe.T_map_body);
  if (session.keyframes++ == 0)
    add_prior(session);
  else
    factors_->add(map_.odometry.back());
  map_.keyframes.push_back(std::move(keyframe));
  factors_->wait(map_.keyframes.back());
  return map_.keyframes.back().id;
}

template <class Outliers>
NoiseModel<6> MapGraph<Outliers>::odometry_noise(const Keyframe& last, const Keyframe& next) const {
  const std::vector<FrameRecord> frames = map_.frames.between(last.session, last.time, next.time);
  const SE3d T_last_next = last.T_odom_body.inverse() * next.T_odom_body;
  const auto says_nothing = [](const FrameRecord& frame) { return frame.covariance.matrix().isZero(0); };
  if (!frames.empty() && std::all_of(frames.begin(), frames.end(), says_nothing))
    return options_.unknown_odometry(T_last_next);
  const Matrix6d stated = options_.odometry_noise.share_of(stated_covariance(frames));
  return options_.odometry_noise(T_last_next, sum_of(stated, options_.odometry_inflation(frames)));
}

template <class Outliers>
void MapGraph<Outliers>::append(std::span<const FrameRecord> frames) {
  if (map_.sessions.empty()) begin_session({});
  const SessionId session = map_.sessions.back().id;
  const bool first = map_.frames.empty() || map_.frames.back().session != session;
  require_sound(frames, first ? nullptr : &map_.frames.back());
  const Change change(*this);
  for (FrameRecord frame : frames) {
    frame.session = session;
    map_.frames.push_back(frame);
  }
}

template <class Outliers>
void MapGraph<Outliers>::set_gnss(KeyframeId id, const GnssFix& fix, bool with_previous) {
  const Change change(*this);
  keyframe(id.value).gnss = fix;
  keyframe(id.value).gnss_arrival = {map_.keyframes.back().id, with_previous};
  factors_->wait_for_fix(keyframe(id.value));
}

template <class Outliers>
Index MapGraph<Outliers>::accept(const LoopClosure& closure) {
  const Change change(*this);
  map_.closures.push_back(closure);
  const Index position = to_index(map_.closures.size()) - 1;
  factors_->add_closure(map_, position);
  return position;
}

template <class Outliers>
void MapGraph<Outliers>::join(SessionId frame, SessionId joined, const SE3d& T_frame_joined) {
  const Change change(*this);
  may_part_ = true;
  std::vector<Key> moved;
  for (Session& session : map_.sessions) {
    if (session.frame != joined) continue;
    session.frame = frame;
    session.prior = T_frame_joined * session.prior;
    if (!options_.anchor_joined_sessions || session.keyframes == 0)
      std::fill_n(session.prior_sqrt_information.data(), 36, 0.0);
    FactorId& prior = priors_[session.id.value];
    if (factors_->smoother().contains(prior)) factors_->smoother().remove(prior);
    for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i) moved.push_back(i);
  }
  factors_->carry(moved);
  factors_->smoother().move(moved, T_frame_joined);
  take(moved);
  if (!options_.anchor_joined_sessions) return;
  for (const Key key : moved) {
    Session& session = map_.sessions[static_cast<std::size_t>(keyframe(key).session.value)];
    if (session.first_keyframe != key) continue;
    session.prior = keyframe(key).T_map_body;
    add_prior(session);
  }
}

template <class Outliers>
void MapGraph<Outliers>::join(const LoopClosure& closure) {
  const Keyframe &j = keyframe(closure.from.value), &i = keyframe(closure.to.value);
  const SE3d T_there_here = j.T_map_body * closure.T_from_to * i.T_map_body.inverse();
  const SessionId there = frame(j), here = frame(i);
  if (there < here) join(there, here, T_there_here);
  if (here < there) join(here, there, T_there_here.inverse());
}

template <class Outliers>
bool MapGraph<Outliers>::part(std::span<const Index> withdrawn) {
  if (withdrawn.empty() && (!std::exchange(may_part_, false) || is_held(map_))) return false;
  const Change change(*this);
  withdraw_closures(map_, withdrawn);
  part_frames(map_, NoiseModel<6>::from_sigma(options_.anchor).sqrt_information());
  rebuild();
  return true;
}

template <class Outliers>
void MapGraph<Outliers>::load(const SlamMap& other) {
  const Change change(*this);
  const Index keyframes = to_index(map_.keyframes.size());
  const Index sessions = to_index(map_.sessions.size());
  const Index odometry = to_index(map_.odometry.size());
  const Index closures = to_index(map_.closures.size());
  may_part_ = true;
  append_map(map_, other);
  priors_.resize(to_index(map_.sessions.size()));
  for (const Keyframe& one : std::span(map_.keyframes).subspan(static_cast<std::size_t>(keyframes)))
    factors_->wait(one);
  if (options_.remeasure_loaded)
    remeasure();
  else
    add_to_smoother(sessions, keyframes, odometry, closures);
  (void)factors_->admit();  // they were judged when they were added
}

template <class Outliers>
UpdateReport MapGraph<Outliers>::optimize() {
  UpdateReport report;
  moved_.clear();
  hold_upright();
  report.variables = floating();
  if (!report.variables.empty()) report.status = UpdateStatus::unconstrained;
  double work = 0;
  for (Index k = 0; report.ok() && work < options_.largest_work && k < options_.optimizer.max_iterations; ++k) {
    report = factors_->update(map_);
    const Change change(*this);
    if (report.ok()) {
      take(factors_->changed());
      may_part_ |= factors_->record(map_);
    } else {
      rebuild();
    }
    if (report.waiting == 0) break;
    work += report.work.multiplications;
  }
  unfinished_ = report.ok() && work >= options_.largest_work;
  return report;
}

template <class Outliers>
template <Executor E>
ConvergeReport MapGraph<Outliers>::converge(const E& executor) {
  ConvergeReport report;
  hold_upright();
  report.variables = floating();
  if (!report.variables.empty()) {
    report.status = UpdateStatus::unconstrained;
    return report;
  }
  const Change change(*this);
  report = factors_->converge(options_.optimizer, map_, executor);
  if (!report.ok()) {
    rebuild();
    return report;
  }
  for (Key key = 0; key < smoother().size(); ++key) keyframe(key).T_map_body = smoother()[key];
  may_part_ |= factors_->record(map_);
  return report;
}

}  // namespace chainslam

// Bodies of its members.
#include "chainslam/slam/detail/map_graph_building.hpp"

#ifdef CHAINSLAM_COMPILED
namespace chainslam {

extern template class IncrementalGnc<IncrementalSmoother<SE3d>>;
extern template class MapGraph<>;
extern template ConvergeReport MapGraph<>::converge(const Serial&);
extern template ConvergeReport MapGraph<>::converge(const ThreadPool&);

}  // namespace chainslam
#endif
