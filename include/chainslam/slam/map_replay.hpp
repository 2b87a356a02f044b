#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/map/slam_map.hpp"

namespace chainslam {

namespace detail {

/// Gives a session's keyframes their fixes as they came.
class ReplayedFixes {
 public:
  ReplayedFixes(const SlamMap& map, const Session& session)
      : keyframes_(map.keyframes), next_(session.first_keyframe), end_(session.end_keyframe()) {}

  /// Those that came after `newest` and before the keyframe behind it.
  template <class Give>
  void pass(KeyframeId newest, const Give& give) {
    std::vector<KeyframeFix> together;
    for (; next_ <= newest.value && next_ < end_; ++next_) {
      const Keyframe& keyframe = keyframes_[static_cast<std::size_t>(next_)];
      const GnssArrival& arrival = keyframe.gnss_arrival;
      if (!keyframe.gnss || !arrival.after.valid()) continue;
      if (newest < arrival.after) break;
      if (!arrival.with_previous && !together.empty()) {
        give(std::span(together));
        together.clear();
      }
      together.push_back({keyframe.id, *keyframe.gnss});
    }
    if (!together.empty()) give(std::span(together));
  }

 private:
  std::span<const Keyframe> keyframes_;
  Index next_, end_;
};

/// The frames of one session.
[[nodiscard]] inline std::span<const FrameRecord> frames_of_session(const SlamMap& map, SessionId session) {
  const auto [first, end] =
      std::equal_range(map.frames.begin(), map.frames.end(), FrameRecord{.session = session},
                       [](const FrameRecord& a, const FrameRecord& b) { return a.session < b.session; });
  return {first, end};
}

}  // namespace detail

/// Gives a back end one session of a map, as a new session: its frames, keyframes and fixes, in the order in which they
/// came. Maps of format 1.3 and before do not say when fixes came: there they come with their keyframes.
/// @param back_end        takes `begin_session`, `add` of frames, keyframes and fixes, as `BackEnd` does.
/// @param after_keyframe  called after each keyframe, with its number in `map`.
template <class Target, Executor E, class AfterKeyframe>
void replay(const SlamMap& map, const Session& session, Target& back_end, const E& executor,
            AfterKeyframe&& after_keyframe) {
  back_end.begin_session(session.name);
  std::span<const FrameRecord> frames = detail::frames_of_session(map, session.id);
  detail::ReplayedFixes fixes(map, session);
  for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i) {
    Keyframe keyframe = map.keyframes[static_cast<std::size_t>(i)];
    const auto behind = std::partition_point(frames.begin(), frames.end(),
                                             [&](const FrameRecord& frame) { return frame.time <= keyframe.time; });
    const auto count = static_cast<std::size_t>(behind - frames.begin());
    if (count > 0) back_end.add(frames.first(count));
    frames = frames.subspan(count);
    if (keyframe.gnss_arrival.after.valid()) keyframe.gnss.reset();
    keyframe.gnss_arrival = {};
    const Index offset = back_end.add(std::move(keyframe), executor).value - i;  // of the back end's numbers
    fixes.pass(KeyframeId{i}, [&](std::span<KeyframeFix> together) {
      for (KeyframeFix& one : together) one.keyframe.value += offset;
      back_end.add(std::span<const KeyframeFix>(together), executor);
    });
    after_keyframe(KeyframeId{i});
  }
  if (!frames.empty()) back_end.add(frames);
}

/// The same of all sessions of a map. A back end with the same settings then makes the same map, bit for bit, if it
/// made this one without loading others; `without` and `Unrepeated` leave something out.
template <class Target, Executor E, class AfterKeyframe>
void replay(const SlamMap& map, Target& back_end, const E& executor, AfterKeyframe&& after_keyframe) {
  for (const Session& session : map.sessions) replay(map, session, back_end, executor, after_keyframe);
}

/// The same, on one thread, without progress.
template <class Target>
void replay(const SlamMap& map, Target& back_end) {
  replay(map, back_end, Serial{}, [](KeyframeId) {});
}

}  // namespace chainslam
