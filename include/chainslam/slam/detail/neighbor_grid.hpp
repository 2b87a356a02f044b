#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Numbered positions by the cube of space that they lie in: what is near some position is found at the cost of what is
/// there, however many positions there are, and one that has moved is entered again at the cost of itself.
///
/// A table of lists. Cubes may share a list, which only makes it longer.
class NeighborGrid {
 public:
  /// @param cell  side of a cube, metres: about the radius of searches.
  explicit NeighborGrid(double cell) : cell_(cell) {}

  /// Takes all positions out.
  void clear() {
    for (Index& first : first_) first = none;
    at_.clear();
  }

  /// Enters the next position, under the number that `size` was before.
  void add(const Eigen::Vector3d& position) {
    at_.push_back({position, cube_of(position)});
    if (at_.size() > first_.size())
      grow();
    else
      link(size() - 1);
  }
  /// A numbered position has moved.
  void move(Index number, const Eigen::Vector3d& position) {
    Entry& entry = at_[number];
    entry.position = position;
    const Cube cube = cube_of(position);
    if (cube == entry.cube) return;
    unlink(number);
    entry.cube = cube;
    link(number);
  }

  [[nodiscard]] Index size() const { return to_index(at_.size()); }

  /// Calls visit(number, position) for all in a ball, in any order, and for some that lie around it.
  template <class Visit>
  void for_each_near(const Eigen::Vector3d& center, double radius, Visit&& visit) const {
    constexpr double most = 6;  // cubes across, of which more than that would be empty
    if (at_.empty()) return;
    if (!(2 * radius <= most * cell_)) {
      for (Index number = 0; number < size(); ++number) visit(number, at_[number].position);
      return;
    }
    const Eigen::Vector3d reach(radius, radius, radius);
    const Eigen::Vector3d low = center - reach, high = center + reach;
    const Cube least = cube_of(low), last = cube_of(high);
    Cube cube;
    for (cube.x = least.x; cube.x <= last.x; ++cube.x)
      for (cube.y = least.y; cube.y <= last.y; ++cube.y)
        for (cube.z = least.z; cube.z <= last.z; ++cube.z)
          for (Index number = first_[list_of(cube)]; number != none; number = at_[number].next)
            if (at_[number].cube == cube) visit(number, at_[number].position);
  }

 private:
  static constexpr Index none = -1;

  struct Cube {
    std::int32_t x = 0, y = 0, z = 0;
    bool operator==(const Cube&) const = default;
  };
  struct Entry {
    Eigen::Vector3d position{0.0, 0.0, 0.0};
    Cube cube{};
    Index next = none, previous = none;  ///< in its list
  };

  [[nodiscard]] std::int32_t cube_of(double coordinate) const {
    constexpr double most = 1e9;  // beyond, all lie in one cube, and so does what is no number
    const double at = std::floor(coordinate / cell_);
    return std::abs(at) < most ? static_cast<std::int32_t>(at) : std::int32_t{0};
  }
  [[nodiscard]] Cube cube_of(const Eigen::Vector3d& position) const {
    return {cube_of(position.x()), cube_of(position.y()), cube_of(position.z())};
  }
  [[nodiscard]] Offset list_of(const Cube& cube) const {
    std::uint64_t hash = static_cast<std::uint32_t>(cube.x) * 0x9e3779b97f4a7c15U;
    hash = (hash ^ (hash >> 32U) ^ static_cast<std::uint32_t>(cube.y)) * 0xbf58476d1ce4e5b9U;
    hash = (hash ^ (hash >> 32U) ^ static_cast<std::uint32_t>(cube.z)) * 0x94d049bb133111ebU;
    return static_cast<Offset>((hash ^ (hash >> 32U)) & static_cast<std::uint64_t>(first_.size() - 1));
  }

  void link(Index number) {
    Entry& entry = at_[number];
    Index& first = first_[list_of(entry.cube)];
    entry.previous = none;
    entry.next = first;
    if (first != none) at_[first].previous = number;
    first = number;
  }
  void unlink(Index number) {
    const Entry& entry = at_[number];
    if (entry.next != none) at_[entry.next].previous = entry.previous;
    (entry.previous != none ? at_[entry.previous].next : first_[list_of(entry.cube)]) = entry.next;
  }

  [[gnu::cold]] void grow() {
    constexpr Offset smallest = 64;
    first_.assign(first_.empty() ? smallest : 2 * first_.size(), none);
    for (Index number = 0; number < size(); ++number) link(number);
  }

  double cell_;
  Table<Index> first_;  ///< of each list; as many as a power of two
  Table<Entry> at_;     ///< by number
};

}  // namespace chainslam::detail
