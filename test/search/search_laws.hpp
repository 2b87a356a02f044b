#pragma once

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <limits>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "chainslam/search/brute_force.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"

namespace chainslam::test {

template <class Scalar>
using Points = std::vector<Eigen::Matrix<Scalar, 3, 1>>;

inline constexpr float unlimited = std::numeric_limits<float>::infinity();  ///< a `max_distance`

/// A named way of placing points.
template <class Scalar>
struct Distribution {
  std::string name;
  Points<Scalar> (*make)(Rng& rng, int count);
};

template <class Scalar>
Eigen::Matrix<Scalar, 3, 1> random_point(Rng& rng, double x, double y, double z) {
  return Eigen::Vector3d(rng.uniform(-x, x), rng.uniform(-y, y), rng.uniform(-z, z)).template cast<Scalar>();
}

template <class Scalar, class Make>
Points<Scalar> repeat(int count, Make&& make) {
  Points<Scalar> points;
  for (int i = 0; i < count; ++i) points.push_back(make(i));
  return points;
}

/// Everything that has ever broken a search structure. Extents of about 10 m.
template <class Scalar>
std::vector<Distribution<Scalar>> distributions() {
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  return {
      {"empty", [](Rng&, int) { return Points<Scalar>{}; }},
      {"one point", [](Rng& rng, int) { return Points<Scalar>{random_point<Scalar>(rng, 5, 5, 5)}; }},
      {"uniform",
       [](Rng& rng, int n) { return repeat<Scalar>(n, [&](int) { return random_point<Scalar>(rng, 5, 5, 5); }); }},
      {"a plane",
       [](Rng& rng, int n) { return repeat<Scalar>(n, [&](int) { return random_point<Scalar>(rng, 5, 5, 0); }); }},
      {"a slanted line",
       [](Rng& rng, int n) {
         return repeat<Scalar>(
             n, [&](int) { return Vector3(Vector3(1, Scalar(0.5), Scalar(-0.25)) * Scalar(rng.uniform(-5, 5))); });
       }},
      {"an integer grid, full of exact ties",
       [](Rng& rng, int n) {
         return repeat<Scalar>(n, [&](int) {
           return Vector3(Scalar(rng.uniform_index(7)), Scalar(rng.uniform_index(7)), Scalar(rng.uniform_index(3)));
         });
       }},
      {"duplicates",
       [](Rng& rng, int n) {
         auto points = repeat<Scalar>(n / 4 + 1, [&](int) { return random_point<Scalar>(rng, 3, 3, 3); });
         const auto distinct = static_cast<Index>(points.size());
         while (static_cast<int>(points.size()) < n)
           points.push_back(points[static_cast<std::size_t>(rng.uniform_index(distinct))]);
         return points;
       }},
      {"clusters",
       [](Rng& rng, int n) {
         Vector3 center = Vector3::Zero();
         return repeat<Scalar>(n, [&](int i) {
           if (i % 37 == 0) center = random_point<Scalar>(rng, 6, 6, 6);
           return Vector3(center + random_point<Scalar>(rng, 0.02, 0.02, 0.02));
         });
       }},
      {"all equal", [](Rng&, int n) { return Points<Scalar>(static_cast<std::size_t>(n), Vector3(1, 2, 3)); }},
      {"NaN and infinity among the rest",
       [](Rng& rng, int n) {
         return repeat<Scalar>(n, [&](int i) {
           Vector3 p = random_point<Scalar>(rng, 5, 5, 5);
           if (i % 5 == 0) p[i % 3] = std::numeric_limits<Scalar>::quiet_NaN();
           if (i % 7 == 0) p[i % 3] = std::numeric_limits<Scalar>::infinity();
           return p;
         });
       }},
  };
}

template <class Scalar>
Index finite_points(const Points<Scalar>& points) {
  return static_cast<Index>(std::ranges::count_if(points, [](const auto& p) { return p.allFinite(); }));
}

/// Sums of three squares, formed in any order or fused: a few units in the last place.
template <class Scalar>
bool same_distance(Scalar a, Scalar b) {
  return std::abs(a - b) <= 8 * std::numeric_limits<Scalar>::epsilon() * std::max(a, b);
}

/// What every model of NearestNeighborSearch owes, for one query.
///
/// @param limit  the model's largest search radius, infinity if it has none.
template <class Search, class Scalar = typename Search::Scalar, int Dim = search_dimension<Search>>
void check_query(const Search& search, const BruteForce<Scalar, Dim>& reference, const SearchVector<Search>& query,
                 Index k, Scalar max_distance, Scalar limit) {
  CAPTURE(query.transpose());
  CAPTURE(k);
  CAPTURE(max_distance);
  const Neighbor<Scalar> untouched{-7, -7};
  std::vector<Neighbor<Scalar>> ours(static_cast<std::size_t>(k) + 1, untouched), theirs(static_cast<std::size_t>(k));
  const Index found = search.knn(query, std::span(ours).first(static_cast<std::size_t>(k)), max_distance);
  const Index expected = reference.knn(query, theirs, std::min(max_distance, limit));
  REQUIRE(found == expected);
  CHECK(ours[static_cast<std::size_t>(found)].index == untouched.index);  // nothing is written behind the answers
  std::set<Index> indices;
  for (std::size_t i = 0; i < static_cast<std::size_t>(found); ++i) {
    CHECK(same_distance(ours[i].squared_distance, theirs[i].squared_distance));
    CHECK((i == 0 || ours[i - 1].squared_distance <= ours[i].squared_distance));
    const SearchVector<Search> p = search.position(ours[i].index);
    CHECK(same_distance((p - query).squaredNorm(), ours[i].squared_distance));
    indices.insert(ours[i].index);
  }
  CHECK(static_cast<Index>(indices.size()) == found);

  std::vector<Neighbor<Scalar>> all{untouched}, all_theirs;
  const Scalar radius = std::min(max_distance, Scalar(3));
  search.within(query, radius, all);
  reference.within(query, std::min(radius, limit), all_theirs);
  REQUIRE(all.size() == all_theirs.size());
  const auto nearer = [](const auto& a, const auto& b) { return a.squared_distance < b.squared_distance; };
  std::ranges::sort(all, nearer);
  std::ranges::sort(all_theirs, nearer);
  for (std::size_t i = 0; i < all.size(); ++i) {
    CHECK(same_distance(all[i].squared_distance, all_theirs[i].squared_distance));
    const SearchVector<Search> p = search.position(all[i].index);
    CHECK(same_distance((p - query).squaredNorm(), all[i].squared_distance));
  }
}

/// Seeded searches and those for a fixed number answer as `knn` does, whatever the seeds.
template <class Search>
void check_other_searches(const Search& search, const SearchVector<Search>& query, typename Search::Scalar max_distance,
                          std::span<const Neighbor<typename Search::Scalar>> seeds) {
  using Scalar = typename Search::Scalar;
  constexpr int k = 5;
  std::array<Neighbor<Scalar>, k> plain, seeded;
  const Index found = search.knn(query, plain, max_distance);
  const auto check = [&](std::span<const Neighbor<Scalar>> other) {
    REQUIRE(static_cast<Index>(other.size()) == found);
    for (std::size_t i = 0; i < other.size(); ++i)
      CHECK(same_distance(other[i].squared_distance, plain[i].squared_distance));
  };
  check(search.template knn<k>(query, max_distance).found());
  const auto first = [&](Index count) { return std::span(seeded).first(static_cast<std::size_t>(count)); };
  check(first(search.knn(query, seeded, max_distance, seeds)));
  check(first(search.knn(query, seeded, max_distance, first(found))));  // from its own answer, in place
}

/// Queries of all kinds: beside the points, on them, far away; k from 0 to more than there are.
template <class Search, class Scalar = typename Search::Scalar>
void check_queries(const Search& search, const Points<Scalar>& points, Rng& rng, Scalar limit,
                   const Eigen::Matrix<Scalar, 3, 1>& origin) {
  const BruteForce<Scalar> reference(points);
  const Scalar infinity = std::numeric_limits<Scalar>::infinity();
  const auto count = static_cast<Index>(points.size());
  for (const Index k : {0, 1, 2, 5, 20, count + 3}) {
    const Eigen::Matrix<Scalar, 3, 1> beside = origin + random_point<Scalar>(rng, 6, 6, 6);
    check_query(search, reference, beside, k, infinity, limit);
    check_query(search, reference, beside, k, Scalar(rng.uniform(0, 2)), limit);
    std::array<Neighbor<Scalar>, 5> seeds;
    const Index found = search.knn(origin + random_point<Scalar>(rng, 6, 6, 6), seeds);
    check_other_searches(search, beside, k < 5 ? Scalar(3) : infinity,
                         std::span(seeds).first(static_cast<std::size_t>(found)));
    const Eigen::Matrix<Scalar, 3, 1> grid = beside.array().round();
    check_query(search, reference, grid, k, Scalar(1), limit);  // ties, and points exactly at the distance asked for
    check_query(search, reference, Eigen::Matrix<Scalar, 3, 1>(origin + random_point<Scalar>(rng, 100, 100, 100)), k,
                infinity, limit);
    if (count == 0) continue;
    const auto& on = points[static_cast<std::size_t>(rng.uniform_index(count))];
    if (!on.allFinite()) continue;
    check_query(search, reference, on, k, infinity, limit);
    check_query(search, reference, on, k, Scalar(0), limit);
  }
  std::vector<Neighbor<Scalar>> out(3);
  const Scalar nan = std::numeric_limits<Scalar>::quiet_NaN();
  CHECK(search.knn({nan, 0, 0}, out, infinity) == 0);
  CHECK(search.knn(origin, out, Scalar(-1)) == 0);
  CHECK(search.knn(origin, out, nan) == 0);
}

/// The laws of NearestNeighborSearch, against brute force, for every distribution.
///
/// @param make  `Search make(const Points<Scalar>&)`: a search that holds all points, duplicates too.
template <class Scalar, class Make>
void check_search_laws(Make&& make, Scalar limit = std::numeric_limits<Scalar>::infinity()) {
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  for (const Distribution<Scalar>& distribution : distributions<Scalar>()) {
    CAPTURE(distribution.name);
    for_all(full() ? 40 : 24, [&](Rng& rng, int size) {  // the largest has 1240 points, or 456
      const Points<Scalar> points = distribution.make(rng, 3 * size * size / 4 + size);
      const auto search = make(points);
      CHECK(search.size() == static_cast<std::size_t>(finite_points(points)));
      CHECK(search.rejected() == static_cast<Index>(points.size()) - finite_points(points));
      check_queries(search, points, rng, limit, Vector3(Vector3::Zero()));
    });
  }
  // 500 km away: float coordinates have steps of 3 cm there, which makes ties and duplicates, and must not make errors.
  for_all(20, [&](Rng& rng, int size) {
    const Vector3 origin(500'000, -500'000, 100);
    Points<Scalar> points;
    for (int i = 0; i < 10 * size; ++i) points.push_back(origin + random_point<Scalar>(rng, 5, 5, 5));
    check_queries(make(points), points, rng, limit, origin);
  });
}

}  // namespace chainslam::test
