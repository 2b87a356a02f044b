#pragma once

#include <Eigen/Core>
#include <array>
#include <bit>
#include <cstddef>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/pack.hpp"
#include "chainslam/search/detail/point_lanes.hpp"
#include "chainslam/search/detail/small_nearest.hpp"
#include "chainslam/search/detail/voxel_block.hpp"

namespace chainslam::detail {

/// Up to eight points of a voxel; buckets of one voxel are chained.
template <class Scalar, int Dim>
struct VoxelBucket {
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  static constexpr int lanes = 8;
  static_assert(lanes == pack_width);

  Lanes<Scalar, lanes, Dim> points;
  Index next = -1;
  Index count = 0;

  void push_back(const Vector& p) { points.set(count++, p); }

  /// Erases the points for which `leaves(lane, position)` holds; the others keep their order. Returns how many went.
  template <class Predicate>
  Index erase_if(Predicate&& leaves) {
    int kept = 0;
    for (int lane = 0; lane < count; ++lane) {
      const Vector p = points.position(lane);
      if (!leaves(lane, p)) points.set(kept++, p);
    }
    const Index erased = count - kept;
    for (int lane = kept; lane < count; ++lane) points.clear(lane);
    count = kept;
    return erased;
  }
};

/// All points of a voxel map, in one array of buckets. A voxel's buckets form a chain whose first the block knows;
/// emptied ones are used again, the last freed first. Index of a point: bucket * lanes + lane.
template <class Scalar, int Dim>
class VoxelBuckets {
 public:
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  using Bucket = VoxelBucket<Scalar, Dim>;

  [[nodiscard]] bool contains(Index i) const {
    return i >= 0 && static_cast<std::size_t>(i / Bucket::lanes) < buckets_.size() &&
           i % Bucket::lanes < at(i / Bucket::lanes).count;
  }
  [[nodiscard]] Vector position(Index i) const { return at(i / Bucket::lanes).points.position(i % Bucket::lanes); }

  /// Bytes held, free room included.
  [[nodiscard]] std::size_t memory() const {
    return buckets_.capacity() * sizeof(Bucket) + free_.capacity() * sizeof(Index);
  }

  /// How many points the chain holds that begins at `bucket`.
  [[nodiscard]] Index points(Index bucket) const {
    Index count = 0;
    for (; bucket != none; bucket = at(bucket).next) count += at(bucket).count;
    return count;
  }

  /// Offers the chain's points to `found`.
  template <class Collector>
  void search(Index bucket, const Vector& query, Collector& found) const {
    for (; bucket != none; bucket = at(bucket).next) {
      const auto& columns = at(bucket).points.columns;
      Pack<Scalar> sum = Pack<Scalar>::all(0);
      for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
        const Pack<Scalar> d =
            Pack<Scalar>::load(columns[axis].data()) - Pack<Scalar>::all(query[static_cast<Eigen::Index>(axis)]);
        sum = axis == 0 ? d * d : sum + d * d;
      }
      unsigned near = sum.below(found.bound());
      if (near == 0) continue;
      alignas(64) std::array<Scalar, pack_width> distances;
      sum.store(distances.data());
      for (; near != 0; near &= near - 1) {
        const int lane = std::countr_zero(near);
        const Scalar distance = distances[static_cast<std::size_t>(lane)];
        if (refuses_cheaply<Collector> || distance < found.bound())  // which may have come nearer
          found.offer(bucket * Bucket::lanes + lane, distance);
      }
    }
  }

  /// Calls `visit(index, position)` for every point of the chain.
  template <class Visit>
  void for_each_point(Index bucket, Visit&& visit) const {
    for (; bucket != none; bucket = at(bucket).next)
      for (int lane = 0; lane < at(bucket).count; ++lane)
        visit(bucket * Bucket::lanes + lane, at(bucket).points.position(lane));
  }

  /// Adds a point to a voxel.
  /// @throws std::invalid_argument if there are more points than `Index` counts.
  void append(VoxelBlock& block, int voxel, const Vector& point) {
    Index bucket = block.first_bucket(voxel);
    if (bucket == none || at(bucket).count == Bucket::lanes) {
      const Index added = take();
      at(added).next = bucket;
      block.set_first_bucket(voxel, added);
      bucket = added;
    }
    at(bucket).push_back(point);
  }

  /// Erases the voxel's points for which `leaves(index, position)` holds. Returns how many went.
  template <class Predicate>
  Index erase_if(VoxelBlock& block, int voxel, Predicate&& leaves) {
    Index erased = 0;
    Index* link = block.link(voxel);
    while (*link != none) {
      Bucket& bucket = at(*link);
      const Index first = *link * Bucket::lanes;
      erased += bucket.erase_if([&](int lane, const Vector& p) { return leaves(first + lane, p); });
      if (bucket.count > 0) {
        link = &bucket.next;
        continue;
      }
      free_.push_back(*link);
      *link = std::exchange(bucket.next, none);
    }
    block.refresh(voxel);
    return erased;
  }

  /// Erases all of the voxel's points. Returns how many went.
  Index erase(VoxelBlock& block, int voxel) {
    Index erased = 0;
    for (Index bucket = block.first_bucket(voxel); bucket != none;) {
      Bucket& freed = at(bucket);
      erased += freed.count;
      free_.push_back(bucket);
      bucket = freed.next;
      freed = Bucket();
    }
    block.set_first_bucket(voxel, none);
    return erased;
  }

 private:
  static constexpr Index none = -1;

  [[nodiscard]] const Bucket& at(Index bucket) const { return buckets_[static_cast<std::size_t>(bucket)]; }
  [[nodiscard]] Bucket& at(Index bucket) { return buckets_[static_cast<std::size_t>(bucket)]; }

  /// An empty bucket.
  [[nodiscard]] Index take() {
    if (!free_.empty()) {
      const Index bucket = free_.back();
      free_.pop_back();
      return bucket;
    }
    const Index bucket = to_index((buckets_.size() + 1) * Bucket::lanes, "VoxelMap") / Bucket::lanes - 1;
    buckets_.emplace_back();
    return bucket;
  }

  std::vector<Bucket> buckets_;
  std::vector<Index> free_;
};

}  // namespace chainslam::detail
