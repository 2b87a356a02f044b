#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/registration/alignment_checks.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "chainslam/slam/detail/lru_cache.hpp"
#include "chainslam/slam/detail/packed_surface.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// Consecutive keyframes [begin, end) of one session.
struct SubmapRange {
  Index begin = 0;                                                           ///< first keyframe
  Index end = 0;                                                             ///< behind the last keyframe
  friend bool operator==(const SubmapRange&, const SubmapRange&) = default;  ///< whether all members are equal
};

/// Keyframes within `radius` indices of `center`, of the same session: at most 2 radius + 1.
///
/// @param keyframes  all keyframes of the map; ids are positions.
[[nodiscard]] inline SubmapRange submap_range(std::span<const Keyframe> keyframes, KeyframeId center, Index radius) {
  const auto at = [&](Index i) -> const Keyframe& { return keyframes[static_cast<std::size_t>(i)]; };
  assert(center.valid() && center.value < static_cast<Index>(keyframes.size()));
  SubmapRange range{center.value, center.value + 1};
  const SessionId session = at(center.value).session;
  while (range.begin > 0 && range.begin > center.value - radius && at(range.begin - 1).session == session)
    --range.begin;
  const Index last = static_cast<Index>(keyframes.size());
  while (range.end < last && range.end <= center.value + radius && at(range.end).session == session) ++range.end;
  return range;
}

/// The same, but for keyframes farther along the path from `center` than `max_length` metres; 0: however far.
[[nodiscard]] inline SubmapRange submap_range(std::span<const Keyframe> keyframes, KeyframeId center, Index radius,
                                              double max_length) {
  const SubmapRange all = submap_range(keyframes, center, radius);
  if (!(max_length > 0)) return all;
  const auto step = [&](Index from) {
    return (keyframes[static_cast<std::size_t>(from + 1)].T_odom_body.translation() -
            keyframes[static_cast<std::size_t>(from)].T_odom_body.translation())
        .norm();
  };
  SubmapRange range{center.value, center.value + 1};
  double before = 0, after = 0;
  while (range.begin > all.begin && (before += step(range.begin - 1)) <= max_length) --range.begin;
  while (range.end < all.end && (after += step(range.end - 1)) <= max_length) ++range.end;
  return range;
}

/// The scans of `range`, placed by their optimized poses and seen from `center`'s body, one point per voxel.
///
/// @param voxel_size  metres.
/// @returns points in the body frame of `center`, metres.
[[nodiscard]] inline PointCloud<float> assemble_submap(std::span<const Keyframe> keyframes, KeyframeId center,
                                                       SubmapRange range, double voxel_size) {
  PointCloud<float> points;
  const SE3d T_center_map = keyframes[static_cast<std::size_t>(center.value)].T_map_body.inverse();
  for (const Keyframe& keyframe :
       keyframes.subspan(static_cast<std::size_t>(range.begin), static_cast<std::size_t>(range.end - range.begin))) {
    const auto cloud = keyframe.cloud.load();
    if (!cloud) continue;
    const PointCloud<float> seen = transformed(cloud->positions, T_center_map * keyframe.T_map_body);
    const std::size_t before = points.positions.size();
    points.positions.resize(before + seen.positions.size());
    std::copy_n(seen.positions.data(), seen.positions.size(), points.positions.data() + before);
  }
  return voxel_downsample(points, voxel_size);
}

/// Adds `more`, seen from frame a, to `points`; normals on the side that is seen from a's origin.
[[gnu::noinline]] inline void append_seen_from(const SE3d& T_a_b, const PointCloud<float>& more,
                                               PointCloud<float>& points) {
  const Eigen::Matrix3d R = T_a_b.rotation().matrix();
  const Eigen::Vector3d& t = T_a_b.translation();
  const std::size_t before = points.size();
  points.positions.resize(before + more.size());
  points.normals.resize(before + more.size());
  for (std::size_t i = 0; i < more.size(); ++i) {
    double p[3], n[3], away = 0;
    for (int k = 0; k < 3; ++k) {
      p[k] = t[k];
      n[k] = 0;
      for (int l = 0; l < 3; ++l) {
        p[k] += R(k, l) * static_cast<double>(more.positions[i][l]);
        n[k] += R(k, l) * static_cast<double>(more.normals[i][l]);
      }
      away += n[k] * p[k];
    }
    for (int k = 0; k < 3; ++k) {
      points.positions[before + i][k] = static_cast<float>(p[k]);
      points.normals[before + i][k] = static_cast<float>(away > 0 ? -n[k] : n[k]);
    }
  }
}

/// The surroundings of a keyframe as a registration target: points with normals and their search.
using Submap = IndexedCloud<>;

/// What a submap is made of.
struct SubmapOptions {
  Index radius = 10;            ///< keyframes on each side of the centre, at least (n of the paper: 20)
  double max_length = 100;      ///< metres along the path on each side, in whole fragments; 0: any (the paper)
  Index fragment = 5;           ///< consecutive keyframes that share a submap and are moved as one; 1: each has its own
  double voxel_size = 0.4;      ///< metres
  Index normal_neighbors = 12;  ///< points that a normal is fitted to
  double normal_radius = 2.0;   ///< metres, their largest distance
  std::size_t max_bytes = std::size_t{64} << 20;  ///< of all that is kept; the least recently used go first
};

/// A submap and where it lies.
struct PlacedSubmap {
  std::shared_ptr<const Submap> submap;  ///< stays alive as long as somebody holds it
  SE3d T_keyframe_submap{};              ///< of the keyframe that it was asked for
};

/// Consecutive keyframes of one session, and their poses relative to one of them at the time.
struct RigidRange {
  KeyframeId center{};                    ///< the keyframe whose frame it is in
  SubmapRange range{};                    ///< the keyframes around it
  std::vector<SE3d> T_center_keyframe{};  ///< pose of each keyframe of the range

  /// The keyframes of `around` as they are placed now, relative to `middle`.
  [[gnu::cold]] RigidRange(std::span<const Keyframe> keyframes, KeyframeId middle, SubmapRange around)
      : center(middle), range(around), T_center_keyframe(relative_poses(keyframes, middle, around)) {}

  /// Whether the same keyframes still lie where they did, to within `shift` metres.
  [[nodiscard]] [[gnu::cold]] bool holds(std::span<const Keyframe> keyframes, KeyframeId middle, SubmapRange around,
                                         double shift) const {
    if (middle != center || !(around == range)) return false;
    constexpr double lever = 20;  // metres at which a turned scan has moved as far as a shifted one
    const std::vector<SE3d> now = relative_poses(keyframes, center, range);
    for (std::size_t i = 0; i < now.size(); ++i) {
      const Vector6d moved = T_center_keyframe[i].local(now[i]);
      if (block_of<3, 1>(moved, 0, 0).norm() + lever * block_of<3, 1>(moved, 3, 0).norm() > shift) return false;
    }
    return true;
  }

 private:
  [[nodiscard]] [[gnu::cold]] static std::vector<SE3d> relative_poses(std::span<const Keyframe> keyframes,
                                                                      KeyframeId center, SubmapRange range) {
    const SE3d T_center_map = keyframes[static_cast<std::size_t>(center.value)].T_map_body.inverse();
    std::vector<SE3d> poses;
    for (Index i = range.begin; i < range.end; ++i)
      poses.push_back(T_center_map * keyframes[static_cast<std::size_t>(i)].T_map_body);
    return poses;
  }
};

/// Makes submaps and keeps those used last.
///
/// A session is cut into fragments of some consecutive keyframes. Their scans are put together and given normals once;
/// a submap is made of the fragments around one, and serves all keyframes of that. Both stay good while the poses of
/// their keyframes relative to the middle one stay where they were, to within a fifth of a voxel; a correction of
/// the graph that moves them all alike costs nothing, one that bends a session moves fragments.
class SubmapCache {
 public:
  /// An empty cache.
  explicit SubmapCache(const SubmapOptions& options = {})
      : options_(options),
        submaps_(options.fragment > 1 ? options.max_bytes / shares : options.max_bytes),
        fragments_(options.max_bytes - options.max_bytes / shares) {}

  [[nodiscard]] const SubmapOptions& options() const { return options_; }  ///< its settings

  /// The submap around keyframe `id`, from the cache or made now.
  /// @param keyframes  all keyframes of the map; ids are positions.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] PlacedSubmap get(std::span<const Keyframe> keyframes, KeyframeId id,
                                               const E& executor = {}) {
    return std::move(get(keyframes, std::span(&id, 1), executor).front());
  }
  /// Those around several keyframes, in their order. What has to be made of them is made at the same time.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::vector<PlacedSubmap> get(std::span<const Keyframe> keyframes,
                                                            std::span<const KeyframeId> ids, const E& executor = {});

  /// `surface_noise` of a submap that `get` gave, measured once for as long as it is kept.
  [[nodiscard]] double surface_noise(const Submap& submap) {
    const std::optional<double> known = known_surface_noise(submap);
    if (known) return *known;
    const double noise = chainslam::surface_noise(submap);
    keep_surface_noise(submap, noise);
    return noise;
  }
  /// The same if it was measured, or kept by the caller.
  [[nodiscard]] std::optional<double> known_surface_noise(const Submap& submap) {
    const Kept* kept = find_kept(submap);
    return kept == nullptr ? std::nullopt : kept->surface_noise;
  }
  /// Keeps it for as long as the submap.
  void keep_surface_noise(const Submap& submap, double noise) {
    if (Kept* kept = find_kept(submap)) kept->surface_noise = noise;
  }

  [[nodiscard]] std::size_t bytes() const { return submaps_.bytes() + fragments_.bytes(); }  ///< kept, about
  [[nodiscard]] std::size_t size() const { return submaps_.size(); }                         ///< submaps kept
  [[nodiscard]] std::size_t built() const { return built_; }                                 ///< submaps made so far
  [[nodiscard]] std::size_t fragments_built() const { return fragments_built_; }             ///< fragments built so far

 private:
  struct Kept {
    RigidRange at;
    std::shared_ptr<const Submap> submap;
    std::optional<double> surface_noise{};
  };
  struct Fragment {
    RigidRange at;
    detail::PackedSurface points;  // body frame of `at.center`
  };
  using Fragments = std::map<Index, std::shared_ptr<const Fragment>>;  ///< by the first keyframe
  /// To be made.
  struct Missing {
    KeyframeId center;
    SubmapRange range;
    std::shared_ptr<const Submap> submap{};
  };

  [[nodiscard]] Kept* find_kept(const Submap& submap) {
    return submaps_.find_if([&](const Kept& kept) { return kept.submap.get() == &submap; });
  }

  /// Parts of the memory, of which submaps get one, where there are fragments: each takes as much as twenty of those.
  static constexpr std::size_t shares = 4;

  /// Metres. Each closure bends its session a little: were that too much, most submaps would be made again and again.
  [[nodiscard]] double allowed_shift() const { return options_.voxel_size / 5; }

  /// The fragment that a keyframe belongs to: those of the same session whose numbers have the same quotient.
  [[nodiscard]] [[gnu::cold]] SubmapRange fragment_of(std::span<const Keyframe> keyframes, Index keyframe) const {
    const Index size = std::max(options_.fragment, Index{1});
    const auto session = [&](Index i) { return keyframes[static_cast<std::size_t>(i)].session; };
    SubmapRange range{keyframe / size * size, std::min(keyframe / size * size + size, to_index(keyframes.size()))};
    while (session(range.begin) != session(keyframe)) ++range.begin;
    while (session(range.end - 1) != session(keyframe)) --range.end;
    return range;
  }
  [[nodiscard]] static KeyframeId middle_of(SubmapRange range) { return KeyframeId{(range.begin + range.end) / 2}; }

  /// Of scans put together by the poses as they are, with normals; in the body frame of `center`.
  template <Executor E>
  [[nodiscard]] [[gnu::cold]] PointCloud<float> oriented(std::span<const Keyframe> keyframes, KeyframeId center,
                                                         SubmapRange range, const E& executor) const {
    PointCloud<float> points = assemble_submap(keyframes, center, range, options_.voxel_size);
    estimate_normals(points, NormalOptions{.neighbors = options_.normal_neighbors, .radius = options_.normal_radius},
                     Eigen::Vector3d::Zero(), executor);
    return points;
  }

  /// What the submaps are made of.
  template <Executor E>
  [[nodiscard]] [[gnu::cold]] Fragments fragments(std::span<const Keyframe> keyframes, std::span<const Missing> submaps,
                                                  const E& executor);

  /// The fragments of `range`, in the body frame of `center`.
  [[nodiscard]] [[gnu::cold]] PointCloud<float> joined(std::span<const Keyframe> keyframes, KeyframeId center,
                                                       SubmapRange range, const Fragments& fragments) const;

  SubmapOptions options_;
  detail::LruCache<KeyframeId, Kept> submaps_;                               // by the middle keyframe
  detail::LruCache<KeyframeId, std::shared_ptr<const Fragment>> fragments_;  // by the first
  std::size_t built_ = 0;
  std::size_t fragments_built_ = 0;
};

template <Executor E>
std::vector<PlacedSubmap> SubmapCache::get(std::span<const Keyframe> keyframes, std::span<const KeyframeId> ids,
                                           const E& executor) {
  const auto pose = [&](KeyframeId i) -> const SE3d& {
    return keyframes[static_cast<std::size_t>(i.value)].T_map_body;
  };
  std::vector<PlacedSubmap> placed;
  std::vector<Missing> missing;
  std::vector<std::pair<std::size_t, std::size_t>> waiting;  // in `placed`, for which that is missing
  for (const KeyframeId id : ids) {
    const KeyframeId center = middle_of(fragment_of(keyframes, id.value));
    SubmapRange range = submap_range(keyframes, center, options_.radius, options_.max_length);
    range = {fragment_of(keyframes, range.begin).begin, fragment_of(keyframes, range.end - 1).end};
    placed.push_back({nullptr, pose(id).inverse() * pose(center)});
    const Kept* known = submaps_.find(center);
    if (known != nullptr && known->at.holds(keyframes, center, range, allowed_shift())) {
      placed.back().submap = known->submap;
      continue;
    }
    submaps_.erase(center);
    const auto same =
        std::find_if(missing.begin(), missing.end(), [&](const Missing& m) { return m.center == center; });
    waiting.emplace_back(placed.size() - 1, static_cast<std::size_t>(same - missing.begin()));
    if (same == missing.end()) missing.push_back({center, range});
  }
  const Fragments parts = options_.fragment > 1 ? fragments(keyframes, missing, executor) : Fragments{};
  executor.for_chunks(to_index(missing.size()), 1, [&](Index k, Index /*end*/) {
    Missing& one = missing[static_cast<std::size_t>(k)];
    one.submap =
        std::make_shared<const Submap>(options_.fragment > 1 ? joined(keyframes, one.center, one.range, parts)
                                                             : oriented(keyframes, one.center, one.range, executor));
  });
  for (const Missing& one : missing) {
    ++built_;
    // Positions and normals, and as much again for the tree's own columns and links.
    const std::size_t bytes = one.submap->cloud().size() * 4 * sizeof(Eigen::Vector3f);
    submaps_.insert(one.center, {RigidRange(keyframes, one.center, one.range), one.submap}, bytes);
  }
  for (const auto& [place, made] : waiting) placed[place].submap = missing[made].submap;
  return placed;
}

template <Executor E>
SubmapCache::Fragments SubmapCache::fragments(std::span<const Keyframe> keyframes, std::span<const Missing> submaps,
                                              const E& executor) {
  Fragments all;
  std::vector<SubmapRange> missing;
  for (const Missing& submap : submaps) {
    for (Index begin = submap.range.begin; begin < submap.range.end;) {
      const SubmapRange range = fragment_of(keyframes, begin);
      begin = range.end;
      if (all.contains(range.begin)) continue;
      const std::shared_ptr<const Fragment>* known = fragments_.find(KeyframeId{range.begin});
      if (known != nullptr && (*known)->at.holds(keyframes, middle_of(range), range, allowed_shift())) {
        all[range.begin] = *known;
      } else {
        all[range.begin] = nullptr;
        missing.push_back(range);
      }
    }
  }
  std::vector<std::shared_ptr<const Fragment>> made(missing.size());
  executor.for_chunks(to_index(missing.size()), 1, [&](Index k, Index /*end*/) {
    const SubmapRange range = missing[static_cast<std::size_t>(k)];
    const KeyframeId center = middle_of(range);
    made[static_cast<std::size_t>(k)] = std::make_shared<const Fragment>(Fragment{
        RigidRange(keyframes, center, range), detail::PackedSurface(oriented(keyframes, center, range, executor))});
  });
  for (std::size_t k = 0; k < made.size(); ++k) {
    const KeyframeId first{missing[k].begin};
    ++fragments_built_;
    fragments_.erase(first);
    fragments_.insert(first, made[k], made[k]->points.bytes());
    all[first.value] = made[k];
  }
  return all;
}

inline PointCloud<float> SubmapCache::joined(std::span<const Keyframe> keyframes, KeyframeId center, SubmapRange range,
                                             const Fragments& fragments) const {
  const SE3d T_center_map = keyframes[static_cast<std::size_t>(center.value)].T_map_body.inverse();
  PointCloud<float> points;
  for (auto part = fragments.find(range.begin); part != fragments.end() && part->first < range.end; ++part) {
    const Fragment& one = *part->second;
    const SE3d T_center_part = T_center_map * keyframes[static_cast<std::size_t>(one.at.center.value)].T_map_body;
    append_seen_from(T_center_part, one.points.unpacked(), points);
  }
  return voxel_downsample(points, options_.voxel_size);
}

}  // namespace chainslam
