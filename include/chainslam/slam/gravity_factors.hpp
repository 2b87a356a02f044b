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
/// window of time, at the keyframe that ends it.
///
/// Only in frames whose first session measures gravity: these lean no more than it does. Others, such as those of maps
/// without such measurements, stay as they are.
/// @tparam Gnc  takes the priors as candidates: `IncrementalGnc`. Its keys are the map's keyframes.
template <class Gnc>
class GravityFactors {
 public:
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
      const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
      Known& known = known_[i];
      if (!known.measured) known.measured = measure(map, keyframe);
      if (!known.measured || known.prior >= 0) continue;
      const SessionId frame = map.sessions[static_cast<std::size_t>(keyframe.session.value)].frame;
      if (keyframe.session == frame && std::exchange(upright_[frame.value], 1) == 0) held.push_back(frame);
      if (upright_[frame.value] == 0) continue;
      known.prior = gnc.add(gravity_prior(i, *known.measured, keyframe.T_map_body), {.threshold = options_.threshold});
    }
    return held;
  }

 private:
  struct Known {
    std::optional<GravityMeasurement> measured{};
    Index prior = -1;  ///< its number among the candidates, -1 if none
  };

  /// The direction of the window that ends at the keyframe, if one does.
  [[nodiscard]] std::optional<GravityMeasurement> measure(const SlamMap& map, const Keyframe& keyframe) {
    std::optional<Timestamp>& begin = begins_[keyframe.session.value];
    if (!begin) begin = keyframe.time;
    if (to_seconds(keyframe.time - *begin) < options_.window) return std::nullopt;
    const Timestamp from = std::exchange(*begin, keyframe.time);
    return measure_gravity(frames(map, keyframe.session, from, keyframe.time), options_);
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
