#include "chainslam/slam/slam_map.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <memory>
#include <vector>

#include "chainslam/core/random.hpp"

namespace {

using namespace chainslam;

/// A session by itself, `first` to `end` of the keyframes of recording `number`; all recordings have the same times.
SlamMap part_of_recording(std::uint64_t number, int first, int end) {
  SlamMap map;
  map.sessions.push_back({.id = SessionId{0}, .frame = SessionId{0}});
  Rng rng(number);
  SE3d T_odom_body;
  for (int i = 0; i < end; ++i) {
    if (i > 0) T_odom_body = T_odom_body * SE3d(SO3d::exp({0, 0, rng.normal(0, 0.1)}), {rng.normal(1, 0.1), 0, 0});
    if (i < first) continue;
    Keyframe keyframe{.id = KeyframeId{to_index(map.keyframes.size())}, .session = SessionId{0}};
    keyframe.time = Timestamp::from_seconds(10 + i);
    keyframe.T_odom_body = T_odom_body;
    auto cloud = std::make_shared<PointCloud<float>>();
    cloud->positions.resize(100 + static_cast<std::size_t>(i));
    keyframe.cloud = cloud;
    map.keyframes.push_back(keyframe);
  }
  map.sessions.front().keyframes = to_index(map.keyframes.size());
  return map;
}

SlamMap joined(const std::vector<SlamMap>& parts) {
  SlamMap map;
  for (const SlamMap& part : parts) append_map(map, part);
  return map;
}

DistinctSessions distinct(const std::vector<SlamMap>& maps) {
  std::vector<const SlamMap*> all;
  for (const SlamMap& map : maps) all.push_back(&map);
  return distinct_sessions(all);
}

bool same(const SlamMap& a, const SlamMap& b) {
  return is_same_recording(a, a.sessions.front(), b, b.sessions.front());
}

using SessionPlaces = std::vector<SessionPlace>;

}  // namespace

TEST_SUITE("map/distinct_sessions") {
  TEST_CASE("a recording is known by its times, poses and scans, also if a map has only a part of it") {
    const SlamMap whole = part_of_recording(1, 0, 40);
    CHECK(same(whole, whole));
    for (const auto& [first, end] : {std::pair(0, 1), {0, 12}, {30, 40}, {20, 21}}) {
      CHECK(same(whole, part_of_recording(1, first, end)));
      CHECK(same(part_of_recording(1, first, end), whole));
    }
    CHECK(same(part_of_recording(1, 0, 20), part_of_recording(1, 10, 40)));        // 10 of 20
    CHECK_FALSE(same(part_of_recording(1, 0, 20), part_of_recording(1, 11, 40)));  // 9 of 20
    CHECK_FALSE(same(part_of_recording(1, 0, 20), part_of_recording(1, 20, 40)));
    // Another drive with the same times and the same first keyframe.
    CHECK_FALSE(same(whole, part_of_recording(2, 0, 40)));
    SlamMap other = whole;
    for (Keyframe& keyframe : other.keyframes) keyframe.cloud.reset();
    CHECK_FALSE(same(whole, other));
    other = whole;
    for (Keyframe& keyframe : other.keyframes) keyframe.time = keyframe.time + seconds(0.5);
    CHECK_FALSE(same(whole, other));
    const SlamMap none = part_of_recording(1, 0, 0);
    CHECK_FALSE(same(none, none));
    CHECK_FALSE(same(none, whole));
  }

  TEST_CASE("of each recording the map with the most of it counts, and of equals the first") {
    const SlamMap a = part_of_recording(1, 0, 30), b = part_of_recording(2, 0, 20), c = part_of_recording(3, 0, 25),
                  begun = part_of_recording(2, 0, 9);
    const DistinctSessions apart = distinct({a, b, c});
    CHECK(apart.taken == SessionPlaces{{0, SessionId{0}}, {1, SessionId{0}}, {2, SessionId{0}}});
    CHECK(apart.left_out.empty());

    const DistinctSessions grown = distinct({joined({a, begun}), joined({c, a, b}), b});
    CHECK(grown.taken == SessionPlaces{{0, SessionId{0}}, {1, SessionId{0}}, {1, SessionId{2}}});
    REQUIRE(grown.left_out.size() == 3);
    CHECK(grown.left_out[0].left_out == SessionPlace{0, SessionId{1}});
    CHECK(grown.left_out[0].taken == SessionPlace{1, SessionId{2}});
    CHECK(grown.left_out[1].left_out == SessionPlace{1, SessionId{1}});
    CHECK(grown.left_out[1].taken == SessionPlace{0, SessionId{0}});
    CHECK(grown.left_out[2].left_out == SessionPlace{2, SessionId{0}});
    CHECK(grown.left_out[2].taken == SessionPlace{1, SessionId{2}});

    // What one map has twice, it was made with.
    const DistinctSessions twice = distinct({joined({a, a}), a});
    CHECK(twice.taken == SessionPlaces{{0, SessionId{0}}, {0, SessionId{1}}});
    CHECK(twice.left_out.size() == 1);
    CHECK(distinct({}).taken.empty());
  }
}
