#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/detail/neighbor_grid.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// Gives keyframes the GNSS position at their own time, between the fixes around it.
class GnssInterpolator {
 public:
  /// @param max_gap  between two fixes: over longer outages nothing is interpolated.
  explicit GnssInterpolator(Duration max_gap = seconds(2.0)) : max_gap_(max_gap) {}

  /// A keyframe that waits for the next fix; times ascend.
  void add(KeyframeId id, Timestamp time) { waiting_.push_back({id, time}); }

  /// Takes the next fix and calls `assign(id, fix)` for each waiting keyframe that lies between it and the one before.
  /// Fixes without a position or not later than the last are left out.
  template <class Assign>
  void add(const GnssFix& fix, Assign&& assign) {
    if (fix.quality == GnssQuality::none || !is_finite(fix.position_ecef) || !is_finite(fix.covariance_ecef)) return;
    if (last_ && fix.time <= last_->time) return;
    Offset passed = 0;
    for (; passed < waiting_.size() && waiting_[passed].time <= fix.time; ++passed) {
      const Waiting& keyframe = waiting_[passed];
      if (last_ && keyframe.time >= last_->time && fix.time - last_->time <= max_gap_)
        assign(keyframe.id, between(*last_, fix, keyframe.time));
    }
    if (passed > 0) waiting_ = detail::Table<Waiting>(waiting_.range(passed, waiting_.size()));
    last_ = fix;
  }

 private:
  struct Waiting {
    KeyframeId id;
    Timestamp time;
  };

  /// The worse quality of both; the covariance is not reduced by averaging, since errors of fixes are correlated.
  [[nodiscard]] static GnssFix between(const GnssFix& a, const GnssFix& b, Timestamp time) {
    const double share = to_seconds(time - a.time) / to_seconds(b.time - a.time);
    GnssFix fix;
    fix.time = time;
    const auto blend = [share](double from, double to) { return from + share * (to - from); };
    for (int i = 0; i < 3; ++i) fix.position_ecef[i] = blend(a.position_ecef[i], b.position_ecef[i]);
    for (int i = 0; i < 9; ++i)
      fix.covariance_ecef.data()[i] = blend(a.covariance_ecef.data()[i], b.covariance_ecef.data()[i]);
    fix.quality = a.quality < b.quality ? a.quality : b.quality;
    return fix;
  }

  Duration max_gap_;
  std::optional<GnssFix> last_;
  detail::Table<Waiting> waiting_;
};

/// Proposes keyframes of other frames that may have seen the same place as a keyframe of a session not yet joined with
/// them: place recognition.
///
/// `find(map, query)` gives ids of keyframes of earlier sessions whose frame is not the query's, the most promising
/// first; the same input gives the same answer.
template <class C>
concept MergeCandidates = requires(C& candidates, const SlamMap& map, KeyframeId query) {
  { candidates.find(map, query) } -> std::same_as<std::vector<KeyframeId>>;
};

/// Where GNSS says that sessions meet.
struct GnssCandidateOptions {
  double radius = 10.0;       ///< metres between two fixes, along the ground (the paper)
  bool with_height = false;   ///< whether the radius is one in space (the released code)
  double max_height = 50.0;   ///< metres between two fixes in height, which GNSS knows worst
  double max_sigma = 20.0;    ///< metres: fixes that state more are not used
  Index min_separation = 10;  ///< keyframes between two proposals of one session
  Index max_count = 2;        ///< proposals
  /// Metres that the map has two keyframes of one frame apart beyond the radius, so that fixes that put them near each
  /// other speak against it.
  double misplaced = 30.0;
};

/// Keyframes that GNSS puts near the query: its own and the receiver's word for it, whatever the frames (section 6 of
/// the paper). All is done in Earth-centred coordinates, so sessions need no common origin.
class GnssCandidates {
 public:
  /// Starts without keyframes.
  explicit GnssCandidates(const GnssCandidateOptions& options = {}) : options_(options) {}

  /// Keyframes of other frames that may be near the query by their fixes, the most promising first.
  [[nodiscard]] std::vector<KeyframeId> find(const SlamMap& map, KeyframeId query) {
    const SessionId here = frame(map, keyframe(map, query));
    return propose(map, query, [&](const Keyframe& one) { return frame(map, one) != here; });
  }

  /// The same among keyframes of the query's own frame that the map has elsewhere.
  [[nodiscard]] std::vector<KeyframeId> misplaced(const SlamMap& map, KeyframeId query) {
    const Keyframe& here = keyframe(map, query);
    return propose(map, query, [&](const Keyframe& one) {
      const Eigen::Vector3d way = here.T_map_body.translation() - one.T_map_body.translation();
      return frame(map, one) == frame(map, here) && way.norm() > options_.radius + options_.misplaced;
    });
  }

 private:
  using Found = PositionIndex::Found;  ///< with its distance, as the options measure it

  [[nodiscard]] static const Keyframe& keyframe(const SlamMap& map, KeyframeId id) {
    return map.keyframes[static_cast<std::size_t>(id.value)];
  }
  [[nodiscard]] static SessionId frame(const SlamMap& map, const Keyframe& keyframe) {
    return map.sessions[static_cast<std::size_t>(keyframe.session.value)].frame;
  }

  [[nodiscard]] bool usable(const Keyframe& keyframe) const {
    if (!keyframe.gnss || keyframe.gnss->quality == GnssQuality::none) return false;
    const Eigen::Matrix3d& covariance = keyframe.gnss->covariance_ecef;
    const Eigen::Vector3d variances(covariance(0, 0), covariance(1, 1), covariance(2, 2));
    return is_finite(keyframe.gnss->position_ecef) && is_finite(variances) &&
           std::max({variances[0], variances[1], variances[2]}) <= options_.max_sigma * options_.max_sigma;
  }

  /// Earlier sessions get no new keyframes, so their fixes are listed once for each session that asks.
  void index_earlier_sessions(const SlamMap& map, SessionId session) {
    if (indexed_for_ == session) return;
    indexed_for_ = session;
    ids_.clear();
    fixes_.clear();
    for (const Keyframe& one : map.keyframes)
      if (one.session < session && usable(one)) {
        ids_.push_back(one.id);
        fixes_.add(one.gnss->position_ecef);
      }
  }

  template <class Wanted>
  [[nodiscard]] std::vector<KeyframeId> propose(const SlamMap& map, KeyframeId query, const Wanted& wanted) {
    const Keyframe& here = keyframe(map, query);
    std::vector<KeyframeId> proposals;
    if (!usable(here)) return proposals;
    index_earlier_sessions(map, here.session);
    for (const Found& found : near(map, here, wanted)) {
      if (to_index(proposals.size()) >= options_.max_count) break;
      bool known = false;
      for (const KeyframeId other : proposals)
        known = known || (std::abs(found.id.value - other.value) < options_.min_separation &&
                          keyframe(map, found.id).session == keyframe(map, other).session);
      if (!known) proposals.push_back(found.id);
    }
    return proposals;
  }

  /// Fixes within the radius of keyframes that are wanted, the nearest first.
  template <class Wanted>
  [[nodiscard]] std::vector<Found> near(const SlamMap& map, const Keyframe& here, const Wanted& wanted) const {
    const Eigen::Vector3d& center = here.gnss->position_ecef;
    const Eigen::Vector3d up = center.normalized();  // off the vertical by less than 0.2 degrees
    std::vector<Found> found;
    const double reach = std::hypot(options_.radius, options_.max_height);
    fixes_.for_each_near(center, reach, [&](Index i, const Eigen::Vector3d& position) {
      const Eigen::Vector3d way = position - center;
      const double height = way.dot(up);
      const Eigen::Vector3d climb = height * up;
      const Eigen::Vector3d ground = way - climb;
      const double distance = options_.with_height ? way.norm() : ground.norm();
      if (distance <= options_.radius && std::abs(height) <= options_.max_height && wanted(keyframe(map, ids_[i])))
        found.push_back({ids_[i], distance});
    });
    PositionIndex::sort(found);
    return found;
  }

  GnssCandidateOptions options_;
  SessionId indexed_for_;
  detail::Table<KeyframeId> ids_;     ///< of keyframes that have a fix, ascending,
  detail::NeighborGrid fixes_{64.0};  ///< and where the receiver put them, Earth-centred
};
static_assert(MergeCandidates<GnssCandidates>);

}  // namespace chainslam
