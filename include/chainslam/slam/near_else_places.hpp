#pragma once

#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/map/keyframe.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/place_candidates.hpp"
#include "chainslam/slam/position_index.hpp"

namespace chainslam {

/// Keyframes near the query; and where those do not close, keyframes that the graph puts elsewhere though their
/// surroundings look like the query's: drift may have led beyond any radius.
class NearElsePlaces {
 public:
  /// Starts without places.
  explicit NearElsePlaces(const ProximityCandidates& near = {}, PlaceCandidates places = PlaceCandidates{})
      : near_(near), places_(std::move(places)) {}

  /// As `ProximityCandidates`.
  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return near_.eligible(candidate, query);
  }
  /// As `ProximityCandidates`; remembers places up to the query.
  [[nodiscard]] std::vector<KeyframeId> find(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                             KeyframeId query) {
    places_.remember(keyframes, query.value + 1);
    return near_.find(keyframes, index, query);
  }

  /// Keyframes of the query's frame that look like the query and are not near; asked once for each place of the path.
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> recognize(std::span<const Keyframe> keyframes,
                                                                const PositionIndex& index, KeyframeId query) {
    const auto at = [&](KeyframeId id) -> const Keyframe& { return keyframes[static_cast<std::size_t>(id.value)]; };
    const Keyframe& here = at(query);
    const auto count = to_index(places_.places().size());
    if (std::exchange(asked_, count) == count) return {};
    const PlaceCandidates::Place& newest = places_.places().back();
    const Keyframe& left = at(KeyframeId{newest.end - 1});
    if (left.id > query || left.session != here.session ||
        (left.T_odom_body.translation() - here.T_odom_body.translation()).norm() > places_.options().spacing)
      return {};
    return places_.find_newest(keyframes, query, [&](const PlaceCandidates::Place& place) {
      const Keyframe &there = at(place.center), &last = at(KeyframeId{place.end - 1});  // any of them may be proposed
      return index.contains(there.id) && near_.eligible(last, here) &&
             (there.T_map_body.translation() - here.T_map_body.translation()).norm() > near_.radius;
    });
  }
  /// T_from_to of what the last call of `recognize` gave: see `PlaceCandidates::guess`.
  [[nodiscard]] std::optional<SE3d> guess(KeyframeId from, KeyframeId to) const { return places_.guess(from, to); }

 private:
  ProximityCandidates near_;
  PlaceCandidates places_;
  Index asked_ = 0;  ///< places when it was last asked
};
static_assert(ClosureCandidates<NearElsePlaces>);

}  // namespace chainslam
