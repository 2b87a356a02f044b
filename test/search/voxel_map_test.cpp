#include "chainslam/search/voxel_map.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <map>
#include <tuple>
#include <vector>

#include "search/search_laws.hpp"

namespace chainslam {
namespace {

static_assert(IncrementalSearch<VoxelMap<double, NearestToCenter, 2>>);

using test::check_queries;
using test::for_all;
using test::Points;

/// The map's rules, carried out the plain way.
struct PlainMap {
  VoxelMapOptions options;
  Points<float> points;

  [[nodiscard]] auto voxel(const Eigen::Vector3f& p) const {
    const auto cell = [&](float v) {
      return std::floor(static_cast<double>(v) * (1.0 / (options.voxel_size * 4)) * 4);
    };
    return std::tuple(cell(p[0]), cell(p[1]), cell(p[2]));
  }

  void insert(const Eigen::Vector3f& p) {
    const auto spacing = static_cast<float>(options.min_spacing);
    Index in_voxel = 0;
    for (const Eigen::Vector3f& q : points) {
      if (voxel(p) == voxel(q)) ++in_voxel;
      if ((p - q).squaredNorm() < spacing * spacing) return;
    }
    if (in_voxel < options.max_points_per_voxel) points.push_back(p);
  }
};

Points<float> sorted(Points<float> points) {
  std::ranges::sort(
      points, [](const auto& a, const auto& b) { return std::tuple(a[0], a[1], a[2]) < std::tuple(b[0], b[1], b[2]); });
  return points;
}

Points<float> points_of(const VoxelMap<>& map) {
  Points<float> points;
  map.for_each_point([&](Index i, const Eigen::Vector3f& p) {
    CHECK(map.position(i) == p);
    points.push_back(p);
  });
  CHECK(points.size() == map.size());
  return points;
}

Points<float> random_cloud(Rng& rng, int count, const Eigen::Vector3f& origin, double extent = 4) {
  Points<float> points;
  for (int i = 0; i < count; ++i) points.push_back(origin + test::random_point<float>(rng, extent, extent, extent / 4));
  return points;
}

TEST_SUITE("search/voxel_map") {
  TEST_CASE("keeps exactly the points its rules keep") {
    for (const VoxelMapOptions& options :
         {VoxelMapOptions{.voxel_size = 1.0, .max_points_per_voxel = 3, .min_spacing = 0.3},
          VoxelMapOptions{.voxel_size = 0.5, .max_points_per_voxel = 1, .min_spacing = 0},
          VoxelMapOptions{.voxel_size = 0.25, .max_points_per_voxel = 20, .min_spacing = 0.7},
          VoxelMapOptions{.voxel_size = 2.0, .max_points_per_voxel = 20, .min_spacing = 0.1}}) {
      for_all(30, [&](Rng& rng, int size) {
        PlainMap plain{options, {}};
        VoxelMap<> map(options);
        for (const Eigen::Vector3f& p : random_cloud(rng, 8 * size, {-3, 2, 0})) {
          const std::size_t before = plain.points.size();
          plain.insert(p);
          CHECK(map.insert(p) == (plain.points.size() > before));
        }
        CHECK(sorted(points_of(map)) == sorted(plain.points));
      });
    }
  }

  TEST_CASE(
      "inserts, box erasures and ball erasures in any order: always the points that should be left, exactly found") {
    const VoxelMapOptions options{.voxel_size = 0.5, .max_points_per_voxel = 9, .min_spacing = 0.05, .reach = 1};
    for_all(60, [&](Rng& rng, int size) {
      PlainMap plain{options, {}};
      VoxelMap<> map(options);
      Eigen::Vector3f body = Eigen::Vector3f::Zero();
      for (int step = 0; step < 12; ++step) {
        body += test::random_point<float>(rng, 3, 3, 0.5);
        const Points<float> scan = random_cloud(rng, 3 * size, body);
        for (const Eigen::Vector3f& p : scan) plain.insert(p);
        map.insert(scan);
        const std::size_t before = plain.points.size();
        Index erased = 0;
        if (rng.uniform() < 0.5) {
          const float radius = static_cast<float>(rng.uniform(1, 6));
          std::erase_if(plain.points, [&](const auto& p) { return (p - body).squaredNorm() > radius * radius; });
          erased = map.erase_farther_than(body, radius);
        } else {
          const Eigen::Vector3f half = test::random_point<float>(rng, 5, 5, 5).cwiseAbs();
          const Eigen::AlignedBox3f box(body - half, body + half);
          std::erase_if(plain.points, [&](const auto& p) { return !box.contains(p); });
          erased = map.erase_outside(box);
        }
        CHECK(erased == static_cast<Index>(before - plain.points.size()));
        REQUIRE(sorted(points_of(map)) == sorted(plain.points));
      }
      check_queries(map, plain.points, rng, map.max_search_radius(), body);
    });
  }

  TEST_CASE("a moving local map stays bounded: erased room is used again") {
    VoxelMap<> map({.voxel_size = 0.5, .max_points_per_voxel = 4, .min_spacing = 0});
    Rng rng(5);
    std::size_t memory_at_start = 0;
    for (int step = 0; step < 400; ++step) {
      const Eigen::Vector3f body(static_cast<float>(step), 0, 0);
      map.insert(random_cloud(rng, 300, body, 8));
      map.erase_farther_than(body, 10);
      if (step == 100) memory_at_start = map.memory();
    }
    CHECK(map.memory() <= memory_at_start * 3 / 2);
  }

  TEST_CASE("positions keep their indices while points are inserted") {
    VoxelMap<> map({.voxel_size = 0.5, .max_points_per_voxel = 50, .min_spacing = 0});
    Rng rng(8);
    map.insert(random_cloud(rng, 500, {0, 0, 0}));
    std::map<Index, Eigen::Vector3f> before;
    map.for_each_point([&](Index i, const Eigen::Vector3f& p) { before[i] = p; });
    map.insert(random_cloud(rng, 5000, {0, 0, 0}));
    for (const auto& entry : before) CHECK(map.position(entry.first) == entry.second);
  }

  TEST_CASE("the same history gives the same order and the same answers") {
    const auto build = [] {
      VoxelMap<> map({.voxel_size = 0.5, .max_points_per_voxel = 4, .min_spacing = 0.1});
      Rng rng(9);
      for (int step = 0; step < 20; ++step) {
        map.insert(random_cloud(rng, 200, {static_cast<float>(step), 0, 0}));
        map.erase_farther_than({static_cast<float>(step), 0, 0}, 5);
      }
      return map;
    };
    CHECK(points_of(build()) == points_of(build()));
  }

  TEST_CASE("points on voxel and block faces are found from both sides, near the origin and far from it") {
    for (const float away : {0.0f, -64.0f, 4096.0f, 500'000.0f}) {
      VoxelMap<> map({.voxel_size = 0.5, .max_points_per_voxel = 100, .min_spacing = 0});
      Points<float> points;
      for (int x = -4; x <= 4; ++x)
        for (int y = -4; y <= 4; ++y)
          points.emplace_back(away + 0.5f * static_cast<float>(x), 0.5f * static_cast<float>(y), 0);
      map.insert(points);
      Rng rng(1);
      check_queries(map, points, rng, map.max_search_radius(), {away, 0, 0});
    }
  }

  TEST_CASE("NaN, infinite and out_of_range points are refused and counted") {
    const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
    VoxelMap<> map;
    map.insert(Points<float>{{nan, 0, 0}, {0, inf, 0}, {0, 0, -inf}, {1e30f, 0, 0}, {1, 2, 3}});
    CHECK(map.rejected() == 4);
    CHECK(map.size() == 1);
  }

  TEST_CASE("clear empties; erasing from nothing erases nothing; an empty box erases all") {
    VoxelMap<> map;
    CHECK(map.erase_farther_than({0, 0, 0}, 1) == 0);
    map.insert(Points<float>{{1, 2, 3}, {50, 2, 3}});
    CHECK(map.erase_outside({}) == 2);
    CHECK(map.size() == 0);
    map.insert(Points<float>{{1, 2, 3}});
    map.clear();
    CHECK(map.size() == 0);
    CHECK(map.insert({1, 2, 3}));
  }

  TEST_CASE("options that mean nothing are refused") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    CHECK_THROWS_AS(VoxelMap<>({.voxel_size = 0}), std::invalid_argument);
    CHECK_THROWS_AS(VoxelMap<>({.voxel_size = nan}), std::invalid_argument);
    CHECK_THROWS_AS(VoxelMap<>({.max_points_per_voxel = 0}), std::invalid_argument);
    CHECK_THROWS_AS(VoxelMap<>({.min_spacing = -1}), std::invalid_argument);
    CHECK_THROWS_AS(VoxelMap<>({.voxel_size = 0.1, .min_spacing = 1}), std::invalid_argument);
    CHECK_THROWS_AS(VoxelMap<>({.reach = 0}), std::invalid_argument);
    CHECK_THROWS_AS(VoxelMap<>({.reach = 9}), std::invalid_argument);
  }
}

}  // namespace
}  // namespace chainslam
