#pragma once

#include <concepts>
#include <cstdlib>
#include <span>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/map/keyframe.hpp"
#include "chainslam/slam/position_index.hpp"

namespace chainslam {

/// Proposes keyframes that may have seen the same place as a new one.
///
/// `find(keyframes, index, query)` gives ids of keyframes other than `query`, the most promising first; the same input
/// gives the same answer. `index` holds the positions of the keyframes in the query's frame. `eligible(candidate,
/// query)` says whether two keyframes may be closed at all; what `find` gives is eligible.
template <class C>
concept ClosureCandidates = requires(C& candidates, std::span<const Keyframe> keyframes, const PositionIndex& index,
                                     const Keyframe& keyframe) {
  { candidates.find(keyframes, index, keyframe.id) } -> std::same_as<std::vector<KeyframeId>>;
  { candidates.eligible(keyframe, keyframe) } -> std::same_as<bool>;
};

/// Keyframes that the graph puts near the query, of other sessions or of long enough ago (section 5 of the paper).
///
/// Near ones that look the same way come first, since a scanner with a narrow view sees little in common with one that
/// looks elsewhere. Of keyframes whose submaps are largely the same, only the best is proposed.
struct ProximityCandidates {
  double radius = 15.0;                 ///< metres (r_lc of the paper)
  Duration min_interval = seconds(30);  ///< between query and candidate of the same session
  double heading_weight = 3.0;          ///< metres that a radian of difference in attitude counts for
  Index min_separation = 10;            ///< keyframes between two proposals of one session
  Index max_count = 3;                  ///< proposals

  /// Whether `candidate` may be closed with `query` at all, wherever they are.
  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return candidate.id != query.id &&
           (candidate.session != query.session || query.time - candidate.time >= min_interval);
  }

  /// Candidates near the query, the most promising first; see `ClosureCandidates`.
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> find(std::span<const Keyframe> keyframes,
                                                           const PositionIndex& index, KeyframeId query) const {
    const Keyframe& here = keyframes[static_cast<std::size_t>(query.value)];
    std::vector<PositionIndex::Found> near;
    for (const PositionIndex::Found& found : index.within(here.T_map_body.translation(), radius)) {
      const Keyframe& there = keyframes[static_cast<std::size_t>(found.id.value)];
      if (!eligible(there, here)) continue;
      const SE3d between = there.T_map_body.inverse() * here.T_map_body;
      near.push_back({found.id, found.distance + heading_weight * between.rotation().log().norm()});
    }
    PositionIndex::sort(near);
    std::vector<KeyframeId> proposals;
    for (const PositionIndex::Found& found : near) {
      if (to_index(proposals.size()) >= max_count) break;
      bool known = false;
      for (const KeyframeId other : proposals)
        known = known || (std::abs(found.id.value - other.value) < min_separation &&
                          keyframes[static_cast<std::size_t>(other.value)].session ==
                              keyframes[static_cast<std::size_t>(found.id.value)].session);
      if (!known) proposals.push_back(found.id);
    }
    return proposals;
  }
};
static_assert(ClosureCandidates<ProximityCandidates>);

}  // namespace chainslam
