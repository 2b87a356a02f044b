#pragma once

#include <algorithm>
#include <cstddef>
#include <list>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/map/keyframe.hpp"
#include "chainslam/map/submap.hpp"
#include "chainslam/registration/surface_fit.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam {

/// The surroundings of a keyframe as a registration target: points with normals and their search, body frame.
using Submap = IndexedCloud<>;

struct SubmapOptions {
  Index radius = 20;                               ///< keyframes on each side of the centre (n of the paper)
  double voxel_size = 0.4;                         ///< metres
  Index normal_neighbors = 12;                     ///< points that a normal is fitted to
  double normal_radius = 2.0;                      ///< metres, their largest distance
  std::size_t max_bytes = std::size_t{512} << 20;  ///< of all submaps kept; the least recently used go first
};

/// Makes submaps and keeps those used last.
///
/// A submap stays good while the poses of its keyframes relative to the centre stay where they were, to within a
/// twentieth of a voxel; a correction of the graph that moves them all alike costs nothing.
class SubmapCache {
 public:
  explicit SubmapCache(const SubmapOptions& options = {}) : options_(options) {}

  [[nodiscard]] const SubmapOptions& options() const { return options_; }

  /// The submap around `center`, from the cache or made now. It stays alive as long as the caller holds it.
  /// @param keyframes  all keyframes of the map; ids are positions.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::shared_ptr<const Submap> get(std::span<const Keyframe> keyframes, KeyframeId center,
                                                                const E& executor = {});

  /// `surface_noise` of a submap that `get` gave, measured once for as long as it is kept.
  [[nodiscard]] double surface_noise(const Submap& submap) {
    const auto known = std::find_if(entries_.begin(), entries_.end(),
                                    [&](const Entry& entry) { return entry.submap.get() == &submap; });
    if (known == entries_.end()) return chainslam::surface_noise(submap);
    if (!known->surface_noise) known->surface_noise = chainslam::surface_noise(submap);
    return *known->surface_noise;
  }

  [[nodiscard]] std::size_t bytes() const { return bytes_; }  ///< of all submaps kept, about
  [[nodiscard]] std::size_t size() const { return entries_.size(); }
  [[nodiscard]] std::size_t built() const { return built_; }  ///< submaps made so far

 private:
  struct Entry {
    KeyframeId center;
    SubmapRange range;
    std::vector<SE3d> T_center_keyframe;
    std::shared_ptr<const Submap> submap;
    std::size_t bytes = 0;
    std::optional<double> surface_noise{};
  };
  using Entries = std::list<Entry>;

  [[nodiscard]] [[gnu::cold]] static std::vector<SE3d> relative_poses(std::span<const Keyframe> keyframes,
                                                                      KeyframeId center, SubmapRange range) {
    const SE3d T_center_map = keyframes[static_cast<std::size_t>(center.value)].T_map_body.inverse();
    std::vector<SE3d> poses;
    for (Index i = range.begin; i < range.end; ++i) {
      const SE3d T_center_keyframe = T_center_map * keyframes[static_cast<std::size_t>(i)].T_map_body;
      poses.push_back(T_center_keyframe);
    }
    return poses;
  }

  [[nodiscard]] [[gnu::cold]] bool still_good(const Entry& entry, std::span<const Keyframe> keyframes,
                                              SubmapRange range) const {
    if (!(entry.range == range)) return false;
    const double shift = options_.voxel_size / 20;
    constexpr double lever = 20;  // metres at which a turned scan has moved as far as a shifted one
    const std::vector<SE3d> now = relative_poses(keyframes, entry.center, range);
    for (std::size_t i = 0; i < now.size(); ++i) {
      const Vector6d moved = entry.T_center_keyframe[i].local(now[i]);
      if (block_of<3, 1>(moved, 0, 0).norm() + lever * block_of<3, 1>(moved, 3, 0).norm() > shift) return false;
    }
    return true;
  }

  template <Executor E>
  [[nodiscard]] [[gnu::cold]] Entry build(std::span<const Keyframe> keyframes, KeyframeId center, SubmapRange range,
                                          const E& executor) const;

  [[gnu::cold]] void erase(Entries::iterator entry) {
    bytes_ -= entry->bytes;
    entries_.erase(entry);
  }

  SubmapOptions options_;
  Entries entries_;  // the most recently used first
  std::size_t bytes_ = 0;
  std::size_t built_ = 0;
};

template <Executor E>
std::shared_ptr<const Submap> SubmapCache::get(std::span<const Keyframe> keyframes, KeyframeId center,
                                               const E& executor) {
  const SubmapRange range = submap_range(keyframes, center, options_.radius);
  auto known = entries_.begin();  // some hundred at the most: a search of nanoseconds
  while (known != entries_.end() && known->center != center) ++known;
  if (known != entries_.end()) {
    if (still_good(*known, keyframes, range)) {
      entries_.splice(entries_.begin(), entries_, known);
      return entries_.front().submap;
    }
    erase(known);
  }
  ++built_;
  entries_.push_front(build(keyframes, center, range, executor));
  bytes_ += entries_.front().bytes;
  while (bytes_ > options_.max_bytes && entries_.size() > 1) erase(std::prev(entries_.end()));
  return entries_.front().submap;
}

template <Executor E>
SubmapCache::Entry SubmapCache::build(std::span<const Keyframe> keyframes, KeyframeId center, SubmapRange range,
                                      const E& executor) const {
  PointCloud<float> points = assemble_submap(keyframes, center, range, options_.voxel_size);
  estimate_normals(points, NormalOptions{.neighbors = options_.normal_neighbors, .radius = options_.normal_radius},
                   Eigen::Vector3d::Zero(), executor);
  // Positions and normals, and as much again for the tree's own columns and links.
  const std::size_t bytes = points.size() * 4 * sizeof(Eigen::Vector3f);
  return {center, range, relative_poses(keyframes, center, range), std::make_shared<const Submap>(std::move(points)),
          bytes};
}

}  // namespace chainslam
