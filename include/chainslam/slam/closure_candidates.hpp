#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstdlib>
#include <numbers>
#include <span>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/slam/detail/neighbor_grid.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// Finds keyframes by their estimated positions in the graph.
///
/// A search costs what lies around, and a keyframe that the graph has moved is entered again by itself.
class PositionIndex {
 public:
  /// Updates all positions: after frames were joined, say.
  /// @param chosen  which keyframes to hold: those whose T_map_body are in one frame.
  template <std::predicate<const Keyframe&> Chosen>
  void rebuild(std::span<const Keyframe> keyframes, Chosen&& chosen) {
    ids_.clear();
    grid_.clear();
    for (const Keyframe& keyframe : keyframes)
      if (chosen(keyframe)) append(keyframe.id, keyframe.T_map_body.translation());
  }
  /// Indexes the positions of all keyframes, in O(n).
  void rebuild(std::span<const Keyframe> keyframes) {
    rebuild(keyframes, [](const Keyframe&) { return true; });
  }

  /// Adds the next keyframe; ids must ascend.
  void append(KeyframeId id, const Eigen::Vector3d& position) {
    ids_.push_back(id);
    grid_.add(position);
  }
  /// The graph has moved a keyframe. Does nothing if it does not hold it.
  void move(KeyframeId id, const Eigen::Vector3d& position) {
    const KeyframeId* const found = std::lower_bound(ids_.begin(), ids_.end(), id);
    if (found != ids_.end() && *found == id) grid_.move(static_cast<Index>(found - ids_.begin()), position);
  }

  /// Lets somebody say how well the graph knows where one keyframe is from another.
  /// @param covariance  `Matrix6d covariance(KeyframeId from, KeyframeId to)` of T_from_to, tangent [translation;
  /// rotation], metres and radians; must outlive this.
  template <class Covariance>
  void set_covariance(const Covariance& covariance) {
    covariance_ = &covariance;
    call_ = [](const void* callable, KeyframeId from, KeyframeId to) -> Matrix6d {
      return (*static_cast<const Covariance*>(callable))(from, to);
    };
  }
  /// Zero if nobody says.
  [[nodiscard]] Matrix6d covariance(KeyframeId from, KeyframeId to) const {
    return covariance_ != nullptr ? call_(covariance_, from, to) : zeros<Matrix6d>();
  }

  /// A keyframe and its distance from the query, metres.
  struct Found {
    KeyframeId id;        ///< the keyframe
    double distance = 0;  ///< metres
  };
  /// Puts the nearest first, equally near ones by id.
  [[gnu::cold]] static void sort(std::span<Found> found) {
    detail::Table<Ranked> order;
    for (const Found& one : found) order.push_back({one.distance, one.id.value});
    sort_ranked(order.all());
    for (std::size_t k = 0; k < found.size(); ++k) found[k] = {KeyframeId{order.all()[k].index}, order.all()[k].rank};
  }

  /// All keyframes within `radius` metres of `center`, nearest first; equal distances by id.
  [[nodiscard]] std::vector<Found> within(const Eigen::Vector3d& center, double radius) const {
    std::vector<Found> found;
    for_each_near(center, radius, [&](KeyframeId id, const Eigen::Vector3d& position) {
      const Eigen::Vector3d way = position - center;
      const double distance = way.norm();
      if (distance <= radius) found.push_back({id, distance});
    });
    sort(found);
    return found;
  }
  /// Calls visit(id, position) for all keyframes within the radius, and for some around, in any order.
  template <class Visit>
  void for_each_near(const Eigen::Vector3d& center, double radius, Visit&& visit) const {
    grid_.for_each_near(center, radius, [&](Index i, const Eigen::Vector3d& position) { visit(ids_[i], position); });
  }

  /// Whether it holds a keyframe.
  [[nodiscard]] bool contains(KeyframeId id) const { return std::binary_search(ids_.begin(), ids_.end(), id); }
  /// Number of positions.
  [[nodiscard]] std::size_t size() const { return static_cast<std::size_t>(grid_.size()); }

 private:
  static constexpr double cell = 16.0;  ///< metres: about the radius in which candidates are looked for

  detail::Table<KeyframeId> ids_;  ///< ascending
  detail::NeighborGrid grid_{cell};
  const void* covariance_ = nullptr;  ///< who says, and how to ask
  Matrix6d (*call_)(const void* callable, KeyframeId from, KeyframeId to) = nullptr;
};

/// A keyframe to whose submap a scan is to be aligned, and where to start.
struct AlignmentGuess {
  KeyframeId from;  ///< the submap's
  SE3d T_from_to;   ///< of the scan's keyframe, about
};

/// Where an alignment starts again after it was refused where the graph has the scan.
///
/// Along the direction in which the graph knows the relative position least, up to two standard deviations. After
/// several searches in a row in which nothing was accepted, although keyframes are near, odometry may have failed
/// unnoticed: then in all horizontal directions, each search at another distance.
struct AlignmentStarts {
  double spacing = 3.0;        ///< metres between two starts: an alignment reaches about so far
  double max_distance = 15.0;  ///< metres from where the graph has the scan; 0: there alone
  Index patience = 2;          ///< searches in a row without an accepted closure
  Index points = 512;          ///< of the scan, evenly, by which starts are compared, at least; 0: all

  /// Standard deviation in the direction that is known least, metres.
  /// @param covariance  of T_from_to, tangent [translation; rotation].
  [[nodiscard]] static double deviation(const Matrix6d& covariance) {
    return std::sqrt(std::max(translation_eigen(covariance).values[2], 0.0));
  }

  /// @param R_map_body  attitude of the scan that is aligned.
  /// @param refused     searches in a row without an accepted closure, with this one.
  /// @returns offsets from the pose by the graph, in the scan's own frame, metres; none if there is no reason.
  [[nodiscard]] [[gnu::cold]] std::vector<Eigen::Vector3d> operator()(const Matrix6d& covariance,
                                                                      const SO3d& R_map_body, Index refused) const {
    std::vector<Eigen::Vector3d> offsets;
    const JacobiEigen<double, 3> eigen = translation_eigen(covariance);
    const double reach = std::min(max_distance, 2 * std::sqrt(std::max(eigen.values[2], 0.0)));
    for (double distance = spacing; distance <= reach; distance += spacing)
      for (const double signed_distance : {distance, -distance})
        offsets.push_back(scaled(signed_distance, block_of<3, 1>(eigen.vectors, 0, 2)));
    const Index rings = static_cast<Index>(max_distance / spacing);
    if (refused <= patience || rings < 1) return offsets;
    constexpr int directions = 8;
    const double radius = spacing * (1 + (refused - patience - 1) % rings);
    const SO3d R_body_map = R_map_body.inverse();
    for (int k = 0; k < directions; ++k) {
      const double angle = 2 * std::numbers::pi * k / directions;
      offsets.push_back(R_body_map * Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle), 0.0));
    }
    return offsets;
  }

 private:
  [[nodiscard]] static JacobiEigen<double, 3> translation_eigen(const Matrix6d& covariance) {
    return jacobi_eigen(Eigen::Matrix3d(block_of<3, 3>(covariance, 0, 0)));
  }
};

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
  Index min_keyframes = 30;             ///< between both in one session, lest the submap hold the scan; 0: any number
  double min_path = 200;                ///< metres of path between them that suffice instead

  /// Whether `candidate` may be closed with `query` at all, wherever they are.
  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return candidate.id != query.id &&
           (candidate.session != query.session || query.time - candidate.time >= min_interval);
  }

  /// The first keyframe of those right before the query around which a submap may hold the query's own scan, aligned
  /// to which it would only repeat what the graph states already. The query itself if there is none.
  [[nodiscard]] [[gnu::cold]] KeyframeId first_own(std::span<const Keyframe> keyframes, KeyframeId query) const {
    const auto at = [&](Index i) -> const Keyframe& { return keyframes[static_cast<std::size_t>(i)]; };
    Index first = query.value;
    double length = 0;
    while (first > 0 && query.value - first < min_keyframes && at(first - 1).session == at(query.value).session) {
      length += (at(first).T_odom_body.translation() - at(first - 1).T_odom_body.translation()).norm();
      if (length > min_path) break;
      --first;
    }
    return KeyframeId{first};
  }

  /// Candidates near the query, the most promising first; see `ClosureCandidates`.
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> find(std::span<const Keyframe> keyframes,
                                                           const PositionIndex& index, KeyframeId query) const {
    const Keyframe& here = keyframes[static_cast<std::size_t>(query.value)];
    const KeyframeId own = first_own(keyframes, query);
    std::vector<PositionIndex::Found> near;
    for (const PositionIndex::Found& found : index.within(here.T_map_body.translation(), radius)) {
      const Keyframe& there = keyframes[static_cast<std::size_t>(found.id.value)];
      if (!eligible(there, here) || (found.id >= own && found.id <= query)) continue;
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
