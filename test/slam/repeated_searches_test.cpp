#include "chainslam/slam/detail/repeated_searches.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "slam/street.hpp"

namespace chainslam {
namespace {

/// Keyframes of two sessions on a straight line, `step` metres apart.
std::vector<Keyframe> two_sessions(Index count, double step) {
  std::vector<SE3d> poses;
  for (Index i = 0; i < 2 * count; ++i) poses.emplace_back(SO3d(), Eigen::Vector3d(step * (i % count), 0, 0));
  std::vector<Keyframe> keyframes = test::keyframes_at(poses);
  for (Index i = count; i < 2 * count; ++i) keyframes[static_cast<std::size_t>(i)].session = SessionId{1};
  return keyframes;
}
Session second(Index count) {
  Session session;
  session.id = SessionId{1};
  session.first_keyframe = session.keyframes = count;
  return session;
}

detail::Table<char> only_first() {
  detail::Table<char> joined;
  joined.push_back(1);
  joined.push_back(0);
  return joined;
}

std::vector<Index> all_of(detail::Recheck& recheck, const std::vector<Keyframe>& keyframes, double travel,
                          Index pause) {
  std::vector<Index> found;
  while (const auto id = recheck.next(keyframes, travel)) {
    found.push_back(id->value);
    recheck.pause(pause);
  }
  return found;
}

TEST_SUITE("slam/repeated_searches") {
  TEST_CASE("a recheck goes along the session by its way, from the first keyframe to the last there was") {
    const std::vector<Keyframe> keyframes = two_sessions(10, 1.5);
    detail::Recheck each(second(10), only_first(), 7), some(second(10), only_first(), 7),
        seldom(second(10), only_first(), 7);
    CHECK(all_of(each, keyframes, 0, 0) == std::vector<Index>{10, 11, 12, 13, 14, 15, 16, 17, 18, 19});
    CHECK(all_of(some, keyframes, 4, 0) == std::vector<Index>{10, 13, 16, 19});
    CHECK(all_of(seldom, keyframes, 0, 4) == std::vector<Index>{10, 15});
    CHECK(each.cause() == 7);
    CHECK(each.others(keyframes).size() == 10);
    CHECK(each.others(keyframes).within(keyframes[3].T_map_body.translation(), 0.1).front().id == KeyframeId{3});
  }

  TEST_CASE("keyframes that were moved are searched from again, once for each move") {
    std::vector<Keyframe> keyframes = two_sessions(10, 1.5);
    const Session session = second(10);
    detail::MovedKeyframes moved;
    for (Index i = 10; i < 20; ++i) moved.searched(keyframes[static_cast<std::size_t>(i)]);
    const auto pass = [&](double travel) {
      std::vector<Index> found;
      moved.begin_pass(travel);
      while (const auto id = moved.next(keyframes, session, 3, travel)) found.push_back(id->value);
      return found;
    };
    CHECK(pass(0).empty());
    for (std::size_t i = 15; i < 20; ++i) keyframes[i].T_map_body = SE3d(SO3d(), {0, 2.9, 0}) * keyframes[i].T_map_body;
    CHECK(pass(0).empty());
    for (std::size_t i = 16; i < 20; ++i) keyframes[i].T_map_body = SE3d(SO3d(), {0, 0.2, 0}) * keyframes[i].T_map_body;
    CHECK(pass(0) == std::vector<Index>{16, 17, 18, 19});
    CHECK(pass(0).empty());
    for (std::size_t i = 12; i < 20; ++i) keyframes[i].T_map_body = SE3d(SO3d(), {0, 4, 0}) * keyframes[i].T_map_body;
    CHECK(pass(4) == std::vector<Index>{12, 15, 18});
  }

  TEST_CASE("a pass that was broken off is continued by the next one") {
    std::vector<Keyframe> keyframes = two_sessions(10, 1.5);
    detail::MovedKeyframes moved;
    for (Index i = 10; i < 20; ++i) moved.searched(keyframes[static_cast<std::size_t>(i)]);
    for (std::size_t i = 10; i < 20; ++i) keyframes[i].T_map_body = SE3d(SO3d(), {0, 4, 0}) * keyframes[i].T_map_body;
    std::vector<Index> found;
    for (int passes = 0; passes < 4; ++passes) {
      moved.begin_pass(0);
      for (int k = 0; k < 3; ++k)
        if (const auto id = moved.next(keyframes, second(10), 3, 0)) found.push_back(id->value);
    }
    CHECK(found == std::vector<Index>{10, 11, 12, 13, 14, 15, 16, 17, 18, 19});
    for (std::size_t i = 10; i < 20; ++i) keyframes[i].T_map_body = SE3d(SO3d(), {0, 9, 0}) * keyframes[i].T_map_body;
    moved.moved_together(keyframes, second(10));
    moved.begin_pass(0);
    CHECK_FALSE(moved.next(keyframes, second(10), 3, 0));
    moved.begin_session();
    moved.begin_pass(0);
    CHECK_FALSE(moved.next(keyframes, second(10), 3, 0));
  }
}

}  // namespace
}  // namespace chainslam
