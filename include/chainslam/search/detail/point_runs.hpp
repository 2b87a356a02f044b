#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/growing_array.hpp"
#include "chainslam/search/detail/pack.hpp"

namespace chainslam::detail {

/// A point on its way from one place in a tree to another; three floats make one register.
template <class Scalar, int Dim, class Payload>
struct alignas(std::max(alignof(Payload), std::size_t{16})) TreePoint {
  std::array<Scalar, Dim> at;
  [[no_unique_address]] Payload payload;
};

/// Eight points in columns. Lanes not in use are infinitely far.
template <class Scalar, int Dim>
struct alignas(32) PointGroup {
  std::array<std::array<Scalar, pack_width>, Dim> at;
};

/// Where a leaf's points lie: one to four groups, one after the other.
class RunLink {
 public:
  static constexpr std::uint32_t max_groups = 4;
  static constexpr std::uint32_t max_points = max_groups * pack_width;

  RunLink() = default;
  explicit RunLink(std::uint32_t packed) : packed_(packed) {}
  RunLink(std::uint32_t first, std::uint32_t groups) : packed_(first | (groups - 1) << first_bits) {}

  [[nodiscard]] std::uint32_t packed() const { return packed_; }
  [[nodiscard]] std::uint32_t first() const { return packed_ & ((1U << first_bits) - 1); }
  [[nodiscard]] std::uint32_t groups() const { return (packed_ >> first_bits) + 1; }
  [[nodiscard]] std::uint32_t room() const { return groups() * static_cast<std::uint32_t>(pack_width); }
  /// Index of the point in a lane.
  [[nodiscard]] Index slot(std::uint32_t lane) const {
    return static_cast<Index>(first() * static_cast<std::uint32_t>(pack_width) + lane);
  }

 private:
  static constexpr int first_bits = 28;
  std::uint32_t packed_ = 0;
};

/// All points of a tree, in runs of groups in one arena; a freed run waits for the next of its length. Index of a
/// point, its slot: group * 8 + lane.
template <class Scalar, int Dim, class Payload>
class PointRuns {
 public:
  using Point = TreePoint<Scalar, Dim, Payload>;
  using Group = PointGroup<Scalar, Dim>;
  static constexpr bool has_payload = !std::is_empty_v<Payload>;

  [[nodiscard]] const Group* groups(RunLink run) const { return &groups_[run.first()]; }

  [[nodiscard]] Eigen::Matrix<Scalar, Dim, 1> position(Index slot) const {
    const auto [group, lane] = place(slot);
    Eigen::Matrix<Scalar, Dim, 1> p;
    for (std::size_t axis = 0; axis < Dim; ++axis) p[static_cast<Eigen::Index>(axis)] = groups_[group].at[axis][lane];
    return p;
  }
  [[nodiscard]] Payload payload(Index slot) const {
    if constexpr (has_payload)
      return payloads_[static_cast<std::size_t>(slot)];
    else
      return {};
  }
  [[nodiscard]] Point get(Index slot) const {
    const auto [group, lane] = place(slot);
    Point point{{}, payload(slot)};
    for (std::size_t axis = 0; axis < Dim; ++axis) point.at[axis] = groups_[group].at[axis][lane];
    return point;
  }
  void set(Index slot, const Point& point) {
    const auto [group, lane] = place(slot);
    for (std::size_t axis = 0; axis < Dim; ++axis) groups_[group].at[axis][lane] = point.at[axis];
    if constexpr (has_payload) payloads_[static_cast<std::size_t>(slot)] = point.payload;
  }
  void clear_lane(Index slot) {
    const auto [group, lane] = place(slot);
    groups_[group].at[0][lane] = std::numeric_limits<Scalar>::infinity();
  }

  /// Whether a point lies at the slot.
  [[nodiscard]] bool contains(Index slot) const {
    if (slot < 0 || static_cast<std::size_t>(slot) >= groups_.size() * pack_width) return false;
    const auto [group, lane] = place(slot);
    return (used_[group / 64] >> (group % 64) & 1U) != 0 &&
           groups_[group].at[0][lane] < std::numeric_limits<Scalar>::infinity();
  }

  /// An empty run with room for `points`.
  /// @throws std::invalid_argument if there are more groups than indices.
  [[nodiscard]] RunLink take(std::size_t points) {
    const std::size_t count = (points + pack_width - 1) / pack_width;
    std::uint32_t& free = free_[count - 1];
    std::size_t first = groups_.size();
    if (free == none) {
      static_cast<void>(to_index((first + count) * pack_width, "IkdTree"));
      groups_.resize(first + count);
      if constexpr (has_payload) payloads_.resize((first + count) * pack_width);
      used_.resize((first + count + 63) / 64);
    } else {
      first = free;
      std::memcpy(&free, &groups_[first], sizeof(free));
    }
    for (std::size_t i = first; i < first + count; ++i) {
      for (auto& axis : groups_[i].at) axis.fill(std::numeric_limits<Scalar>::infinity());
      used_[i / 64] |= std::uint64_t{1} << (i % 64);
    }
    return {static_cast<std::uint32_t>(first), static_cast<std::uint32_t>(count)};
  }

  void release(RunLink run) {
    for (std::size_t i = run.first(); i < run.first() + run.groups(); ++i)
      used_[i / 64] &= ~(std::uint64_t{1} << (i % 64));
    std::uint32_t& free = free_[run.groups() - 1];
    std::memcpy(static_cast<void*>(&groups_[run.first()]), &free, sizeof(free));
    free = run.first();
  }

  /// A run with at least `room` lanes that begins with the points of `run`, which it takes the place of.
  [[nodiscard]] RunLink grown(RunLink run, std::size_t room) {
    const RunLink larger = take(room);
    for (std::uint32_t i = 0; i < run.groups(); ++i) groups_[larger.first() + i] = groups_[run.first() + i];
    if constexpr (has_payload)
      for (std::uint32_t lane = 0; lane < run.room(); ++lane)
        payloads_[static_cast<std::size_t>(larger.slot(lane))] = payloads_[static_cast<std::size_t>(run.slot(lane))];
    release(run);
    return larger;
  }

  /// A new run with these points, 1 to 32.
  [[nodiscard]] RunLink store(const Point* points, std::size_t count) {
    const RunLink run = take(count);
    for (std::size_t i = 0; i < count; ++i) set(run.slot(static_cast<std::uint32_t>(i)), points[i]);
    return run;
  }

  [[nodiscard]] std::size_t memory() const {
    return groups_.memory() + payloads_.memory() + used_.capacity() * sizeof(std::uint64_t);
  }

 private:
  static constexpr std::uint32_t none = 0xffff'ffff;

  struct Place {
    std::size_t group, lane;
  };
  [[nodiscard]] static Place place(Index slot) {
    const auto i = static_cast<std::size_t>(slot);
    return {i / pack_width, i % pack_width};
  }

  GrowingArray<Group> groups_;
  GrowingArray<Payload> payloads_;   ///< by slot; nothing if there is no payload
  std::vector<std::uint64_t> used_;  ///< one bit a group: belongs to a leaf
  /// The free run of each length that was last released, or none; in its first bytes is the one before.
  std::array<std::uint32_t, RunLink::max_groups> free_{none, none, none, none};
};

}  // namespace chainslam::detail
