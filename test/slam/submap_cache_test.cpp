#include "chainslam/slam/submap_cache.hpp"

#include <doctest/doctest.h>

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

  TEST_CASE("scans are placed by their optimised poses and seen from the centre") {
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
    SubmapCache cache({.radius = 3});
    const auto submap = cache.get(keyframes, KeyframeId{5});
    REQUIRE(submap->size() > 100);
    const Eigen::Vector3d wall = keyframes[5].T_map_body.rotation().inverse() * Eigen::Vector3d(0, -1, 0);
    Index right = 0;
    for (Index i = 0; i < to_index(submap->size()); ++i)
      right += submap->normal(i).cast<double>().dot(wall) > 0.99 ? 1 : 0;
    CHECK(right == to_index(submap->size()));
  }

  TEST_CASE("known submaps are kept; moving all keyframes alike costs nothing, bending them does") {
    std::vector<Keyframe> keyframes = bend(30);
    SubmapCache cache({.radius = 3});
    const auto first = cache.get(keyframes, KeyframeId{10});
    CHECK(cache.get(keyframes, KeyframeId{10}) == first);
    CHECK(cache.built() == 1);
    const SE3d correction(SO3d::exp({0.01, -0.02, 0.5}), {3, -4, 1});
    for (Keyframe& keyframe : keyframes) keyframe.T_map_body = correction * keyframe.T_map_body;
    CHECK(cache.get(keyframes, KeyframeId{10}) == first);
    keyframes[14].T_map_body = keyframes[14].T_map_body * SE3d(SO3d(), {1, 0, 0});  // outside of [7, 13]
    CHECK(cache.get(keyframes, KeyframeId{10}) == first);
    keyframes[13].T_map_body = keyframes[13].T_map_body * SE3d(SO3d(), {0.05, 0, 0});
    CHECK(cache.get(keyframes, KeyframeId{10}) != first);
    CHECK(cache.built() == 2);
    CHECK(cache.size() == 1);
  }

  TEST_CASE("a submap at the end of the drive grows with it") {
    std::vector<Keyframe> keyframes = bend(30);
    SubmapCache cache({.radius = 3});
    const std::span<const Keyframe> all(keyframes);
    const auto at_end = cache.get(all.first(12), KeyframeId{10});
    CHECK(cache.get(all.first(12), KeyframeId{10}) == at_end);
    CHECK(cache.get(all.first(14), KeyframeId{10}) != at_end);
  }

  TEST_CASE("the least recently used go when the bytes are spent, and stay alive with whoever holds them") {
    const std::vector<Keyframe> keyframes = bend(40);
    SubmapCache probe({.radius = 2});
    static_cast<void>(probe.get(keyframes, KeyframeId{20}));
    SubmapCache cache({.radius = 2, .max_bytes = probe.bytes() * 5 / 2});
    const auto held = cache.get(keyframes, KeyframeId{10});
    const std::size_t points = held->size();
    static_cast<void>(cache.get(keyframes, KeyframeId{20}));
    CHECK(cache.get(keyframes, KeyframeId{10}) == held);      // used again: now 20 is the oldest
    static_cast<void>(cache.get(keyframes, KeyframeId{30}));  // 20 goes
    CHECK(cache.size() == 2);
    CHECK(cache.get(keyframes, KeyframeId{10}) == held);
    CHECK(cache.built() == 3);
    static_cast<void>(cache.get(keyframes, KeyframeId{20}));
    CHECK(cache.built() == 4);
    CHECK(held->size() == points);
    CHECK(cache.bytes() <= probe.bytes() * 5 / 2);
  }
}
