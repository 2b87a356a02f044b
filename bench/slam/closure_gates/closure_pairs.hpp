#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "slam/closure_gates/places.hpp"

namespace chainslam::bench {

/// Why a graph thinks that a scan belongs to a submap.
enum class PairKind {
  revisit,    ///< it does, and the graph is off by what odometry drifts
  shifted,    ///< it nearly does: the graph is off along the way
  elsewhere,  ///< the scan is of another place
};

[[nodiscard]] inline const char* name_of(PairKind kind) {
  return kind == PairKind::revisit ? "revisit" : kind == PairKind::shifted ? "shifted" : "elsewhere";
}

/// A scan and a submap that a graph proposes to align.
struct ClosurePair {
  const KnownDrive* map = nullptr;
  const KnownDrive* query = nullptr;
  std::size_t from = 0;  ///< keyframe of `map`, the submap's centre
  std::size_t to = 0;    ///< keyframe of `query`
  PairKind kind = PairKind::revisit;
  SE3d guess{};                 ///< T_from_to as the graph has it
  std::optional<SE3d> truth{};  ///< T_from_to; nothing between two places
};

/// How far graphs are off, in metres along the ground unless stated.
struct PairOptions {
  double drift = 3.0;  ///< at most, of `revisit` and `elsewhere`
  double least_shift = 4.0, largest_shift = 12.0;
  double tilt = 0.01;   ///< radians, standard deviation in roll and pitch
  double turn = 0.03;   ///< radians, standard deviation in heading
  double height = 0.1;  ///< standard deviation
  double apart = 60.0;  ///< least distance between two places of one drive; half the drive's extent if that is less
};

/// Makes pairs as graphs that are off would propose them; the same seed gives the same pairs.
class PairMaker {
 public:
  PairMaker(const PairOptions& options, std::uint64_t seed) : options_(options), rng_(seed) {}

  /// A scan of `query` sought where it is or, `shifted`, next to it; nothing if it is not near the map.
  [[nodiscard]] std::optional<ClosurePair> same_place(const KnownDrive& map, const KnownDrive& query, PairKind kind) {
    const std::size_t to = any_of(query);
    const std::optional<SE3d> there = in_frame_of(map, query.truth[to]);
    if (!there) return std::nullopt;
    Eigen::Vector3d off = drift();
    if (kind == PairKind::shifted) {
      const double side = rng_.uniform() < 0.5 ? -1.0 : 1.0;
      const double length = side * rng_.uniform(options_.least_shift, options_.largest_shift);
      off = 0.2 * off + length * (there->rotation() * way_of(query, to));
    }
    return propose(map, query, to, kind, moved(*there, off));
  }

  /// A scan of `query` sought at another place of `map`, on the road and along it either way; nothing if the place is
  /// the same.
  [[nodiscard]] std::optional<ClosurePair> elsewhere(const KnownDrive& map, const KnownDrive& query) {
    const std::size_t to = any_of(query), at = any_of(map);
    if (map.place == query.place && (map.truth[at].translation() - query.truth[to].translation()).norm() <
                                        std::min(options_.apart, extent(map) / 2))
      return std::nullopt;
    const Eigen::Vector3d there = way_of(map, at), here = way_of(query, to);
    const double back = rng_.uniform() < 0.3 ? std::numbers::pi : 0.0;
    const double heading = std::atan2(there.y(), there.x()) - std::atan2(here.y(), here.x()) + back;
    const SE3d along = map.keyframes[at].T_map_body * SE3d(SO3d::exp({0, 0, heading}), {0, 0, 0});
    return propose(map, query, to, PairKind::elsewhere, moved(along, drift()));
  }

 private:
  /// Where a pose of the place is in the frame of a drive's odometry, by the keyframe nearest to it.
  [[nodiscard]] static std::optional<SE3d> in_frame_of(const KnownDrive& drive, const SE3d& T_place_body) {
    const auto distance = [&](const SE3d& pose) { return (pose.translation() - T_place_body.translation()).norm(); };
    const auto nearest = std::ranges::min_element(drive.truth, {}, distance);
    if (nearest == drive.truth.end() || distance(*nearest) > ProximityCandidates{}.radius) return std::nullopt;
    const auto at = static_cast<std::size_t>(nearest - drive.truth.begin());
    return drive.keyframes[at].T_map_body * nearest->inverse() * T_place_body;
  }

  /// Which way a drive goes at a keyframe, level unit vector in the keyframe's body frame.
  [[nodiscard]] static Eigen::Vector3d way_of(const KnownDrive& drive, std::size_t at) {
    const std::size_t last = drive.keyframes.size() - 1, begin = at > 0 ? at - 1 : 0, end = std::min(at + 1, last);
    const SE3d& here = drive.keyframes[at].T_map_body;
    Eigen::Vector3d way = here.rotation().inverse() * (drive.keyframes[end].T_map_body.translation() -
                                                       drive.keyframes[begin].T_map_body.translation());
    way.z() = 0;
    return way.norm() > 0 ? Eigen::Vector3d(way.normalized()) : Eigen::Vector3d::UnitX();
  }

  [[nodiscard]] static double extent(const KnownDrive& drive) {
    double farthest = 0;
    for (const SE3d& pose : drive.truth)
      farthest = std::max(farthest, (pose.translation() - drive.truth.front().translation()).norm());
    return farthest;
  }

  [[nodiscard]] Eigen::Vector3d drift() {
    const double direction = rng_.uniform(0, 2 * std::numbers::pi), length = rng_.uniform(0, options_.drift);
    return {length * std::cos(direction), length * std::sin(direction), rng_.normal(0, options_.height)};
  }

  [[nodiscard]] SE3d moved(const SE3d& pose, const Eigen::Vector3d& by) {
    const SO3d turn =
        SO3d::exp({rng_.normal(0, options_.tilt), rng_.normal(0, options_.tilt), rng_.normal(0, options_.turn)});
    return SE3d(turn * pose.rotation(), pose.translation() + by);
  }

  [[nodiscard]] std::size_t any_of(const KnownDrive& drive) {
    return static_cast<std::size_t>(rng_.uniform_index(to_index(drive.keyframes.size())));
  }

  /// One of the submaps that the mapper would try for a scan that the graph has at a pose.
  [[nodiscard]] std::optional<ClosurePair> propose(const KnownDrive& map, const KnownDrive& query_drive, std::size_t to,
                                                   PairKind kind, const SE3d& T_map_body) {
    std::vector<Keyframe> keyframes = map.keyframes;
    PositionIndex index;
    index.rebuild(keyframes);
    Keyframe query = query_drive.keyframes[to];
    query.id = KeyframeId{to_index(keyframes.size())};
    query.session = SessionId{1};
    query.T_map_body = T_map_body;
    keyframes.push_back(query);
    const std::vector<KeyframeId> found = ProximityCandidates{}.find(keyframes, index, query.id);
    if (found.empty()) return std::nullopt;
    const auto chosen = static_cast<std::size_t>(rng_.uniform_index(to_index(found.size())));
    ClosurePair pair{.map = &map, .query = &query_drive, .to = to, .kind = kind};
    pair.from = static_cast<std::size_t>(found[chosen].value);
    pair.guess = map.keyframes[pair.from].T_map_body.inverse() * T_map_body;
    if (map.place == query_drive.place) pair.truth = map.truth[pair.from].inverse() * query_drive.truth[to];
    return pair;
  }

  PairOptions options_;
  Rng rng_;
};

}  // namespace chainslam::bench
