#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam::detail {

/// The match of every source point, searched anew only where it can have changed.
///
/// A search notes the distances d1 and d2 of the two nearest points. While the query has moved by less than (d2 - d1) /
/// 2 since, no other point can have come nearer, so the answer is the one a new search would give, to the bit: bounds
/// are taken with the rounding of the scalar on the safe side.
template <NearestNeighborSearch Target>
class MatchCache {
 public:
  using Scalar = typename Target::Scalar;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;

  struct Match {
    Index index = -1;  ///< -1: none within the largest distance
    Scalar squared_distance = 0;
  };

  MatchCache(const Target& target, Index count, Scalar max_distance)
      : target_(target),
        max_distance_(limited(target, max_distance)),
        reach_(max_distance_ * Scalar(1.25)),
        entries_(static_cast<std::size_t>(count)) {}

  /// The nearest target point of source point i, which is now at `query`. Different i may be asked for at the same
  /// time.
  [[nodiscard]] Match find(Index i, const Vector3& query) {
    Entry& entry = entries_[static_cast<std::size_t>(i)];
    const Scalar moved = (query - entry.query).norm() * (1 + safety);
    if (!(2 * moved < entry.slack)) search(entry, query, moved);
    if (entry.index < 0) return {};
    const Scalar squared_distance = (target_.position(entry.index) - query).squaredNorm();
    return squared_distance <= max_distance_ * max_distance_ ? Match{entry.index, squared_distance} : Match{};
  }

 private:
  struct Entry {
    Vector3 query = Vector3::Zero();  ///< where it was searched
    Scalar slack = -1;                ///< twice the way the query may move before the answer can change
    Scalar second = std::numeric_limits<Scalar>::infinity();  ///< distance within which two points were known
    Index index = -1;
  };

  /// Several roundings of a distance.
  static constexpr Scalar safety = 16 * std::numeric_limits<Scalar>::epsilon();

  [[nodiscard]] static Scalar limited(const Target& target, Scalar max_distance) {
    if constexpr (requires { target.max_search_radius(); })
      return std::min(max_distance, static_cast<Scalar>(target.max_search_radius()));
    else
      return max_distance;
  }

  void search(Entry& entry, const Vector3& query, Scalar moved) const {
    std::array<Neighbor<Scalar>, 2> nearest;
    // Two points that were within `second` still are within it and the way moved.
    const Scalar bound = std::min(reach_, (entry.second + moved) * (1 + safety));
    const Index found = target_.knn(query, nearest, bound);
    entry.query = query;
    entry.index = found > 0 ? nearest[0].index : -1;
    if (found == 0) {
      entry.second = std::numeric_limits<Scalar>::infinity();
      entry.slack = 2 * (bound * (1 - safety) - max_distance_);
      return;
    }
    const Scalar first = std::sqrt(nearest[0].squared_distance);
    const Scalar second = found > 1 ? std::sqrt(nearest[1].squared_distance) : bound;
    entry.second = found > 1 ? second : std::numeric_limits<Scalar>::infinity();
    entry.slack = second * (1 - safety) - first * (1 + safety);
  }

  const Target& target_;
  Scalar max_distance_;
  Scalar
      reach_;  ///< how far is searched: a little beyond, so that points without a match need not be searched each time
  std::vector<Entry> entries_;
};

}  // namespace chainslam::detail
