#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "search/structure.hpp"

namespace chainslam::bench {

/// The points of a map, by slots, one a voxel, that nearest its centre: what a caller of nanoflann must do by himself.
/// It has our hash table, so that the peer's thinning is as fast as it can be.
class ThinnedPoints {
 public:
  static constexpr std::uint32_t none = std::numeric_limits<std::uint32_t>::max();

  /// The slot that the point goes to, or none; and the slot of the point that it drives out, or none.
  struct Change {
    std::uint32_t added = none;
    std::uint32_t removed = none;
  };

  /// @param free_slot  where to put the point if it stays: called at most once
  template <class FreeSlot>
  Change offer(const Eigen::Vector3f& p, FreeSlot&& free_slot) {
    const Eigen::Vector3d scaled = p.cast<double>() / map_voxel;
    const std::optional<Cell> cell = cell_of(scaled);
    if (!cell) return {};
    const Index old = table_.find(*cell);
    if (old < 0) {
      const std::uint32_t slot = put(free_slot(), p);
      table_.insert(*cell, static_cast<Index>(slot));
      return {slot, none};
    }
    const auto held = static_cast<std::uint32_t>(old);
    if (!(offset(scaled, *cell) < offset(points[held].cast<double>() / map_voxel, *cell))) return {};
    const std::uint32_t slot = put(free_slot(), p);
    table_.assign(*cell, static_cast<Index>(slot));
    return {slot, held};
  }

  /// Overwrites a slot by the last point, and is one shorter.
  void move_last_to(std::uint32_t slot) {
    const std::uint32_t last = next_slot() - 1;
    if (slot != last) {
      points[slot] = points[last];
      if (const auto cell = cell_of(points[slot].cast<double>() / map_voxel))
        table_.assign(*cell, static_cast<Index>(slot));
    }
    points.pop_back();
  }

  void forget(std::uint32_t slot) {
    if (const auto cell = cell_of(points[slot].cast<double>() / map_voxel)) table_.erase(*cell);
  }
  void clear() {
    table_.clear();
    points.clear();
  }

  [[nodiscard]] std::uint32_t next_slot() const { return static_cast<std::uint32_t>(points.size()); }

  Points points;

 private:
  std::uint32_t put(std::uint32_t slot, const Eigen::Vector3f& p) {
    if (slot == points.size()) {
      points.push_back(p);
    } else {
      points[slot] = p;
    }
    return slot;
  }

  static double offset(const Eigen::Vector3d& scaled, const Cell& cell) {
    return (scaled - Eigen::Vector3d(cell.x + 0.5, cell.y + 0.5, cell.z + 0.5)).squaredNorm();
  }

  CellTable table_;
};

[[nodiscard]] inline bool inside(const Box& box, const Eigen::Vector3f& p) {
  return (p.array() >= box.low.array()).all() && (p.array() <= box.high.array()).all();
}

/// nanoflann's view of the points.
struct NanoflannPoints {
  const Points* points;
  [[nodiscard]] std::size_t kdtree_get_point_count() const { return points->size(); }
  [[nodiscard]] float kdtree_get_pt(std::size_t i, std::size_t axis) const {
    return (*points)[i][static_cast<Eigen::Index>(axis)];
  }
  template <class AnyBox>
  bool kdtree_get_bbox(AnyBox&) const {
    return false;
  }
};

}  // namespace chainslam::bench
