#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <concepts>
#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"
#include "place_descriptor.hpp"

namespace chainslam {

/// When two triangles count as the same, and which places are candidates. Defaults: LAMM's configuration for NCLT.
struct TableOptions {
  double side_resolution = 0.2;       ///< metres, of the table's cells
  double max_side_difference = 0.01;  ///< of the three sides together, over their length
  double min_similarity = 0.7;        ///< mean over the corners of the occupancies' similarity
  Index min_votes = 4;                ///< triangles that a candidate shares with the query
  Index max_candidates = 50;
};

/// A triangle of the query and one of a place that look the same, by their numbers.
struct TriangleMatch {
  Index query = 0;
  Index place = 0;
};

/// A place that shares triangles with a query.
struct PlaceCandidate {
  Index place = 0;
  std::vector<TriangleMatch> matches{};
};

/// Places by the sides of their triangles: finds those that share most with a query (Yuan et al. 2023, STD).
class DescriptorTable {
 public:
  explicit DescriptorTable(const TableOptions& options = {}) : options_(options) {}

  /// Adds a place. @returns its number: 0, 1, ...
  Index add(std::shared_ptr<const PlaceDescriptor> place) {
    const Index number = to_index(places_.size());
    for (std::size_t i = 0; i < place->triangles.size(); ++i) {
      const auto cell = cell_at(place->triangles[i].sides);
      if (!cell) continue;
      const auto [bucket, is_new] = cells_.insert(*cell, to_index(buckets_.size()));
      if (is_new) buckets_.emplace_back();
      buckets_[static_cast<std::size_t>(bucket)].push_back({place->triangles[i].sides, number, to_index(i)});
    }
    places_.push_back(std::move(place));
    return number;
  }

  [[nodiscard]] Index size() const { return to_index(places_.size()); }
  [[nodiscard]] const PlaceDescriptor& place(Index number) const { return *places_[static_cast<std::size_t>(number)]; }

  /// The places that share most triangles with a query, those with most first, of equals the one added first.
  /// @param eligible  `bool eligible(Index place)`: whether a place may be found at all.
  template <std::predicate<Index> Eligible, Executor Exec = Serial>
  [[nodiscard]] std::vector<PlaceCandidate> candidates(const PlaceDescriptor& query, const Eligible& eligible,
                                                       const Exec& executor = {}) const {
    std::vector<PlaceCandidate> votes(places_.size());
    for (std::size_t i = 0; i < votes.size(); ++i) votes[i].place = to_index(i);
    for (const Found& found : all_matches(query, eligible, executor))
      votes[static_cast<std::size_t>(found.place)].matches.push_back(found.match);
    std::erase_if(votes, [&](const PlaceCandidate& one) { return to_index(one.matches.size()) < options_.min_votes; });
    std::ranges::stable_sort(votes, std::ranges::greater{},
                             [](const PlaceCandidate& one) { return one.matches.size(); });
    if (to_index(votes.size()) > options_.max_candidates)
      votes.resize(static_cast<std::size_t>(options_.max_candidates));
    return votes;
  }

 private:
  struct Entry {
    Eigen::Vector3f sides;
    Index place;
    Index triangle;
  };
  struct Found {
    Index place;
    TriangleMatch match;
  };

  /// Entries of the cells about a triangle's.
  struct Nearby {
    std::array<const std::vector<Entry>*, 27> buckets;
    std::size_t count = 0;
  };

  [[nodiscard]] std::optional<Cell> cell_at(const Eigen::Vector3f& sides) const {
    return cell_of(sides.cast<double>() / options_.side_resolution);
  }

  template <class Eligible, class Exec>
  [[nodiscard]] std::vector<Found> all_matches(const PlaceDescriptor& query, const Eligible& eligible,
                                               const Exec& executor) const {
    const auto chunk = [&](Index begin, Index end) {
      std::vector<Found> found;
      for (Index i = begin; i < end; ++i) add_matches(query, i, eligible, found);
      return found;
    };
    const auto append = [](std::vector<Found> left, std::vector<Found> right) {
      if (left.empty()) return right;
      left.insert(left.end(), right.begin(), right.end());
      return left;
    };
    return reduce_chunks(executor, to_index(query.triangles.size()), 256, std::vector<Found>{}, chunk, append);
  }

  /// Of one triangle of the query, in the cells about its own whose middle is near enough.
  template <class Eligible>
  void add_matches(const PlaceDescriptor& query, Index number, const Eligible& eligible,
                   std::vector<Found>& found) const {
    const Triangle& triangle = query.triangles[static_cast<std::size_t>(number)];
    const auto limit = static_cast<float>(options_.max_side_difference) * triangle.sides.norm();
    const Nearby near = buckets_near(triangle);
    // Each cell is somewhere else in memory: all are fetched before the first is read.
    for (std::size_t k = 0; k < near.count; ++k) __builtin_prefetch(near.buckets[k]);
    for (std::size_t k = 0; k < near.count; ++k) __builtin_prefetch(near.buckets[k]->data());
    for (std::size_t k = 0; k < near.count; ++k)
      for (const Entry& entry : *near.buckets[k])
        if ((triangle.sides - entry.sides).squaredNorm() < limit * limit && eligible(entry.place) &&
            look_the_same(query, triangle, entry))
          found.push_back({entry.place, {number, entry.triangle}});
  }

  [[nodiscard]] Nearby buckets_near(const Triangle& triangle) const {
    constexpr double reach = 1.5;  // cells
    Nearby near;
    const auto home = cell_at(triangle.sides);
    if (!home) return near;
    const Eigen::Vector3d at = triangle.sides.cast<double>() / options_.side_resolution;
    for (int dx = -1; dx <= 1; ++dx)
      for (int dy = -1; dy <= 1; ++dy)
        for (int dz = -1; dz <= 1; ++dz) {
          const Cell cell{home->x + dx, home->y + dy, home->z + dz};
          const Eigen::Vector3d middle = Eigen::Vector3d(cell.x, cell.y, cell.z).array() + 0.5;
          if ((middle - at).norm() >= reach) continue;
          const Index bucket = cells_.find(cell);
          if (bucket >= 0) near.buckets[near.count++] = &buckets_[static_cast<std::size_t>(bucket)];
        }
    return near;
  }

  /// By what surrounds the corners; the sides are alike.
  [[nodiscard]] bool look_the_same(const PlaceDescriptor& query, const Triangle& triangle, const Entry& entry) const {
    const PlaceDescriptor& other = place(entry.place);
    const Triangle& match = other.triangles[static_cast<std::size_t>(entry.triangle)];
    double sum = 0;
    for (std::size_t k = 0; k < 3; ++k)
      sum += similarity(query.keypoints[triangle.corners[k]], other.keypoints[match.corners[k]]);
    return sum / 3 > options_.min_similarity;
  }

  TableOptions options_;
  CellTable cells_;  ///< of the triangles' sides: the numbers of buckets
  std::vector<std::vector<Entry>> buckets_;
  std::vector<std::shared_ptr<const PlaceDescriptor>> places_;
};

}  // namespace chainslam
