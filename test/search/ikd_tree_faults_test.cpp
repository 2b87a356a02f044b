#include <doctest/doctest.h>

#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <set>
#include <thread>
#include <tuple>
#include <vector>

#include "chainslam/core/channel.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "search/search_laws.hpp"

namespace chainslam {
namespace {

using test::for_all;
using test::Points;
using Tree = IkdTree<float>;
using Map = IkdTree<float, NearestToCenter>;
using Box = Eigen::AlignedBox3f;
using test::unlimited;

Points<float> random_cloud(Rng& rng, int count, float extent, const Eigen::Vector3f& origin = Eigen::Vector3f::Zero()) {
  Points<float> points;
  for (int i = 0; i < count; ++i) points.push_back(origin + test::random_point<float>(rng, extent, extent, extent));
  return points;
}

template <class Search>
std::vector<std::array<float, 3>> sorted_points(const Search& search) {
  std::vector<std::array<float, 3>> points;
  search.for_each_point([&](Index, const Eigen::Vector3f& p) { points.push_back({p[0], p[1], p[2]}); });
  std::ranges::sort(points);
  return points;
}

/// The ways in which ikd-Tree c0e36a1 crashes or answers wrongly.
TEST_SUITE("search/ikd_tree: what its forerunner gets wrong") {
  TEST_CASE("C1, C2: adding to a tree never built, or built of nothing") {
    Tree tree;
    CHECK(tree.insert(Eigen::Vector3f(1, 2, 3)));
    tree.build(Points<float>{});
    CHECK(tree.size() == 0);
    CHECK(tree.insert(Points<float>{{0, 0, 0}, {1, 0, 0}}) == 2);
    std::array<Neighbor<float>, 3> out;
    CHECK(tree.knn({0.9f, 0, 0}, out) == 2);
  }

  TEST_CASE("C3, C4: deleting everything by two half spaces, then adding again") {
    for (const int count : {1000, 20'000}) {
      Rng rng(1);
      const Points<float> points = random_cloud(rng, count, 10);
      Tree tree(points);
      CHECK(tree.erase_inside(Box(Eigen::Vector3f(-20, -20, -20), Eigen::Vector3f(0, 20, 20))) > 0);
      tree.erase_inside(Box(Eigen::Vector3f(0, -20, -20), Eigen::Vector3f(20, 20, 20)));
      CHECK(tree.size() == 0);
      CHECK(tree.bounding_box().isEmpty());
      CHECK(tree.insert(points) == count);
      CHECK(tree.size() == points.size());
    }
  }

  TEST_CASE("C5, C6, C7: deleting by point finds all ties and all duplicates") {
    Points<float> grid;
    for (int i = 0; i < 864; ++i)
      grid.emplace_back(static_cast<float>(i % 12), static_cast<float>(i / 12 % 12), static_cast<float>(i / 144));
    for (const bool at_once : {true, false}) {
      Tree tree;
      at_once ? tree.build(grid) : static_cast<void>(tree.insert(grid));
      tree.insert(Points<float>(20, Eigen::Vector3f(3, 3, 3)));
      for (const auto& p : grid) CHECK(tree.erase_point(p) == (p == Eigen::Vector3f(3, 3, 3) ? 21 : 1));
      CHECK(tree.size() == 0);
    }
  }

  TEST_CASE("C8, C9: NaN and infinite points are refused and counted, and spoil nothing") {
    Rng rng(2);
    Points<float> points = random_cloud(rng, 5000, 10);
    const BruteForce<float> reference(points);
    for (std::size_t i = 0; i < 100; ++i)
      points.insert(points.begin() + static_cast<std::ptrdiff_t>(49 * i), {NAN, 0, INFINITY});
    Tree tree(points);
    Map map;
    map.insert(points);
    CHECK(tree.rejected() == 100);
    CHECK(map.rejected() == 100);
    CHECK(tree.size() == 5000);
    for (int i = 0; i < 50; ++i)
      test::check_query(tree, reference, test::random_point<float>(rng, 12, 12, 12), 5, unlimited, unlimited);
    CHECK_FALSE(map.insert(Eigen::Vector3f(1e30f, 0, 0)));  // farther than voxels are counted
    CHECK(map.rejected() == 101);
  }

  TEST_CASE("C11, C15: k beyond n, and a query at the origin") {
    Rng rng(3);
    const Points<float> points = random_cloud(rng, 7, 1);
    const Tree tree(points);
    test::check_query(tree, BruteForce<float>(points), Eigen::Vector3f(0, 0, 0), 20, unlimited, unlimited);
  }

  TEST_CASE("C12: one point a voxel, also 500 km from the origin") {
    for (const float away : {0.0f, 1000.0f, 20'000.0f, 500'000.0f}) {
      CAPTURE(away);
      Rng rng(4);
      const Points<float> points = random_cloud(rng, 50'000, 10, Eigen::Vector3f(away, -away, 0));
      Map map(NearestToCenter{.voxel_size = 0.3});
      map.insert(points);
      const auto cell = [](const Eigen::Vector3f& p) {
        const auto whole = [](float v) {
          return static_cast<std::int64_t>(std::floor(static_cast<double>(v) * (1 / 0.3)));
        };
        return std::tuple(whole(p[0]), whole(p[1]), whole(p[2]));
      };
      std::set<std::tuple<std::int64_t, std::int64_t, std::int64_t>> offered, kept;
      for (const auto& p : points) offered.insert(cell(p));
      map.for_each_point([&](Index, const Eigen::Vector3f& p) { CHECK(kept.insert(cell(p)).second); });
      CHECK(kept == offered);
    }
  }

  TEST_CASE("C13: readers of a snapshot while a writer goes on") {
    Snapshot<Map> shared(std::make_shared<const Map>());
    std::atomic<bool> done = false;
    std::atomic<int> found = 0;
    const auto read = [&] {
      Rng rng(6);
      while (!done) {
        const auto map = shared.load();
        const auto nearest = map->knn<5>(test::random_point<float>(rng, 10, 10, 10));
        for (const Neighbor<float>& n : nearest.found())
          if (map->contains(n.index) && std::isfinite(map->position(n.index)[0])) ++found;
      }
    };
    std::thread first(read), second(read);
    Rng rng(5);
    Map own;
    for (int step = 0; step < 60; ++step) {
      own.insert(random_cloud(rng, 500, 10));
      own.erase_inside(Box(test::random_point<float>(rng, 10, 10, 10), Eigen::Vector3f(10, 10, 10)));
      shared.store(std::make_shared<const Map>(own));
    }
    done = true;
    first.join();
    second.join();
    CHECK(shared.load()->size() == own.size());
  }

  TEST_CASE("C14: a tree fits on the stack") {
    static_assert(sizeof(Tree) < 1024 && sizeof(Map) < 1024);
    const Tree tree;
    CHECK(tree.size() == 0);
  }

  TEST_CASE("C10, C16: the count stays that of the points through 300 scans") {
    Rng rng(7);
    Map map;
    for (int scan = 0; scan < 300; ++scan) {
      const Eigen::Vector3f eye(static_cast<float>(scan), 0, 0);
      map.insert(random_cloud(rng, 200, 8, eye));
      if (scan % 10 == 9) map.erase_outside(Box(eye.array() - 20, eye.array() + 20));
      std::size_t count = 0;
      map.for_each_point([&](Index, const Eigen::Vector3f&) { ++count; });
      REQUIRE(count == map.size());
    }
  }
}

TEST_SUITE("search/ikd_tree: saving") {
  TEST_CASE("what is saved comes back: points, payloads, counts, and how means go on") {
    for_all(20, [](Rng& rng, int size) {
      IkdTree<float, MeanOfVoxel, 3, std::uint16_t> map(MeanOfVoxel{.voxel_size = 0.7});
      for (const auto& p : random_cloud(rng, 40 * size, 3))
        map.insert(p, static_cast<std::uint16_t>(rng.uniform_index(60'000)));
      map.insert(Eigen::Vector3f(NAN, 0, 0));
      auto loaded = decltype(map)::load(map.save(), map.downsampling());
      CHECK(sorted_points(loaded) == sorted_points(map));
      CHECK(loaded.rejected() == map.rejected());
      std::set<int> payloads, payloads_loaded;
      map.for_each_point([&](Index i, const Eigen::Vector3f&) { payloads.insert(map.payload(i)); });
      loaded.for_each_point([&](Index i, const Eigen::Vector3f&) { payloads_loaded.insert(loaded.payload(i)); });
      CHECK(payloads == payloads_loaded);
      const Points<float> more = random_cloud(rng, 100, 3);
      CHECK(loaded.insert(more) == map.insert(more));
      CHECK(sorted_points(loaded) == sorted_points(map));
    });
    CHECK(Tree::load(Tree().save()).size() == 0);
  }

  TEST_CASE("bytes cut off or changed are refused with a message, and never crash") {
    Rng rng(8);
    Map map;
    map.insert(random_cloud(rng, 60, 5));
    const std::vector<std::byte> bytes = map.save();
    for (std::size_t length = 0; length < bytes.size(); ++length)
      CHECK_THROWS_AS(static_cast<void>(Map::load(std::span(bytes).first(length))), IoError);
    for (std::size_t i = 0; i < bytes.size(); ++i)
      for (const int bit : {0, 3, 7}) {
        std::vector<std::byte> changed = bytes;
        changed[i] ^= std::byte{1} << bit;
        CHECK_THROWS_AS(static_cast<void>(Map::load(changed)), IoError);
      }
    for (int i = 0; i < 200; ++i) {
      std::vector<std::byte> garbage(static_cast<std::size_t>(rng.uniform_index(200)));
      for (std::byte& b : garbage) b = static_cast<std::byte>(rng.uniform_index(256));
      CHECK_THROWS_AS(static_cast<void>(Map::load(garbage)), IoError);
    }
  }

  TEST_CASE("bytes that check but cannot be a tree of this kind are refused") {
    Rng rng(9);
    Tree all;
    all.insert(random_cloud(rng, 60, 1));
    CHECK_THROWS_AS(static_cast<void>(IkdTree<double>::load(all.save())), IoError);
    CHECK_THROWS_AS(static_cast<void>(Map::load(all.save())), IoError);
    Map fine(NearestToCenter{.voxel_size = 0.1});
    fine.insert(random_cloud(rng, 300, 1));
    CHECK_THROWS_AS(static_cast<void>(Map::load(fine.save())), IoError);
    // The same points under a header that claims voxels in which they cannot all be.
    std::vector<std::byte> forged = fine.save();
    const std::vector<std::byte> honest = Map().save();
    std::copy_n(honest.begin() + 24, 8, forged.begin() + 24);
    seal(forged, detail::tree_check_at);
    CHECK_THROWS_WITH_AS(static_cast<void>(Map::load(forged)), doctest::Contains("a point against the voxels"),
                         IoError);
  }
}

}  // namespace
}  // namespace chainslam
