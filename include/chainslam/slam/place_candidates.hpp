#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/height_image.hpp"
#include "chainslam/slam/detail/ground_height.hpp"
#include "chainslam/slam/detail/neighbor_grid.hpp"
#include "chainslam/slam/gnss_candidates.hpp"
#include "chainslam/slam/place_index.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// What makes a place, and how many are proposed.
struct PlaceCandidateOptions {
  double submap_length = 60.0;  ///< metres along the path: what is drawn as one place
  double min_share = 0.2;       ///< of that length, which the path has to have before places are sought
  double spacing = 15.0;        ///< metres along the path between two places that are remembered
  Index max_count = 2;          ///< proposals; 0: places are neither remembered nor sought
  Index max_drawn = 8;          ///< places that one call remembers at most: a loaded map's are remembered bit by bit
  Index min_separation = 10;    ///< keyframes between two proposals of one session
  HeightImageOptions image{};   ///< how a place is drawn
  ImageKeypointOptions keypoints{};  ///< which corners of the image count
  PlaceIndexOptions index{};         ///< how similar places are found
};

/// Keyframes whose surroundings look like the query's, wherever the map has them and without GNSS: each with a guess
/// of the pose between them.
///
/// The scans along a piece of path are drawn from above, in odometry's frame, whose z points against gravity. A piece
/// is remembered when the path is through with it, unless an earlier one along the same way is; those of all sessions
/// are kept in one index.
class PlaceCandidates {
 public:
  /// @throws std::invalid_argument if an option makes no sense.
  explicit PlaceCandidates(const PlaceCandidateOptions& options = {})
      : options_(options), index_(options.index), centers_(options.spacing) {
    if (!(options.submap_length > 0 && options.spacing > 0) || options.max_count < 0)
      throw std::invalid_argument(
          "PlaceCandidates: submap_length and spacing must be positive, max_count not negative");
  }

  /// Keyframes of other frames.
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> find(const SlamMap& map, KeyframeId query) {
    const SessionId here = frame(map, session(map.keyframes, query));
    const auto frame_of = [&](KeyframeId id) { return frame(map, session(map.keyframes, id)); };
    const SessionId own = session(map.keyframes, query);
    remember(map.keyframes, query.value + 1, [&](KeyframeId there, KeyframeId id) {
      return session(map.keyframes, id) != own && frame_of(there) == frame_of(id);
    });
    proposals_.clear();
    const auto is_elsewhere = [&](const Session& one) { return one.keyframes > 0 && one.frame != here; };
    if (std::none_of(map.sessions.begin(), map.sessions.end(), is_elsewhere)) return {};
    return recognize(map.keyframes, query, [&](const Place& place) { return frame_of(place.center) != here; });
  }

  /// Keyframes of places that are wanted.
  /// @param keyframes  all of the map, which only ever gets more of them.
  template <class Wanted>
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> find(std::span<const Keyframe> keyframes, KeyframeId query,
                                                           const Wanted& wanted);

  /// Remembers the places of keyframes before `end`, those that the path is through with; `max_drawn` at most.
  [[gnu::cold]] void remember(std::span<const Keyframe> keyframes, Index end) {
    remember(keyframes, end, [](KeyframeId, KeyframeId) { return false; });
  }
  /// The same, but a place only once, however many drives have come that way.
  /// @param comparable  `bool comparable(KeyframeId earlier, KeyframeId later)`: whether T_map_body says where the one
  /// is from the other: in one frame of the map, and of drives that are over
  /// @param executor  shares out the drawing; any gives the same.
  template <class Comparable, Executor E = Serial>
  [[gnu::cold]] void remember(std::span<const Keyframe> keyframes, Index end, const Comparable& comparable,
                              const E& executor = {});
  /// Leaves out the places of keyframes [begin, end), which are known to be remembered already; nothing as long as some
  /// before `begin` are not.
  [[gnu::cold]] void pass_over(std::span<const Keyframe> keyframes, Index begin, Index end) {
    for (; next_ >= begin && next_ < end; ++next_) since_ = travelled(keyframes);
  }

  /// As `find`, but remembers nothing: for a query that is no part of the map.
  template <class Wanted>
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> recognize(std::span<const Keyframe> keyframes, KeyframeId query,
                                                                const Wanted& wanted);
  /// The same among all places.
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> recognize(std::span<const Keyframe> keyframes, KeyframeId query) {
    return recognize(keyframes, query, [](const Place&) { return true; });
  }

  /// The same for the newest place that is remembered, whose image is there already: it ends shortly before the query.
  template <class Wanted>
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> find_newest(std::span<const Keyframe> keyframes, KeyframeId query,
                                                                  const Wanted& wanted) {
    proposals_.clear();
    if (places_.empty() || options_.max_count == 0) return {};
    return propose(keyframes, query, places_.back(), newest_, wanted);
  }

  /// T_from_to of a proposal of the last call of `find` or `recognize`, by what was seen from above; roll and pitch by
  /// odometry, and the height by the ground below both.
  [[nodiscard]] std::optional<SE3d> guess(KeyframeId from, KeyframeId to) const {
    for (const Proposal& proposal : proposals_)
      if (proposal.from == from && proposal.to == to) return proposal.T_from_to;
    return std::nullopt;
  }

  [[nodiscard]] const PlaceIndex& index() const { return index_; }                 ///< descriptors of all places so far
  [[nodiscard]] const PlaceCandidateOptions& options() const { return options_; }  ///< its settings

  /// A piece of path that is remembered, or asked about.
  struct Place {
    KeyframeId center;  ///< at whose position the image has its origin
    Index begin = 0;    ///< keyframes [begin, end)
    Index end = 0;      ///< one past the last keyframe
  };
  /// All places that are remembered.
  [[nodiscard]] std::span<const Place> places() const { return places_.all(); }

 private:
  struct Proposal {
    KeyframeId from, to;
    SE3d T_from_to;
  };

  [[nodiscard]] static const Keyframe& at(std::span<const Keyframe> keyframes, Index i) {
    return keyframes[static_cast<std::size_t>(i)];
  }
  [[nodiscard]] static SessionId session(std::span<const Keyframe> keyframes, KeyframeId id) {
    return at(keyframes, id.value).session;
  }
  [[nodiscard]] static SessionId frame(const SlamMap& map, SessionId session) {
    return map.sessions[static_cast<std::size_t>(session.value)].frame;
  }
  /// `since_` at the next keyframe; the first place of a session is half a submap's.
  [[nodiscard]] double travelled(std::span<const Keyframe> keyframes) const {
    const bool is_first =
        next_ == 0 || session(keyframes, KeyframeId{next_ - 1}) != session(keyframes, KeyframeId{next_});
    return is_first ? options_.spacing - 0.5 * options_.submap_length : since_ + step(keyframes, next_);
  }
  [[nodiscard]] static double step(std::span<const Keyframe> keyframes, Index to) {
    return (at(keyframes, to).T_odom_body.translation() - at(keyframes, to - 1).T_odom_body.translation()).norm();
  }
  /// From odometry's frame to that of an image: level, with its origin at a keyframe.
  [[nodiscard]] static SE3d T_image_odom(const Keyframe& center) {
    return SE3d(SO3d(), -center.T_odom_body.translation());
  }

  /// Whether an earlier drive that way is remembered. What the graph has moved far since is not found.
  template <class Comparable>
  [[nodiscard]] [[gnu::cold]] bool is_known(std::span<const Keyframe> keyframes, const Place& place,
                                            const Comparable& comparable) const;

  /// The path up to and with `last`, as long as a submap.
  [[nodiscard]] [[gnu::cold]] Index begin_of_submap(std::span<const Keyframe> keyframes, Index last) const;

  [[nodiscard]] [[gnu::cold]] std::vector<ImageKeypoint> draw(std::span<const Keyframe> keyframes,
                                                              const Place& place) const;

  /// Keyframes of places that look like `around`, on whose path the query lies.
  template <class Wanted>
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> propose(std::span<const Keyframe> keyframes, KeyframeId query,
                                                              const Place& around, std::span<const ImageKeypoint> seen,
                                                              const Wanted& wanted);
  /// The keyframe of a place that is nearest to the query, and the pose between them.
  /// @param T_place_around  between the images of the place and of that around the query
  [[nodiscard]] [[gnu::cold]] static Proposal nearest(std::span<const Keyframe> keyframes, const Place& place,
                                                      const Place& around, KeyframeId query,
                                                      const SE2d& T_place_around);
  [[nodiscard]] static std::optional<double> ground(std::span<const Keyframe> keyframes, const Place& place, Index at) {
    const auto begin = static_cast<std::size_t>(place.begin), end = static_cast<std::size_t>(place.end);
    return detail::ground_height(keyframes.subspan(begin, end - begin), at - place.begin);
  }

  PlaceCandidateOptions options_;
  PlaceIndex index_;
  detail::Table<Place> places_;
  detail::NeighborGrid centers_;  ///< of each place, where its center was when it was remembered
  Index next_ = 0;                ///< keyframe to come
  double since_ = 0;              ///< metres along the path since the last place was remembered, or the session's start
  std::vector<ImageKeypoint> newest_;  ///< of the last place that was remembered
  detail::Table<Proposal> proposals_;
};
static_assert(MergeCandidates<PlaceCandidates>);

template <class Wanted>
std::vector<KeyframeId> PlaceCandidates::find(std::span<const Keyframe> keyframes, KeyframeId query,
                                              const Wanted& wanted) {
  remember(keyframes, query.value + 1);
  return recognize(keyframes, query, wanted);
}

template <class Wanted>
std::vector<KeyframeId> PlaceCandidates::recognize(std::span<const Keyframe> keyframes, KeyframeId query,
                                                   const Wanted& wanted) {
  proposals_.clear();
  std::vector<KeyframeId> found;
  if (options_.max_count == 0) return found;
  const Place here{.center = query, .begin = begin_of_submap(keyframes, query.value), .end = query.value + 1};
  double length = 0;
  for (Index i = here.begin + 1; i < here.end; ++i) length += step(keyframes, i);
  if (length < options_.min_share * options_.submap_length) return found;  // too little was seen so far
  return propose(keyframes, query, here, draw(keyframes, here), wanted);
}

template <class Wanted>
std::vector<KeyframeId> PlaceCandidates::propose(std::span<const Keyframe> keyframes, KeyframeId query,
                                                 const Place& around, std::span<const ImageKeypoint> seen,
                                                 const Wanted& wanted) {
  std::vector<KeyframeId> found;
  for (const PlaceMatch& match : index_.find(seen, [&](Index place) { return wanted(places_[place]); })) {
    if (to_index(found.size()) >= options_.max_count) break;
    const Proposal proposal = nearest(keyframes, places_[match.place], around, query, match.T_place_query);
    const auto is_near = [&](KeyframeId other) {
      return std::abs(other.value - proposal.from.value) < options_.min_separation &&
             session(keyframes, other) == session(keyframes, proposal.from);
    };
    if (std::any_of(found.begin(), found.end(), is_near)) continue;
    found.push_back(proposal.from);
    proposals_.push_back(proposal);
  }
  return found;
}

inline Index PlaceCandidates::begin_of_submap(std::span<const Keyframe> keyframes, Index last) const {
  Index begin = last;
  double length = 0;
  while (begin > 0 && at(keyframes, begin - 1).session == at(keyframes, last).session &&
         (length += step(keyframes, begin)) <= options_.submap_length)
    --begin;
  return begin;
}

template <class Comparable>
bool PlaceCandidates::is_known(std::span<const Keyframe> keyframes, const Place& place,
                               const Comparable& comparable) const {
  constexpr double most_turned = 1.0;  // rad: a scanner that looks ahead sees other things on the way back
  const Keyframe& here = at(keyframes, place.center.value);
  bool known = false;
  centers_.for_each_near(here.T_map_body.translation(), options_.spacing, [&](Index k, const Eigen::Vector3d&) {
    const Keyframe& there = at(keyframes, places_[k].center.value);
    if (known || there.id.value >= place.begin || !comparable(there.id, here.id)) return;
    const SE3d T_there_here = there.T_map_body.inverse() * here.T_map_body;
    known =
        T_there_here.translation().norm() <= options_.spacing && T_there_here.rotation().log().norm() <= most_turned;
  });
  return known;
}

template <class Comparable, Executor E>
void PlaceCandidates::remember(std::span<const Keyframe> keyframes, Index end, const Comparable& comparable,
                               const E& executor) {
  if (options_.max_count == 0) return;
  const Offset before = places_.size();
  for (; next_ < end && (options_.max_drawn <= 0 || places_.size() - before < options_.max_drawn); ++next_) {
    since_ = travelled(keyframes);
    if (since_ < options_.spacing) continue;
    since_ = 0;
    const Index begin = begin_of_submap(keyframes, next_), after = next_ + 1;
    const Place place{.center = KeyframeId{(begin + after) / 2}, .begin = begin, .end = after};
    if (is_known(keyframes, place, comparable)) continue;
    places_.push_back(place);
    centers_.add(at(keyframes, place.center.value).T_map_body.translation());
  }
  std::vector<std::vector<ImageKeypoint>> seen(static_cast<std::size_t>(places_.size() - before));
  executor.for_chunks(to_index(seen.size()), 1, [&](Index k, Index /*end*/) {
    seen[static_cast<std::size_t>(k)] = draw(keyframes, places_[before + k]);
  });
  for (std::vector<ImageKeypoint>& one : seen) index_.add(newest_ = std::move(one));
}

inline std::vector<ImageKeypoint> PlaceCandidates::draw(std::span<const Keyframe> keyframes, const Place& place) const {
  PointCloud<float> seen;
  const SE3d level = T_image_odom(at(keyframes, place.center.value));
  for (Index i = place.begin; i < place.end; ++i) {
    const Keyframe& keyframe = at(keyframes, i);
    const auto cloud = keyframe.cloud.load();
    if (!cloud) continue;
    const PointCloud<float> moved = transformed(cloud->positions, level * keyframe.T_odom_body);
    seen.positions.insert(seen.positions.end(), moved.positions.begin(), moved.positions.end());
  }
  return image_keypoints(height_image(seen, options_.image), options_.keypoints);
}

inline PlaceCandidates::Proposal PlaceCandidates::nearest(std::span<const Keyframe> keyframes, const Place& place,
                                                          const Place& around, KeyframeId query,
                                                          const SE2d& T_place_around) {
  const Keyframe& here = at(keyframes, query.value);
  const SE3d level = T_image_odom(at(keyframes, place.center.value));
  const auto ahead = [&](Index i) { return level * at(keyframes, i).T_odom_body; };
  const Eigen::Vector3d in_image = T_image_odom(at(keyframes, around.center.value)) * here.T_odom_body.translation();
  const Eigen::Vector2d position = T_place_around * Eigen::Vector2d(in_image.head<2>());
  Index nearest = place.begin;
  double least = std::numeric_limits<double>::infinity();
  for (Index i = place.begin; i < place.end; ++i)
    if (const double away = (ahead(i).translation().head<2>() - position).norm(); away < least)
      least = away, nearest = i;
  const Keyframe& there = at(keyframes, nearest);
  const std::optional<double> ground_here = ground(keyframes, around, query.value);
  const std::optional<double> ground_there = ground(keyframes, place, nearest);
  const double rise = ground_here && ground_there ? *ground_there - *ground_here : 0.0;
  const SE3d T_place_body(SO3d::exp({0, 0, T_place_around.rotation().angle()}) * here.T_odom_body.rotation(),
                          {position.x(), position.y(), ahead(nearest).translation().z() + rise});
  return {there.id, here.id, ahead(nearest).inverse() * T_place_body};
}

namespace detail {

/// Whether the session of a keyframe has GNSS fixes.
class FixesOfSession {
 public:
  /// Asked for each keyframe: fixes of a drive begin near its start, or do not come.
  [[nodiscard]] [[gnu::cold]] bool any(std::span<const Keyframe> keyframes, KeyframeId query) {
    const auto at = [&](Index i) -> const Keyframe& { return keyframes[static_cast<std::size_t>(i)]; };
    const SessionId session = at(query.value).session;
    if (std::exchange(session_, session) != session) {
      first_ = query.value;
      while (first_ > 0 && at(first_ - 1).session == session) --first_;
      looked_at_ = first_;
      any_ = false;
    }
    const Index end = to_index(keyframes.size());
    for (; !any_ && looked_at_ < end && at(looked_at_).session == session; ++looked_at_)
      any_ = at(looked_at_).gnss.has_value();
    looked_at_ = std::max(first_, looked_at_ - recent);  // fixes come after their keyframe
    return any_;
  }

 private:
  static constexpr Index recent = 20;  ///< keyframes that may still get a fix
  SessionId session_{};
  Index first_ = 0, looked_at_ = 0;
  bool any_ = false;
};

}  // namespace detail

/// What fixes propose, and places for a session that has no fixes.
template <MergeCandidates Fixes = GnssCandidates, MergeCandidates Places = PlaceCandidates>
class GnssOrPlaces {
 public:
  /// Starts without places.
  explicit GnssOrPlaces(Fixes fixes = Fixes{}, Places places = Places{})
      : fixes_(std::move(fixes)), places_(std::move(places)) {}

  /// Keyframes of other frames: see `MergeCandidates`.
  [[nodiscard]] std::vector<KeyframeId> find(const SlamMap& map, KeyframeId query) {
    by_place_ = !of_session_.any(map.keyframes, query);
    return by_place_ ? places_.find(map, query) : fixes_.find(map, query);
  }
  /// As `GnssCandidates::misplaced`.
  [[nodiscard]] std::vector<KeyframeId> misplaced(const SlamMap& map, KeyframeId query) {
    return fixes_.misplaced(map, query);
  }
  /// As `PlaceCandidates::guess`; nothing if fixes made the proposal.
  [[nodiscard]] std::optional<SE3d> guess(KeyframeId from, KeyframeId to) const {
    return by_place_ ? places_.guess(from, to) : std::nullopt;
  }

 private:
  Fixes fixes_;
  Places places_;
  bool by_place_ = false;
  detail::FixesOfSession of_session_;
};
static_assert(MergeCandidates<GnssOrPlaces<>>);

}  // namespace chainslam
