#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <tuple>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// The pairs of one pass, as a rejector sees them. Pairs without a match, and rejected ones, are not kept.
template <class P>
concept RejectablePairs = requires(P& pairs, const P& seen, Index i) {
  { seen.size() } -> std::same_as<Index>;
  { seen.kept(i) } -> std::same_as<bool>;
  { seen.target(i) } -> std::same_as<Index>;             // the match's index
  { seen.squared_distance(i) } -> std::same_as<double>;  // m^2
  { seen.cosine(i) } -> std::same_as<double>;            // of the angle between the normals, NaN without one
  pairs.reject(i);
};

namespace detail {

/// The least that models `RejectablePairs`, to check rejectors by.
struct PairsArchetype {
  [[nodiscard]] Index size() const { return 0; }
  [[nodiscard]] bool kept(Index /*i*/) const { return false; }
  [[nodiscard]] Index target(Index /*i*/) const { return 0; }
  [[nodiscard]] double squared_distance(Index /*i*/) const { return 0; }
  [[nodiscard]] double cosine(Index /*i*/) const { return 0; }
  void reject(Index /*i*/) {}
};
static_assert(RejectablePairs<PairsArchetype>);

/// Rejects the kept pairs for which `wrong(i)` holds.
template <RejectablePairs Pairs, class Wrong>
void reject_if(Pairs& pairs, Wrong&& wrong) {
  for (Index i = 0; i < pairs.size(); ++i)
    if (pairs.kept(i) && wrong(i)) pairs.reject(i);
}

template <RejectablePairs Pairs>
[[nodiscard]] std::vector<double> kept_squared_distances(const Pairs& pairs) {
  std::vector<double> distances;
  for (Index i = 0; i < pairs.size(); ++i)
    if (pairs.kept(i)) distances.push_back(pairs.squared_distance(i));
  return distances;
}

}  // namespace detail

/// Drops pairs that look wrong, at every pass. `needs_normals` says whether it asks for `cosine`.
///
/// Law: what is rejected depends on the pairs alone.
template <class R>
concept MatchRejector = requires(const R& rejector, detail::PairsArchetype& pairs) {
  { R::needs_normals } -> std::convertible_to<bool>;
  rejector(pairs);
};

/// Keeps all pairs within the registration's own distance.
struct KeepPairs {
  static constexpr bool needs_normals = false;                     ///< whether pairs need the normals of both points
  void operator()(const RejectablePairs auto& /*pairs*/) const {}  ///< drops no pair
};
static_assert(MatchRejector<KeepPairs>);

/// Keeps pairs within a distance below the registration's own.
struct WithinDistance {
  static constexpr bool needs_normals = false;  ///< whether pairs need the normals of both points
  double max_distance = 0.5;                    ///< metres

  /// Drops pairs farther apart than the distance.
  void operator()(RejectablePairs auto& pairs) const {
    detail::reject_if(pairs, [&](Index i) { return !(pairs.squared_distance(i) <= max_distance * max_distance); });
  }
};
static_assert(MatchRejector<WithinDistance>);

/// Keeps pairs within a multiple of the median distance.
struct WithinMedian {
  static constexpr bool needs_normals = false;  ///< whether pairs need the normals of both points
  double factor = 3.0;                          ///< of the median distance

  /// Drops pairs farther apart than `factor` times the median.
  void operator()(RejectablePairs auto& pairs) const {
    std::vector<double> squares = detail::kept_squared_distances(pairs);
    if (squares.empty()) return;
    const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
    std::nth_element(squares.begin(), middle, squares.end());
    const double most = factor * factor * *middle;
    detail::reject_if(pairs, [&](Index i) { return !(pairs.squared_distance(i) <= most); });
  }
};
static_assert(MatchRejector<WithinMedian>);

/// Keeps pairs whose surfaces lie alike; normals that point opposite ways do, too, unless `oriented`. Pairs without two
/// normals are dropped. Source and target need normals.
struct WithinAngle {
  static constexpr bool needs_normals = true;  ///< whether pairs need the normals of both points
  double max_angle = 0.5;                      ///< radians
  bool oriented = false;                       ///< whether normals point to where the surface was seen from

  /// Drops pairs whose normals enclose a larger angle.
  void operator()(RejectablePairs auto& pairs) const {
    const double least = std::cos(max_angle);
    detail::reject_if(pairs, [&](Index i) {
      const double cosine = pairs.cosine(i);
      return !((oriented ? cosine : std::abs(cosine)) >= least);
    });
  }
};
static_assert(MatchRejector<WithinAngle>);

/// Of the source points that share a match keeps the nearest, of equally near ones the first.
struct OneToOne {
  static constexpr bool needs_normals = false;  ///< whether pairs need the normals of both points

  /// Of pairs with one target point, drops all but the nearest.
  void operator()(RejectablePairs auto& pairs) const {
    std::vector<Index> nearest;
    for (Index i = 0; i < pairs.size(); ++i) {
      if (!pairs.kept(i)) continue;
      const auto target = static_cast<std::size_t>(pairs.target(i));
      if (target >= nearest.size()) nearest.resize(std::max(target + 1, 2 * nearest.size()), -1);
      const Index other = nearest[target];
      if (other >= 0 && !(pairs.squared_distance(i) < pairs.squared_distance(other))) {
        pairs.reject(i);
        continue;
      }
      if (other >= 0) pairs.reject(other);
      nearest[target] = i;
    }
  }
};
static_assert(MatchRejector<OneToOne>);

/// Keeps the nearest share of the pairs (Chetverikov et al. 2002): as many as the clouds are thought to overlap.
struct Trimmed {
  static constexpr bool needs_normals = false;  ///< whether pairs need the normals of both points
  double share = 0.8;                           ///< in (0, 1]

  /// Drops the largest distances.
  void operator()(RejectablePairs auto& pairs) const {
    std::vector<double> squares = detail::kept_squared_distances(pairs);
    const auto wanted = static_cast<std::size_t>(std::ceil(share * static_cast<double>(squares.size())));
    if (wanted == 0 || wanted >= squares.size()) return;
    const auto last = squares.begin() + static_cast<std::ptrdiff_t>(wanted - 1);
    std::nth_element(squares.begin(), last, squares.end());
    const double most = *last;
    detail::reject_if(pairs, [&](Index i) { return !(pairs.squared_distance(i) <= most); });
  }
};
static_assert(MatchRejector<Trimmed>);

/// Several rejectors, each on what the ones before it left.
template <MatchRejector... Rejectors>
struct AllOf {
  /// Whether pairs need the normals of both points.
  static constexpr bool needs_normals = (Rejectors::needs_normals || ...);
  std::tuple<Rejectors...> parts{};  ///< applied in this order

  /// Applies all parts.
  void operator()(RejectablePairs auto& pairs) const {
    std::apply([&](const Rejectors&... rejectors) { (rejectors(pairs), ...); }, parts);
  }
};
static_assert(MatchRejector<AllOf<WithinAngle, OneToOne>>);

}  // namespace chainslam
