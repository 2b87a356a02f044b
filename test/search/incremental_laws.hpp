#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "search/search_laws.hpp"
#include "search/thinned_brute_force.hpp"
#include "support/quick.hpp"

namespace chainslam::test {

/// A model of IncrementalSearch and brute force that keeps the same points, taken through the same history.
template <class Map, class Reference>
class History {
 public:
  using Scalar = typename Map::Scalar;
  using Vector = SearchVector<Map>;
  using Box = SearchBox<Map>;
  static constexpr int dimension = search_dimension<Map>;
  static constexpr Scalar infinity = std::numeric_limits<Scalar>::infinity();

  History(Map map, Reference reference, const Vector& origin)
      : map_(std::move(map)), reference_(std::move(reference)), origin_(origin) {
    if constexpr (requires { map_.max_search_radius(); }) limit_ = map_.max_search_radius();
  }

  /// At once or one by one, which is the same to the bit; but an empty map may build what it gets at once.
  void insert(const std::vector<Vector>& points, Rng& rng) {
    const bool at_once = rng.uniform() < 0.5;
    std::optional<Map> twin;
    if (map_.size() > 0 && rng.uniform_index(4) == 0) twin = map_;
    if (at_once) {
      CHECK(map_.insert(points) == reference_.insert(points));
    } else {
      for (const Vector& p : points) CHECK(map_.insert(p) == reference_.insert(p));
    }
    if (!twin) return;
    if (at_once)
      for (const Vector& p : points) twin->insert(p);
    else
      twin->insert(points);
    CHECK(twin->rejected() == map_.rejected());
    CHECK(places(*twin) == places(map_));
  }

  /// One erasure of a random kind.
  void erase(Rng& rng) {
    const Vector center = origin_ + random_vector(rng, 6);
    const Vector half = random_vector(rng, 4).cwiseAbs();
    const Box box(center - half, center + half);
    const auto radius = static_cast<Scalar>(rng.uniform(0, 4));
    const auto kind = rng.uniform_index(9);
    CAPTURE(kind);
    switch (kind) {
      case 0:
        return check_same(map_.erase_inside(box), reference_.erase_inside(box));
      case 1:
        return check_same(map_.erase_nearer_than(center, radius), reference_.erase_nearer_than(center, radius));
      case 2:
        return check_same(map_.erase_farther_than(center, radius * 3),
                          reference_.erase_farther_than(center, radius * 3));
      case 3: {
        const Box large(origin_ - Vector::Constant(radius * 2), origin_ + Vector::Constant(radius * 2));
        return check_same(map_.erase_outside(large), reference_.erase_outside(large));
      }
      case 4: {
        const auto leaves = [&](Index, const Vector& p) { return p[1] < center[1] && p[0] > center[0]; };
        return check_same(map_.erase_if(leaves), reference_.erase_if(leaves));
      }
      case 5:
        return erase_some_by_predicate_of_index();
      case 6:
        return erase_near_by_index(center);
      default:
        return erase_a_point(center, rng);
    }
  }

  /// Sizes, iteration, boxes and searches agree.
  void check(Rng& rng) {
    REQUIRE(map_.size() == reference_.size());
    CHECK(map_.rejected() == reference_.rejected());
    CHECK(sorted_points(map_) == sorted_points(reference_));
    const Box ours = map_.bounding_box(), theirs = reference_.bounding_box();
    CHECK(ours.isEmpty() == theirs.isEmpty());
    if (!theirs.isEmpty()) CHECK((ours.min() == theirs.min() && ours.max() == theirs.max()));

    Vector query = origin_ + random_vector(rng, 6);
    if (rng.uniform() < 0.3) query = query.array().round();
    check_query(map_, reference_, query, rng.uniform_index(9), infinity, limit_);
    check_query(map_, reference_, query, 5, static_cast<Scalar>(rng.uniform(0, 3)), limit_);
    check_other_searches(map_, query, infinity, seeds_);
    const Index found = map_.knn(query, answer_, infinity);
    seeds_ = std::span(answer_).first(static_cast<std::size_t>(found));

    const Vector half = random_vector(rng, 3).cwiseAbs();
    const Box box(query - half, query + half);
    std::vector<Index> in_box{-7}, in_box_reference;
    map_.within_box(box, in_box);
    reference_.within_box(box, in_box_reference);
    CHECK(in_box.size() == in_box_reference.size());
    std::ranges::sort(in_box);
    CHECK(std::ranges::adjacent_find(in_box) == in_box.end());
    for (const Index i : in_box) CHECK(box.contains(Vector(map_.position(i))));
  }

  /// Goes on with a copy of a copy, which the original's end must not touch.
  void change_places() {
    Map copy(map_);
    map_.clear();
    CHECK(map_.size() == 0);
    CHECK(map_.bounding_box().isEmpty());
    Map moved(std::move(copy));
    map_ = std::move(moved);
  }

  [[nodiscard]] Map& map() { return map_; }

 private:
  static Vector random_vector(Rng& rng, double extent) {
    return random_point<Scalar>(rng, extent, extent, extent).template head<dimension>();
  }

  static void check_same(Index ours, Index theirs) { CHECK(ours == theirs); }

  template <class Search>
  static std::vector<std::array<Scalar, dimension>> sorted_points(const Search& search) {
    std::vector<std::array<Scalar, dimension>> points;
    search.for_each_point([&](Index i, const Vector& p) {
      CHECK(Vector(search.position(i)) == p);
      std::copy_n(p.data(), dimension, points.emplace_back().begin());
    });
    std::ranges::sort(points);
    return points;
  }

  static std::vector<std::pair<Index, Vector>> places(const Map& map) {
    std::vector<std::pair<Index, Vector>> all;
    map.for_each_point([&](Index i, const Vector& p) { all.emplace_back(i, p); });
    return all;
  }

  /// Erases one of the reference's points at p.
  void erase_from_reference(const Vector& p) {
    std::array<Neighbor<Scalar>, 1> nearest;
    REQUIRE(reference_.knn(p, nearest) == 1);
    REQUIRE(nearest[0].squared_distance == 0);
    CHECK(reference_.erase(nearest[0].index));
  }

  void erase_some_by_predicate_of_index() {
    std::vector<Vector> gone;
    const Index erased = map_.erase_if([&](Index i, const Vector& p) {
      CHECK(Vector(map_.position(i)) == p);
      if (i % 3 != 0) return false;
      gone.push_back(p);
      return true;
    });
    CHECK(erased == static_cast<Index>(gone.size()));
    for (const Vector& p : gone) erase_from_reference(p);
  }

  void erase_near_by_index(const Vector& center) {
    CHECK_FALSE(map_.erase(Index(-1)));
    CHECK_FALSE(map_.erase(std::numeric_limits<Index>::max()));
    for (int i = 0; i < 5; ++i) {
      std::array<Neighbor<Scalar>, 2> nearest;
      const Index found = map_.knn(center, nearest, infinity);
      if (found == 0) return;
      const Index index = nearest[static_cast<std::size_t>(found - 1)].index;
      const Vector p = map_.position(index);
      CHECK(map_.erase(index));
      erase_from_reference(p);
      CHECK(map_.size() == reference_.size());
    }
  }

  void erase_a_point(const Vector& center, Rng& rng) {
    std::array<Neighbor<Scalar>, 1> nearest;
    Vector p = center;
    if (reference_.knn(center, nearest) == 1 && rng.uniform() < 0.9) p = reference_.position(nearest[0].index);
    check_same(map_.erase_point(p), reference_.erase_point(p));
    CHECK(map_.erase_point(p) == 0);
  }

  Map map_;
  Reference reference_;
  Vector origin_;
  Scalar limit_ = infinity;
  std::array<Neighbor<Scalar>, 5> answer_;
  std::span<const Neighbor<Scalar>> seeds_;  ///< the last answer, whatever has happened to its points since
};

/// The laws of IncrementalSearch, against brute force, in random histories over every distribution, near the origin and
/// 500 km away.
///
/// @param make            `Map make()`: an empty map.
/// @param make_reference  brute force that keeps the same points, empty.
template <class Make, class MakeReference>
void check_incremental_laws(Make&& make, MakeReference&& make_reference, int histories = quick() ? 4 : 12,
                            int steps = 30) {
  using Map = decltype(make());
  using Scalar = typename Map::Scalar;
  using Vector = SearchVector<Map>;
  constexpr int dimension = search_dimension<Map>;
  for (const double away : {0.0, 500'000.0}) {
    const Eigen::Matrix<Scalar, 3, 1> origin = Eigen::Vector3d(away, -away, away / 5000).cast<Scalar>();
    for (const Distribution<Scalar>& distribution : distributions<Scalar>()) {
      CAPTURE(away);
      CAPTURE(distribution.name);
      for_all(histories, [&](Rng& rng, int size) {
        History<Map, decltype(make_reference())> history(make(), make_reference(), origin.template head<dimension>());
        for (int step = 0; step < steps; ++step) {
          CAPTURE(step);
          std::vector<Vector> points;
          for (const auto& p : distribution.make(rng, 2 * size * (1 + rng.uniform_index(12))))
            points.push_back((origin + p).template head<dimension>());
          history.insert(points, rng);
          if (rng.uniform() < 0.8) history.erase(rng);
          if (step % 8 == 5) history.change_places();
          history.check(rng);
        }
      });
    }
  }
}

/// The same for a map that keeps every point it is given.
template <class Make>
void check_incremental_laws(Make&& make) {
  using Map = decltype(make());
  check_incremental_laws(make, [] { return BruteForce<typename Map::Scalar, search_dimension<Map>>(); });
}

/// The same for a map that thins by a policy.
template <class Map, class Policy>
void check_thinning_laws(const Policy& policy) {
  check_incremental_laws(
      [&] { return Map(policy); },
      [&] { return ThinnedBruteForce<typename Map::Scalar, Policy, search_dimension<Map>>(policy); });
}

}  // namespace chainslam::test
