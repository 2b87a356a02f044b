#include "chainslam/slam/submap.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "slam/street.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// Keyframes of one wall each, 0.5 m apart on a bend.
std::vector<Keyframe> bend(int count) {
  std::vector<SE3d> poses;
  for (int i = 0; i < count; ++i) poses.emplace_back(SO3d::exp({0, 0, 0.02 * i}), Eigen::Vector3d(0.5 * i, 1, 2));
  std::vector<Keyframe> keyframes = keyframes_at(poses);
  for (Keyframe& keyframe : keyframes) {
    auto cloud = std::make_shared<PointCloud<float>>();
    for (int a = -5; a <= 5; ++a)
      for (int b = -5; b <= 5; ++b)
        cloud->positions.push_back(
            (keyframe.T_map_body.inverse() * Eigen::Vector3d(0.5 * a, 8.2, 0.5 * b)).cast<float>());
    keyframe.cloud = cloud;
  }
  return keyframes;
}

}  // namespace

TEST_SUITE("map/submap") {
  TEST_CASE("a range reaches to both sides, to the ends, and never into another session") {
    std::vector<Keyframe> keyframes = keyframes_at(std::vector<SE3d>(100));
    for (std::size_t i = 40; i < 60; ++i) keyframes[i].session = SessionId{1};
    for (std::size_t i = 60; i < 100; ++i) keyframes[i].session = SessionId{2};
    CHECK(submap_range(keyframes, KeyframeId{20}, 5) == SubmapRange{15, 26});
    CHECK(submap_range(keyframes, KeyframeId{2}, 5) == SubmapRange{0, 8});
    CHECK(submap_range(keyframes, KeyframeId{38}, 5) == SubmapRange{33, 40});
    CHECK(submap_range(keyframes, KeyframeId{40}, 5) == SubmapRange{40, 46});
    CHECK(submap_range(keyframes, KeyframeId{50}, 20) == SubmapRange{40, 60});
    CHECK(submap_range(keyframes, KeyframeId{99}, 5) == SubmapRange{94, 100});
    CHECK(submap_range(keyframes, KeyframeId{70}, 0) == SubmapRange{70, 71});
  }

  TEST_CASE("a range ends where the path from the centre is longer than it may be") {
    std::vector<SE3d> poses;
    for (int i = 0; i < 30; ++i) poses.emplace_back(SO3d(), Eigen::Vector3d(i < 20 ? 2 * i : 40 + 7 * (i - 20), 0, 0));
    const std::vector<Keyframe> keyframes = keyframes_at(poses);
    CHECK(submap_range(keyframes, KeyframeId{10}, 8, 6.5) == SubmapRange{7, 14});
    CHECK(submap_range(keyframes, KeyframeId{10}, 8, 6) == SubmapRange{7, 14});
    CHECK(submap_range(keyframes, KeyframeId{10}, 2, 6) == SubmapRange{8, 13});
    CHECK(submap_range(keyframes, KeyframeId{25}, 8, 15) == SubmapRange{23, 28});
    CHECK(submap_range(keyframes, KeyframeId{25}, 8, 6) == SubmapRange{25, 26});
    CHECK(submap_range(keyframes, KeyframeId{1}, 8, 100) == submap_range(keyframes, KeyframeId{1}, 8));
    CHECK(submap_range(keyframes, KeyframeId{10}, 8, 0) == SubmapRange{2, 19});
  }

  TEST_CASE("scans are placed by their optimized poses and seen from the centre") {
    std::vector<SE3d> poses{SE3d(SO3d::exp({0.1, 0.2, 1.0}), {10, -5, 2}),
                            SE3d(SO3d::exp({-0.3, 0, -2.0}), {12, 3, 1})};
    std::vector<Keyframe> keyframes = keyframes_at(poses);
    for (Keyframe& keyframe : keyframes) keyframe.T_odom_body = SE3d();  // must not matter
    const Eigen::Vector3d seen_by_0(14, 2, 3), seen_by_1(9, 8, -1);      // in the map
    const auto cloud_of = [](const SE3d& pose, const Eigen::Vector3d& p_map) {
      auto cloud = std::make_shared<PointCloud<float>>();
      cloud->positions = {(pose.inverse() * p_map).cast<float>()};
      return cloud;
    };
    keyframes[0].cloud = cloud_of(poses[0], seen_by_0);
    keyframes[1].cloud = cloud_of(poses[1], seen_by_1);
    const PointCloud<float> submap = assemble_submap(keyframes, KeyframeId{1}, {0, 2}, 0.1);
    REQUIRE(submap.size() == 2);
    CHECK((submap.positions[0].cast<double>() - poses[1].inverse() * seen_by_0).norm() < 1e-5);
    CHECK((submap.positions[1].cast<double>() - poses[1].inverse() * seen_by_1).norm() < 1e-5);
    keyframes[0].cloud = nullptr;  // not loaded
    CHECK(assemble_submap(keyframes, KeyframeId{1}, {0, 2}, 0.1).size() == 1);
  }
}

TEST_SUITE("slam/submap_cache") {
  TEST_CASE("a submap has unit normals that face the centre") {
    const std::vector<Keyframe> keyframes = bend(12);
    SubmapCache cache({.radius = 3, .fragment = 1});
    const auto submap = cache.get(keyframes, KeyframeId{5}).submap;
    REQUIRE(submap->size() > 100);
    const Eigen::Vector3d wall = keyframes[5].T_map_body.rotation().inverse() * Eigen::Vector3d(0, -1, 0);
    Index right = 0;
    for (Index i = 0; i < to_index(submap->size()); ++i)
      right += submap->normal(i).cast<double>().dot(wall) > 0.99 ? 1 : 0;
    CHECK(right == to_index(submap->size()));
  }

  TEST_CASE("known submaps are kept; moving all keyframes alike costs nothing, bending them does") {
    std::vector<Keyframe> keyframes = bend(30);
    SubmapCache cache({.radius = 3, .fragment = 1});
    const auto first = cache.get(keyframes, KeyframeId{10}).submap;
    CHECK(cache.get(keyframes, KeyframeId{10}).submap == first);
    CHECK(cache.built() == 1);
    const SE3d correction(SO3d::exp({0.01, -0.02, 0.5}), {3, -4, 1});
    for (Keyframe& keyframe : keyframes) keyframe.T_map_body = correction * keyframe.T_map_body;
    CHECK(cache.get(keyframes, KeyframeId{10}).submap == first);
    keyframes[14].T_map_body = keyframes[14].T_map_body * SE3d(SO3d(), {1, 0, 0});  // outside of [7, 13]
    CHECK(cache.get(keyframes, KeyframeId{10}).submap == first);
    keyframes[13].T_map_body = keyframes[13].T_map_body * SE3d(SO3d(), {0.07, 0, 0});
    CHECK(cache.get(keyframes, KeyframeId{10}).submap == first);
    keyframes[13].T_map_body = keyframes[13].T_map_body * SE3d(SO3d(), {0.02, 0, 0});  // a fifth of a voxel in all
    CHECK(cache.get(keyframes, KeyframeId{10}).submap != first);
    CHECK(cache.built() == 2);
    CHECK(cache.size() == 1);
  }

  TEST_CASE("a submap at the end of the drive grows with it") {
    std::vector<Keyframe> keyframes = bend(30);
    SubmapCache cache({.radius = 3, .fragment = 1});
    const std::span<const Keyframe> all(keyframes);
    const auto at_end = cache.get(all.first(12), KeyframeId{10}).submap;
    CHECK(cache.get(all.first(12), KeyframeId{10}).submap == at_end);
    CHECK(cache.get(all.first(14), KeyframeId{10}).submap != at_end);
  }

  TEST_CASE("the least recently used go when the bytes are spent, and stay alive with whoever holds them") {
    const std::vector<Keyframe> keyframes = bend(40);
    SubmapCache probe({.radius = 2, .fragment = 1});
    static_cast<void>(probe.get(keyframes, KeyframeId{20}));
    SubmapCache cache({.radius = 2, .fragment = 1, .max_bytes = probe.bytes() * 5 / 2});
    const auto held = cache.get(keyframes, KeyframeId{10}).submap;
    const std::size_t points = held->size();
    static_cast<void>(cache.get(keyframes, KeyframeId{20}).submap);
    CHECK(cache.get(keyframes, KeyframeId{10}).submap == held);      // used again: now 20 is the oldest
    static_cast<void>(cache.get(keyframes, KeyframeId{30}).submap);  // 20 goes
    CHECK(cache.size() == 2);
    CHECK(cache.get(keyframes, KeyframeId{10}).submap == held);
    CHECK(cache.built() == 3);
    static_cast<void>(cache.get(keyframes, KeyframeId{20}).submap);
    CHECK(cache.built() == 4);
    CHECK(held->size() == points);
    CHECK(cache.bytes() <= probe.bytes() * 5 / 2);
  }

  TEST_CASE("fragments that were let go are made again, the same to the bit") {
    const std::vector<Keyframe> keyframes = bend(60);
    SubmapCache roomy({.radius = 4, .fragment = 5}), tight({.radius = 4, .fragment = 5, .max_bytes = 1});
    for (const Index id : {10, 40, 12}) {
      CAPTURE(id);
      const auto expected = roomy.get(keyframes, KeyframeId{id}).submap,
                 again = tight.get(keyframes, KeyframeId{id}).submap;
      CHECK(again->cloud().positions == expected->cloud().positions);
      CHECK(again->cloud().normals == expected->cloud().normals);
    }
    CHECK(roomy.fragments_built() == 6);
    CHECK(tight.fragments_built() == 9);
    CHECK(tight.bytes() > 0);  // the newest stays, however large
  }

  TEST_CASE("keyframes of one fragment share a submap, which lies where each one's own does") {
    const std::vector<Keyframe> keyframes = bend(40);
    SubmapCache shared({.radius = 4, .fragment = 5}), own({.radius = 8, .fragment = 1});
    const PlacedSubmap submap = shared.get(keyframes, KeyframeId{12});
    for (const Index id : {10, 11, 13, 14}) CHECK(shared.get(keyframes, KeyframeId{id}).submap == submap.submap);
    CHECK(shared.get(keyframes, KeyframeId{15}).submap != submap.submap);
    CHECK(shared.built() == 2);
    for (const Index id : {10, 14}) {
      CAPTURE(id);
      const PlacedSubmap placed = shared.get(keyframes, KeyframeId{id});
      const auto expected = own.get(keyframes, KeyframeId{id}).submap;
      Index near = 0, parallel = 0;
      for (Index i = 0; i < to_index(placed.submap->size()); ++i) {
        const Eigen::Vector3f p =
            (placed.T_keyframe_submap * placed.submap->position(i).cast<double>().eval()).cast<float>();
        Neighbor<float> nearest;
        if (expected->knn(p, std::span(&nearest, 1), 0.4f) == 0) continue;
        ++near;
        const Eigen::Vector3d n = placed.T_keyframe_submap.rotation() * placed.submap->normal(i).cast<double>().eval();
        parallel += n.dot(expected->normal(nearest.index).cast<double>()) > 0.99 ? 1 : 0;
      }
      CHECK(near == to_index(placed.submap->size()));
      CHECK(parallel == near);
    }
  }

  TEST_CASE(
      "a submap of fragments holds as many keyframes on each side of any of its own as it is to, and no other "
      "session") {
    std::vector<Keyframe> keyframes = bend(40);
    for (std::size_t i = 0; i < keyframes.size(); ++i) {  // each keyframe's point says which one it is
      auto cloud = std::make_shared<PointCloud<float>>();
      cloud->positions.push_back(
          (keyframes[i].T_map_body.inverse() * Eigen::Vector3d(2.0 * static_cast<double>(i), 0, 0)).cast<float>());
      keyframes[i].cloud = cloud;
      if (i >= 23) keyframes[i].session = SessionId{1};
    }
    SubmapCache cache({.radius = 4, .fragment = 5});
    const auto seen = [&](Index id) {
      const PlacedSubmap placed = cache.get(keyframes, KeyframeId{id});
      std::vector<Index> found;
      for (const Eigen::Vector3f& p : placed.submap->cloud().positions) {
        const SE3d& T_map_body = keyframes[static_cast<std::size_t>(id)].T_map_body;
        const Eigen::Vector3d p_map = T_map_body * (placed.T_keyframe_submap * p.cast<double>().eval());
        found.push_back(static_cast<Index>(std::lround(p_map.x() / 2)));
      }
      std::ranges::sort(found);
      return std::pair(found.front(), found.back());
    };
    CHECK(seen(10) == std::pair(5, 19));  // 12, the middle, and four on each side, in whole fragments
    CHECK(seen(14) == std::pair(5, 19));
    CHECK(seen(2) == std::pair(0, 9));
    CHECK(seen(21) == std::pair(15, 22));
    CHECK(seen(23) == std::pair(23, 29));
    CHECK(seen(38) == std::pair(30, 39));
  }

  TEST_CASE("a correction that bends a session between fragments moves them as they are") {
    std::vector<Keyframe> keyframes = bend(40);
    SubmapCache cache({.radius = 4, .fragment = 5});
    const auto before = cache.get(keyframes, KeyframeId{12}).submap;
    CHECK(cache.fragments_built() == 3);
    const SE3d turn(SO3d::exp({0, 0, 0.02}), {0, 0.3, 0});
    for (std::size_t i = 15; i < keyframes.size(); ++i) keyframes[i].T_map_body = turn * keyframes[i].T_map_body;
    CHECK(cache.get(keyframes, KeyframeId{12}).submap != before);
    CHECK(cache.fragments_built() == 3);
    for (std::size_t i = 17; i < keyframes.size(); ++i) keyframes[i].T_map_body = turn * keyframes[i].T_map_body;
    static_cast<void>(cache.get(keyframes, KeyframeId{12}));
    CHECK(cache.fragments_built() == 4);  // the one that was bent itself
  }

  TEST_CASE("a submap reaches no farther along the path than it may") {
    const std::vector<Keyframe> keyframes = bend(200);  // 0.5 m apart
    SubmapCache near({.radius = 60, .max_length = 5, .fragment = 5}),
        far({.radius = 60, .max_length = 0, .fragment = 5});
    static_cast<void>(near.get(keyframes, KeyframeId{100}));
    static_cast<void>(far.get(keyframes, KeyframeId{100}));
    CHECK(near.fragments_built() == 5);  // 10 keyframes on each side of 102
    CHECK(far.fragments_built() == 25);
  }

  TEST_CASE("by default five keyframes share a submap, which ends after ten keyframes or 100 m along the path") {
    for (const auto& [apart, reached] : {std::pair(3.0, 25), std::pair(20.0, 15)}) {  // in whole fragments
      std::vector<SE3d> poses;
      for (int i = 0; i < 60; ++i) poses.emplace_back(SO3d(), Eigen::Vector3d(apart * i, 0, 0));
      std::vector<Keyframe> keyframes = keyframes_at(poses);
      for (Keyframe& keyframe : keyframes) {
        auto cloud = std::make_shared<PointCloud<float>>();
        cloud->positions = {{0, 5, 0}, {1, 5, 0}, {0, 5, 1}};
        keyframe.cloud = cloud;
      }
      SubmapCache cache;
      for (Index id = 0; id < 60; ++id) static_cast<void>(cache.get(keyframes, KeyframeId{id}));
      CHECK(cache.built() == 12);
      CHECK(cache.fragments_built() == 12);
      CHECK(cache.get(keyframes, KeyframeId{32}).submap->size() == 3 * static_cast<std::size_t>(reached));
    }
  }

  TEST_CASE("the most that is kept counts fragments, too") {
    const std::vector<Keyframe> keyframes = bend(200);
    SubmapCache all({.radius = 4, .fragment = 5});
    for (Index id = 0; id < 200; id += 5) static_cast<void>(all.get(keyframes, KeyframeId{id}));
    SubmapCache few({.radius = 4, .fragment = 5, .max_bytes = all.bytes() / 12});
    for (Index id = 0; id < 200; id += 5) {
      static_cast<void>(few.get(keyframes, KeyframeId{id}));
      REQUIRE(few.bytes() <= all.bytes() / 12);
    }
    CHECK(all.fragments_built() == 40);
    CHECK(few.fragments_built() == 40);  // those next to each other are still there
    static_cast<void>(few.get(keyframes, KeyframeId{0}));
    CHECK(few.fragments_built() == 42);
  }
}
