#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/map/slam_map.hpp"
#include "chainslam/slam/gravity_measurement.hpp"

namespace chainslam {

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
    const auto measured = measure_gravity(frames(map, end.session, from, end.time), options_);
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

  /// The session's frames of [from, to].
  [[nodiscard]] static std::span<const FrameRecord> frames(const SlamMap& map, SessionId session, Timestamp from,
                                                           Timestamp to) {
    const auto first = std::partition_point(map.frames.begin(), map.frames.end(), [&](const FrameRecord& frame) {
      return frame.session < session || (frame.session == session && frame.time < from);
    });
    const auto end = std::partition_point(first, map.frames.end(), [&](const FrameRecord& frame) {
      return frame.session == session && frame.time <= to;
    });
    return {first, end};
  }

  GravityFactorOptions options_;
  std::vector<Index> waiting_;
  detail::Table<Known> known_;                      ///< of each keyframe
  detail::Table<std::optional<Timestamp>> begins_;  ///< of each session's window
  detail::Table<char> upright_;                     ///< of each session, whether its frame is held
};

}  // namespace chainslam
