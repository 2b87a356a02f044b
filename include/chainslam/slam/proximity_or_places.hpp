#pragma once

#include <Eigen/Core>
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
  /// As `ProximityCandidates`; remembers places up to the query.
  [[nodiscard]] std::vector<KeyframeId> find(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                             KeyframeId query) {
    places_.remember(keyframes, query.value + 1);
    return near_.find(keyframes, index, query);
  }

  /// Keyframes of the query's frame that look like the query, are not near, and are not farther from it than the graph
  /// may be off; asked once for each place of the path.
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

 private:
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
  Index asked_ = 0;  ///< places when it was last asked
};
static_assert(ClosureCandidates<ProximityOrPlaces>);

}  // namespace chainslam
