#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/detail/start_hypotheses.hpp"
#include "chainslam/slam/detail/start_pose.hpp"
#include "chainslam/slam/localization.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "chainslam/slam/place_candidates.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// Finds a drive in a map, from nothing, and follows it there. The map is never changed.
///
/// Cold start: places of the map are recognized by the path since the start, and the scan is registered to each. A
/// place is a hypothesis until as many scans as asked for are registered where it and odometry have them, and no other
/// place of the same frame rivals it (`StartOptions`). A scan counts if most of it fits and if it comes back to its
/// place when it is moved along the path, so that neither traffic nor what is new hides a place, nor a street that is
/// the same everywhere looks like one. From then on scans are registered to submaps of the map, and a Kalman filter of
/// the pose weighs them against odometry. A pose that no scan confirms becomes uncertain, and places are sought again;
/// later it is lost, until a place is accepted again.
///
/// A call costs microseconds, with a scan that is registered some 20 ms, and while places are sought some 200 ms.
/// Deterministic; memory is that of the map's scans, which are shared with it, and of the submaps that are kept.
/// @tparam Closer  registers scans: `LoopCloser` with its policies.
/// @tparam Places  recognizes places.
template <class Closer = LoopCloser<>, class Places = PlaceCandidates>
class Localizer {
  static_assert(
      MapRegistration<Closer>,
      "Localizer: Closer needs `std::vector<LoopClosure> search(keyframes, index, query, executor)`, "
      "`LoopClosure align(keyframes, from, to, guess, executor)` and `bool fits_in_part(keyframes, closure)`, "
      "as in LoopCloser");
  static_assert(PlaceRecognition<Places>,
                "Localizer: Places needs `remember(keyframes, end, comparable, executor)`, `std::vector<KeyframeId> "
                "recognize(keyframes, "
                "query)` and `std::optional<SE3d> guess(from, query)`, as in PlaceCandidates");

 public:
  /// Takes in the map: its places are drawn, some 30 ms for each.
  /// @param map  with its scans, which are shared; it may go or change afterwards.
  /// @param executor  shares out the drawing; any gives the same.
  /// @throws std::invalid_argument if it has no scans, a pose is not finite, or an option makes no sense.
  template <Executor E = Serial>
  [[gnu::cold]] explicit Localizer(const SlamMap& map, const LocalizerOptions& options = {}, Closer closer = Closer{},
                                   Places places = Places(localizer_places()), const E& executor = {});

  /// Localizes the next frame of odometry, with or without a scan.
  /// @throws std::invalid_argument if it is not later than the one before, or its pose or covariance is not finite.
  template <Executor E = Serial>
  [[gnu::cold]] Localization process(const Frame& frame, const E& executor = {});

  /// Forgets where the drive is, and its odometry: the next frame is a cold start. The map's places stay.
  [[gnu::cold]] void restart();

  [[nodiscard]] const LocalizerCounts& counts() const { return counts_; }     ///< since the beginning, restarts or not
  [[nodiscard]] const LocalizerOptions& options() const { return options_; }  ///< its settings
  /// Places at which the drive may be, while it is sought.
  [[nodiscard]] std::span<const detail::StartHypothesis> hypotheses() const { return hypotheses_.all(); }

 private:
  /// Where the drive was at a frame of odometry.
  struct Anchor {
    SessionId frame;
    KeyframeId reference;
    detail::UncertainPose at;
    SE3d T_odom_body;
    double registered = 0;                         ///< metres of the path at the last scan that was registered
    std::optional<detail::UncertainPose> other{};  ///< where the last scan was registered, if that is elsewhere
  };

  [[nodiscard]] const Keyframe& keyframe(KeyframeId id) const { return keyframes_[static_cast<std::size_t>(id.value)]; }
  [[nodiscard]] SessionId frame_of(KeyframeId id) const {
    return frames_of_sessions_[static_cast<std::size_t>(keyframe(id).session.value)];
  }
  [[nodiscard]] PositionIndex& index_of(SessionId frame) { return positions_[static_cast<std::size_t>(frame.value)]; }

  static void require_sound(const Frame& frame);
  /// The covariance of odometry from the anchor's frame, or the one before, to the newest.
  [[nodiscard]] [[gnu::cold]] Matrix6d odometry_noise(const SE3d& T_from_to) const;
  /// A pose moved from one frame of odometry to another one.
  [[nodiscard]] [[gnu::cold]] detail::UncertainPose moved_by(const detail::UncertainPose& from,
                                                             const SE3d& T_from_to) const {
    return moved(from, T_from_to, odometry_noise(T_from_to));
  }
  /// Whether the last scan was long enough ago.
  [[nodiscard]] bool is_due(Timestamp time) const {
    return travelled_at_.empty() || to_seconds(time - keyframes_.back().time) >= options_.min_period;
  }
  [[gnu::cold]] void append(Keyframe keyframe);
  [[gnu::cold]] void forget_path();
  [[gnu::cold]] void set_anchor(SessionId frame, KeyframeId reference, const detail::UncertainPose& at,
                                const Frame& now);
  /// Goes on from a scan that was not registered, or elsewhere, where odometry has it.
  [[gnu::cold]] void pass_by(const Frame& now, const std::optional<detail::UncertainPose>& other);
  /// Where a closure puts the scan, as evidence for a start: see `detail::start_pose`.
  template <Executor E>
  [[nodiscard]] std::optional<detail::UncertainPose> start_pose(const LoopClosure& closure, const E& executor) {
    return detail::start_pose(closer_, keyframes_, closure, hypotheses_, options_.max_deviation, executor);
  }

  template <Executor E>
  [[gnu::cold]] void track(const Frame& now, const E& executor);
  template <Executor E>
  [[gnu::cold]] void search(const Frame& now, const E& executor);
  template <Executor E>
  [[gnu::cold]] void try_scan(detail::StartHypothesis& hypothesis, Index scan, const E& executor);
  /// Whether the newest scan has been registered where a recognized place has it, about.
  [[nodiscard]] [[gnu::cold]] bool is_known(SessionId frame, const SE3d& T_map_body);
  /// Discards the pose if it is lost by now.
  [[nodiscard]] [[gnu::cold]] LocalizationStatus updated_status();

  LocalizerOptions options_;
  Closer closer_;
  Places places_;
  ProximityCandidates near_{.max_count = 1};
  std::vector<Keyframe> keyframes_;            ///< the map's, then the drive's last ones
  std::vector<SessionId> frames_of_sessions_;  ///< of the map
  std::vector<PositionIndex> positions_;       ///< of the map's keyframes, by frame
  Index map_keyframes_ = 0;
  std::vector<double> travelled_at_;  ///< the drive's last keyframes: metres of the path
  KeyframeSelector select_;
  detail::StartHypotheses hypotheses_;
  std::vector<FrameRecord> frames_;           ///< from the anchor's on, or the last one
  double travelled_ = 0;                      ///< metres of the path
  std::optional<Anchor> anchor_;              ///< none while the drive is not found
  std::optional<detail::UncertainPose> now_;  ///< of the newest frame
  bool was_found_ = false;
  bool registered_ = false;  ///< the newest frame
  LocalizerCounts counts_;
};

template <class Closer, class Places>
template <Executor E>
Localizer<Closer, Places>::Localizer(const SlamMap& map, const LocalizerOptions& options, Closer closer, Places places,
                                     const E& executor)
    : options_(options),
      closer_(std::move(closer)),
      places_(std::move(places)),
      keyframes_(map.keyframes),
      positions_(map.sessions.size()),
      map_keyframes_(to_index(map.keyframes.size())),
      select_(options.scans),
      hypotheses_(options.start) {
  if (!(options.min_period >= 0 && options.gate > 0 && options.max_distance > 0 && options.max_deviation > 0) ||
      !(options.lost_distance >= options.max_distance && options.lost_deviation >= options.max_deviation))
    throw std::invalid_argument(
        "LocalizerOptions: gate, max_distance and max_deviation must be positive, min_period not negative, "
        "lost_distance and lost_deviation not smaller than max_distance and max_deviation");
  bool has_scans = false;
  for (const Keyframe& one : keyframes_) {
    if (!is_finite(one.T_map_body.matrix()) || !is_finite(one.T_odom_body.matrix()))
      throw std::invalid_argument("Localizer: a pose of the map is not finite");
    has_scans |= one.cloud.size() > 0;
  }
  if (!has_scans) throw std::invalid_argument("Localizer: the map has no scans: load it with them");
  for (const Session& session : map.sessions) frames_of_sessions_.push_back(session.frame);
  for (const Session& session : map.sessions)
    if (session.frame == session.id)
      index_of(session.id).rebuild(keyframes_, [&](const Keyframe& one) { return frame_of(one.id) == session.id; });
  const auto share_frame = [&](KeyframeId earlier, KeyframeId later) { return frame_of(earlier) == frame_of(later); };
  places_.remember(keyframes_, map_keyframes_, share_frame, executor);
}

template <class Closer, class Places>
void Localizer<Closer, Places>::restart() {
  forget_path();
  frames_.clear();
  anchor_.reset();
  now_.reset();
  was_found_ = false;
  travelled_ = 0;
}

template <class Closer, class Places>
template <Executor E>
Localization Localizer<Closer, Places>::process(const Frame& frame, const E& executor) {
  require_sound(frame);
  if (!frames_.empty() && frame.time <= frames_.back().time)
    throw std::invalid_argument("Localizer: a frame's time is not later than the one before it");
  ++counts_.frames;
  registered_ = false;
  if (!frames_.empty()) travelled_ += (frames_.back().T_odom_body.inverse() * frame.T_odom_body).translation().norm();
  constexpr std::size_t most_frames = 256;  // 25 s: what is summed up for each frame stays short
  if (!anchor_)
    frames_.clear();
  else if (frames_.size() >= most_frames && now_)
    *anchor_ = {anchor_->frame, anchor_->reference, *now_, frames_.back().T_odom_body, anchor_->registered, {}},
    frames_.erase(frames_.begin(), frames_.end() - 1);
  frames_.push_back(record_of(frame));
  if (frame.health.status == FrameStatus::lost || frame.health.map_restarted) forget_path();
  if (anchor_) now_ = moved_by(anchor_->at, anchor_->T_odom_body.inverse() * frame.T_odom_body);
  if (std::optional<Keyframe> scan = is_due(frame.time) ? select_(frame) : std::nullopt) {
    append(std::move(*scan));
    if (anchor_) track(frame, executor);
    if (updated_status() != LocalizationStatus::tracking)
      search(frame, executor);
    else
      hypotheses_.clear();
  }
  Localization result{.time = frame.time, .status = updated_status(), .registered = registered_};
  counts_.tracked += result.status == LocalizationStatus::tracking ? 1 : 0;
  counts_.uncertain += result.status == LocalizationStatus::uncertain ? 1 : 0;
  counts_.lost += result.status == LocalizationStatus::lost ? 1 : 0;
  if (!anchor_) return result;
  result.frame = anchor_->frame;
  result.reference = anchor_->reference;
  result.T_map_body = now_->pose;
  result.covariance = now_->covariance;
  return result;
}

template <class Closer, class Places>
void Localizer<Closer, Places>::require_sound(const Frame& frame) {
  if (!is_finite(frame.T_odom_body.matrix()) || !is_finite(4 * frame.T_odom_body.translation().squaredNorm()))
    throw std::invalid_argument("Localizer: a frame's pose is not finite");
  if (!is_finite(frame.covariance)) throw std::invalid_argument("Localizer: a frame's covariance is not finite");
}

template <class Closer, class Places>
Matrix6d Localizer<Closer, Places>::odometry_noise(const SE3d& T_from_to) const {
  const bool says_nothing = frames_.back().covariance.matrix().isZero(0);
  const Matrix6d added = says_nothing ? zeros<Matrix6d>()
                                      : sum_of(options_.odometry_noise.share_of(stated_covariance(frames_)),
                                               options_.odometry_inflation(frames_));
  const OdometryNoise& noise = says_nothing ? options_.unknown_odometry : options_.odometry_noise;
  return detail::covariance_of(noise(T_from_to, added).sqrt_information());
}

template <class Closer, class Places>
void Localizer<Closer, Places>::append(Keyframe keyframe) {
  constexpr double longest = 60;     // metres of the path that are kept: places are recognized by less
  constexpr std::size_t most = 120;  // scans
  std::size_t gone = 0;
  while (gone < travelled_at_.size() &&
         (travelled_ - travelled_at_[gone] > longest || travelled_at_.size() - gone >= most))
    ++gone;
  travelled_at_.erase(travelled_at_.begin(), travelled_at_.begin() + static_cast<std::ptrdiff_t>(gone));
  const auto own = keyframes_.begin() + map_keyframes_;
  keyframes_.erase(own, own + static_cast<std::ptrdiff_t>(gone));
  keyframe.session = SessionId{to_index(frames_of_sessions_.size())};
  travelled_at_.push_back(travelled_);
  keyframes_.push_back(std::move(keyframe));
  for (Index i = map_keyframes_; i < to_index(keyframes_.size()); ++i)
    keyframes_[static_cast<std::size_t>(i)].id = KeyframeId{i};
}

template <class Closer, class Places>
void Localizer<Closer, Places>::forget_path() {
  keyframes_.resize(static_cast<std::size_t>(map_keyframes_));
  travelled_at_.clear();
  hypotheses_.clear();
  select_ = KeyframeSelector(options_.scans);
}

template <class Closer, class Places>
void Localizer<Closer, Places>::set_anchor(SessionId frame, KeyframeId reference, const detail::UncertainPose& at,
                                           const Frame& now) {
  now_ = at;
  anchor_ = Anchor{frame, reference, at, now.T_odom_body, travelled_, {}};
  frames_.erase(frames_.begin(), frames_.end() - 1);
  registered_ = true;
}

template <class Closer, class Places>
void Localizer<Closer, Places>::pass_by(const Frame& now, const std::optional<detail::UncertainPose>& other) {
  ++counts_.refusals;
  anchor_ = Anchor{anchor_->frame, anchor_->reference, *now_, now.T_odom_body, anchor_->registered, other};
  frames_.erase(frames_.begin(), frames_.end() - 1);
}

template <class Closer, class Places>
template <Executor E>
void Localizer<Closer, Places>::track(const Frame& now, const E& executor) {
  Keyframe& scan = keyframes_.back();
  scan.T_map_body = now_->pose;
  PositionIndex& positions = index_of(anchor_->frame);
  const auto covariance = [&](KeyframeId, KeyframeId) { return now_->covariance; };
  positions.set_covariance(covariance);
  const std::vector<LoopClosure> tried = closer_.search(keyframes_, positions, scan.id, executor);
  ++counts_.registrations;
  if (tried.empty() || tried.back().verdict != ClosureVerdict::accepted) return pass_by(now, {});
  const detail::UncertainPose measured = detail::placed(keyframes_, tried.back());
  const detail::CorrectedPose pose = corrected(*now_, measured);
  if (pose.squared_distance <= options_.gate) return set_anchor(anchor_->frame, tried.back().from, pose.pose, now);
  // Elsewhere: one scan may err, two that agree do not.
  const SE3d T_anchor_now = anchor_->T_odom_body.inverse() * now.T_odom_body;
  if (anchor_->other) {
    const detail::CorrectedPose again = corrected(moved_by(*anchor_->other, T_anchor_now), measured);
    if (again.squared_distance <= options_.gate) return set_anchor(anchor_->frame, tried.back().from, again.pose, now);
  }
  pass_by(now, measured);
}

template <class Closer, class Places>
template <Executor E>
void Localizer<Closer, Places>::search(const Frame& now, const E& executor) {
  constexpr Index most_earlier = 10;  // scans that a place is tried with at once
  ++counts_.searches;
  const Index newest = to_index(travelled_at_.size()) - 1;
  for (detail::StartHypothesis& one : hypotheses_.all()) try_scan(one, newest, executor);
  const KeyframeId query = keyframes_.back().id;
  for (const KeyframeId from : places_.recognize(keyframes_, query)) {
    const std::optional<SE3d> guess = places_.guess(from, query);
    if (!guess || is_known(frame_of(from), keyframe(from).T_map_body * *guess)) continue;
    const std::optional<detail::UncertainPose> at =
        start_pose(closer_.align(keyframes_, from, query, *guess, executor), executor);
    if (!at) continue;
    detail::StartHypothesis* found = hypotheses_.recognized(frame_of(from), from, *at, now.T_odom_body, travelled_);
    // Odometry may have slipped since earlier ones: after two refusals the others say nothing.
    for (Index scan = newest - 1; found != nullptr && scan >= std::max(newest - most_earlier, Index{0}); --scan)
      if (found->refusing < 2) try_scan(*found, scan, executor);
  }
  hypotheses_.prune();
  const detail::StartHypothesis* start = hypotheses_.accepted();
  if (start == nullptr) return;
  const SE3d T_scan_now = start->T_odom_body.inverse() * now.T_odom_body;
  const detail::UncertainPose at =
      moved(start->latest, T_scan_now, detail::covariance_of(options_.odometry_noise(T_scan_now).sqrt_information()));
  const bool confirms = anchor_ && anchor_->frame == start->frame &&
                        corrected(*now_, at).squared_distance <= options_.gate;  // of a pose that was uncertain
  counts_.starts += confirms ? 0 : 1;
  was_found_ = true;
  set_anchor(start->frame, start->reference, at, now);
  hypotheses_.clear();
}

template <class Closer, class Places>
template <Executor E>
void Localizer<Closer, Places>::try_scan(detail::StartHypothesis& hypothesis, Index scan, const E& executor) {
  Keyframe& one = keyframes_[static_cast<std::size_t>(map_keyframes_ + scan)];
  one.T_map_body = hypothesis.predicted(one.T_odom_body);
  std::optional<detail::UncertainPose> at;
  KeyframeId reference;
  for (const KeyframeId from : near_.find(keyframes_, index_of(hypothesis.frame), one.id)) {
    const SE3d guess = keyframe(from).T_map_body.inverse() * one.T_map_body;
    const LoopClosure closure = closer_.align(keyframes_, from, one.id, guess, executor);
    if (!detail::is_registered(closure)) continue;
    reference = from;
    at = start_pose(closure, executor);
    if (!at && closure.verdict == ClosureVerdict::accepted) return;  // neither for it nor against it
  }
  hypotheses_.tried(hypothesis, reference, at, one.T_odom_body, travelled_at_[static_cast<std::size_t>(scan)]);
}

template <class Closer, class Places>
bool Localizer<Closer, Places>::is_known(SessionId frame, const SE3d& T_map_body) {
  constexpr double translation = 3.0, rotation = 0.2;  // that a guess may be off
  for (detail::StartHypothesis& one : hypotheses_.all()) {
    const SE3d off = one.latest.pose.inverse() * T_map_body;
    if (one.frame != frame || one.travelled < travelled_ || off.translation().norm() > translation ||
        off.rotation().log().norm() > rotation)
      continue;
    ++one.recognitions;
    return true;
  }
  return false;
}

template <class Closer, class Places>
LocalizationStatus Localizer<Closer, Places>::updated_status() {
  if (!anchor_) return was_found_ ? LocalizationStatus::lost : LocalizationStatus::searching;
  const double unconfirmed = travelled_ - anchor_->registered;
  const double deviation = AlignmentStarts::deviation(now_->covariance);
  if (unconfirmed > options_.lost_distance || deviation > options_.lost_deviation) {
    anchor_.reset();
    now_.reset();
    ++counts_.losses;
    return LocalizationStatus::lost;
  }
  return unconfirmed > options_.max_distance || deviation > options_.max_deviation || anchor_->other
             ? LocalizationStatus::uncertain
             : LocalizationStatus::tracking;
}

}  // namespace chainslam
