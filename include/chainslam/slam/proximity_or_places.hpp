#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/place_candidates.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// How far the graph may be off where a place is recognized: halls and streets that repeat themselves look alike at any
/// distance, and agree with each other.
struct PlausibleDrift {
  double distance = 30.0;   ///< metres,
  double per_metre = 0.01;  ///< and metres for each metre that the session has travelled
};

/// Keyframes near the query; and where those do not close, keyframes that the graph puts elsewhere though their
/// surroundings look like the query's: drift may have led beyond any radius.
///
/// Where a keyframe near does close, or an earlier session has come the same way, the place is known already, and is
/// not remembered again: what is kept grows with the area that the sessions cover, not with their length.
class ProximityOrPlaces {
 public:
  /// Starts without places.
  explicit ProximityOrPlaces(const ProximityCandidates& near = {}, PlaceCandidates places = PlaceCandidates{},
                             const PlausibleDrift& drift = {})
      : near_(near), places_(std::move(places)), drift_(drift) {}

  /// As `ProximityCandidates`.
  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return near_.eligible(candidate, query);
  }
  /// As `ProximityCandidates`; remembers places of earlier sessions.
  [[nodiscard]] std::vector<KeyframeId> find(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                             KeyframeId query) {
    if (sought_.valid()) places_.pass_over(keyframes, first_of_session(keyframes, sought_), sought_.value + 1);
    sought_ = query;
    remember(keyframes, index, query, first_of_session(keyframes, query));
    return near_.find(keyframes, index, query);
  }

  /// Keyframes of the query's frame that look like the query, are not near, and are not farther from it than the graph
  /// may be off; asked where those that `find` gave last did not close, once for each place of the path. Remembers
  /// places up to the query.
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> recognize(std::span<const Keyframe> keyframes,
                                                                const PositionIndex& index, KeyframeId query) {
    const auto at = [&](KeyframeId id) -> const Keyframe& { return keyframes[static_cast<std::size_t>(id.value)]; };
    const Keyframe& here = at(query);
    sought_ = {};
    remember(keyframes, index, query, query.value + 1);
    const auto count = to_index(places_.places().size());
    if (std::exchange(asked_, count) == count) return {};
    const PlaceCandidates::Place& newest = places_.places().back();
    const Keyframe& left = at(KeyframeId{newest.end - 1});
    if (left.id > query || left.session != here.session ||
        (left.T_odom_body.translation() - here.T_odom_body.translation()).norm() > places_.options().spacing)
      return {};
    const KeyframeId own = near_.first_own(keyframes, query);
    std::vector<KeyframeId> found = places_.find_newest(keyframes, query, [&](const PlaceCandidates::Place& place) {
      const Keyframe &there = at(place.center), &last = at(KeyframeId{place.end - 1});  // any may be proposed
      return index.contains(there.id) && near_.eligible(last, here) && !(last.id >= own && last.id <= query) &&
             (there.T_map_body.translation() - here.T_map_body.translation()).norm() > near_.radius;
    });
    if (found.empty()) return found;
    const double most = drift_.distance + drift_.per_metre * travelled_to(keyframes, query);
    std::erase_if(found, [&](KeyframeId from) {
      const Eigen::Vector3d there = at(from).T_map_body * guess(from, query).value().translation();
      return (there - here.T_map_body.translation()).norm() > most;
    });
    return found;
  }
  /// T_from_to of what the last call of `recognize` gave: see `PlaceCandidates::guess`.
  [[nodiscard]] std::optional<SE3d> guess(KeyframeId from, KeyframeId to) const { return places_.guess(from, to); }

  [[nodiscard]] const PlaceCandidates& places() const { return places_; }  ///< what is remembered

 private:
  /// Of earlier sessions in the query's frame, a place once.
  void remember(std::span<const Keyframe> keyframes, const PositionIndex& index, KeyframeId query, Index end) {
    const KeyframeId own{first_of_session(keyframes, query)};
    places_.remember(keyframes, end, [&](KeyframeId earlier, KeyframeId later) {
      return later < own && index.contains(earlier) && index.contains(later);
    });
  }
  [[nodiscard]] static Index first_of_session(std::span<const Keyframe> keyframes, KeyframeId query) {
    const SessionId session = keyframes[static_cast<std::size_t>(query.value)].session;
    const auto first = std::partition_point(keyframes.begin(), keyframes.end(),
                                            [&](const Keyframe& one) { return one.session < session; });
    return static_cast<Index>(first - keyframes.begin());
  }
  /// Metres along the path from the session's start.
  [[nodiscard]] static double travelled_to(std::span<const Keyframe> keyframes, KeyframeId query) {
    double travelled = 0;
    for (auto i = static_cast<std::size_t>(query.value); i > 0 && keyframes[i - 1].session == keyframes[i].session; --i)
      travelled += (keyframes[i].T_odom_body.translation() - keyframes[i - 1].T_odom_body.translation()).norm();
    return travelled;
  }

  ProximityCandidates near_;
  PlaceCandidates places_;
  PlausibleDrift drift_;
  Index asked_ = 0;      ///< places when it was last asked
  KeyframeId sought_{};  ///< the last query, unless places were asked for it
};
static_assert(ClosureCandidates<ProximityOrPlaces>);

}  // namespace chainslam
