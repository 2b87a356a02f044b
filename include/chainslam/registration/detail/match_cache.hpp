#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/registration/detail/match_columns.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam::detail {

/// The nearest target point of every source point, searched anew only where it can have changed.
///
/// A search notes the four nearest points and the distance within which there are no others. Two tests come before
/// another search, both by the triangle inequality:
/// - while the query has moved by less than half of what the second is farther than the first, the first stays nearest;
/// - while the nearest of the four is nearer than any other can have come, it is the nearest of all.
/// So the answer is the one that a new search would give, to the bit: where rounding could decide, a search does. A
/// search begins with the bound that the old candidates give.
template <NearestNeighborSearch Target, Surface TargetSurface = Surface::nothing>
class MatchCache : public MatchColumns<typename Target::Scalar, TargetSurface> {
  using Base = MatchColumns<typename Target::Scalar, TargetSurface>;

 public:
  using Scalar = typename Target::Scalar;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;

  MatchCache(const Target& target, Index count, Scalar max_distance)
      : Base(count),
        target_(target),
        max_distance_(limited(target, max_distance) * (1 + 4 * safety)),
        reach_(limited(target, max_distance_ * Scalar(1.25))),
        queries_(count),
        limits_(count, Scalar(-1)),
        known_(static_cast<std::size_t>(count), Scalar(-1)),
        candidates_(static_cast<std::size_t>(count)) {}

  /// Pairs farther apart than this count for nothing.
  [[nodiscard]] static double within(const Target& target, double max_distance) {
    if constexpr (requires { target.max_search_radius(); })
      return std::min(max_distance, static_cast<double>(target.max_search_radius()));
    else
      return max_distance;
  }

  /// Brings the matches of points [begin, end) up to date. Different ranges may be updated at the same time.
  /// @param keep  whether to note what spares later searches; not worth it before a long way.
  void update(const SourceColumns& source, const Placement& at, Index begin, Index end, bool keep) {
    Index before = -1;  // the last point that was searched for: its matches bound what the next one needs to look at
    for_each_moved<Scalar>(source, at, begin, end, [&](Index i, const Vector3& query) {
      const Scalar moved = squared_way(i, query);
      if (moved < *limits_.at(0, i)) return;
      const Hint hint = look_at_candidates(i, query);
      if (hint.settled) return;
      Scalar bound = keep ? hint.all : hint.one;
      if (before >= 0) bound = std::min(bound, std::sqrt(farthest_candidate(before, query, keep ? kept : 1)));
      search(i, query, bound * (1 + safety), keep);
      before = i;
    });
  }

 private:
  static constexpr std::size_t kept = 4;
  /// Several roundings of a distance.
  static constexpr Scalar safety = 16 * std::numeric_limits<Scalar>::epsilon();

  /// Points near the last search, in columns; places not in use are far.
  struct alignas(32) Candidates {
    std::array<std::array<Scalar, kept>, 3> positions;
    std::array<Index, kept> indices;
    Candidates() {
      for (auto& row : positions) row.fill(Base::far);
      indices.fill(-1);
    }
  };
  /// What the candidates say: the match, or the distance within which one of them lies, or all.
  struct Hint {
    bool settled = false;
    Scalar one = Base::far;
    Scalar all = Base::far;
  };

  [[nodiscard]] static Scalar limited(const Target& target, Scalar max_distance) {
    return static_cast<Scalar>(within(target, static_cast<double>(max_distance)));
  }

  /// How far the query has moved since an answer was noted.
  [[nodiscard]] Scalar squared_way(Index i, const Vector3& query) const {
    const Scalar x = query[0] - *queries_.at(0, i), y = query[1] - *queries_.at(1, i),
                 z = query[2] - *queries_.at(2, i);
    return x * x + y * y + z * z;
  }
  /// Squared distance of the farthest of the first `count` candidates of point i.
  [[nodiscard]] Scalar farthest_candidate(Index i, const Vector3& query, std::size_t count) const {
    const Candidates& near = candidates_[static_cast<std::size_t>(i)];
    Scalar farthest = 0;
    for (std::size_t k = 0; k < count; ++k) {
      const Scalar dx = near.positions[0][k] - query[0], dy = near.positions[1][k] - query[1],
                   dz = near.positions[2][k] - query[2];
      farthest = std::max(farthest, dx * dx + dy * dy + dz * dz);
    }
    return farthest;
  }

  [[nodiscard]] Hint look_at_candidates(Index i, const Vector3& query) {
    Scalar& known = known_[static_cast<std::size_t>(i)];
    if (known < 0) return {};
    const Candidates& near = candidates_[static_cast<std::size_t>(i)];
    std::array<Scalar, kept> distances;
    for (std::size_t k = 0; k < kept; ++k) {
      const Scalar dx = near.positions[0][k] - query[0], dy = near.positions[1][k] - query[1],
                   dz = near.positions[2][k] - query[2];
      distances[k] = dx * dx + dy * dy + dz * dz;
    }
    std::size_t best = 0;
    for (std::size_t k = 1; k < kept; ++k) best = distances[k] < distances[best] ? k : best;
    Scalar second = Base::far * Base::far, last = 0;
    for (std::size_t k = 0; k < kept; ++k) {
      second = k != best && distances[k] < second ? distances[k] : second;
      last = std::max(last, distances[k]);
    }
    const Scalar first = std::sqrt(distances[best]);
    const Scalar moved = std::sqrt(squared_way(i, query));
    const Scalar others = std::min(std::sqrt(second), known - moved * (1 + safety)) * (1 - safety);
    if (first * (1 + safety) < others || (first > max_distance_ && others > max_distance_ * (1 + safety))) {
      known -= moved * (1 + safety);
      settle(i, query, near.indices[best], first, others);
      return {.settled = true};
    }
    return {.one = first, .all = std::sqrt(last)};
  }

  void search(Index i, const Vector3& query, Scalar bound, bool keep) {
    std::array<Neighbor<Scalar>, kept> nearest;
    const std::size_t wanted = keep ? kept : 1;
    bound = std::min(bound, keep ? reach_ : max_distance_);
    const auto found =
        static_cast<std::size_t>(target_.knn(query, std::span<Neighbor<Scalar>>(nearest.data(), wanted), bound));
    Candidates& near = candidates_[static_cast<std::size_t>(i)];
    for (std::size_t k = 0; k < kept; ++k) {
      for (auto& row : near.positions) row[k] = Base::far;
      near.indices[k] = -1;
      if (k >= found) continue;
      const auto& p = target_.position(nearest[k].index);
      for (std::size_t axis = 0; axis < 3; ++axis) near.positions[axis][k] = p[static_cast<Eigen::Index>(axis)];
      near.indices[k] = nearest[k].index;
    }
    Scalar& known = known_[static_cast<std::size_t>(i)];
    known = found == wanted ? std::sqrt(nearest[wanted - 1].squared_distance) : bound;
    const Scalar first = found > 0 ? std::sqrt(nearest[0].squared_distance) : Base::far;
    const Scalar second = found > 1 ? std::sqrt(nearest[1].squared_distance) : Base::far;
    settle(i, query, near.indices[0], first, std::min(second, known) * (1 - safety));
  }

  /// Notes the answer at `query`: the nearest lies at `first`, all others at `others` or beyond.
  void settle(Index i, const Vector3& query, Index nearest, Scalar first, Scalar others) {
    const bool within = first <= max_distance_;
    const Scalar slack =
        within ? others - first * (1 + safety) : 2 * (std::min(first, others) - max_distance_) * (1 - safety);
    queries_.set(i, std::array<Scalar, 3>{query[0], query[1], query[2]});
    *limits_.at(0, i) = slack > 0 ? slack * slack * Scalar(0.25) * (1 - safety) : Scalar(-1);
    this->set(target_, i, within ? nearest : -1);
  }

  const Target& target_;
  Scalar max_distance_;  ///< with room for rounding: a match may lie a little beyond
  /// How far is searched: a little beyond, so that points without a match need not be searched each time.
  Scalar reach_;
  Columns<Scalar, 3> queries_;  ///< where the answer was noted
  Columns<Scalar, 1> limits_;   ///< square of the way that the query may move before it must be looked at
  std::vector<Scalar> known_;   ///< distance from there within which the candidates are all there is
  std::vector<Candidates> candidates_;
};

}  // namespace chainslam::detail
