#pragma once

#include <concepts>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/map/keyframe.hpp"
#include "chainslam/map/loop_closure.hpp"
#include "chainslam/slam/chained_closer.hpp"
#include "chainslam/slam/place_candidates.hpp"
#include "chainslam/slam/position_index.hpp"

namespace chainslam {

/// Registers a scan to the map around where it has to be: `search`, as the back end has it look for closures, and
/// `align`, to one keyframe's submap.
template <class R>
concept MapRegistration = ClosureAligner<R> &&
    requires(R& closer, std::span<const Keyframe> keyframes, const PositionIndex& index, KeyframeId query) {
  { closer.search(keyframes, index, query, Serial{}) } -> std::same_as<std::vector<LoopClosure>>;
};

/// Recognizes places of a map from scans of a drive that is no part of it.
///
/// `remember(keyframes, end)` takes in the map; `recognize(keyframes, query)` gives keyframes of the map whose
/// surroundings look like those of the path that ends with `query`, the most similar first; `guess(from, query)` gives
/// T_from_query of one of them.
template <class P>
concept PlaceRecognition = requires(P& places, std::span<const Keyframe> keyframes, KeyframeId id, Index end) {
  places.remember(keyframes, end);
  { places.recognize(keyframes, id) } -> std::same_as<std::vector<KeyframeId>>;
  { places.guess(id, id) } -> std::same_as<std::optional<SE3d>>;
};
static_assert(PlaceRecognition<PlaceCandidates>);

}  // namespace chainslam
