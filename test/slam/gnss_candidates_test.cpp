#include "chainslam/slam/gnss_candidates.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "slam/scripted.hpp"
#include "slam/street.hpp"
#include "support/numbers.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using test::fix_at;
using test::for_all;
using test::nan;

/// Appends a keyframe of the newest session, with a fix at these metres east, north and up.
Index put(SlamMap& map, const Eigen::Vector3d& p_local, double sigma = 1.0) {
  Session& session = map.sessions.back();
  Keyframe keyframe = test::keyframe_at(static_cast<double>(map.keyframes.size()), SE3d());
  keyframe.id = KeyframeId{to_index(map.keyframes.size())};
  keyframe.session = session.id;
  keyframe.gnss = fix_at(keyframe.time, p_local, sigma);
  ++session.keyframes;
  map.keyframes.push_back(keyframe);
  return keyframe.id.value;
}

void begin_session(SlamMap& map) {
  const SessionId id{to_index(map.sessions.size())};
  map.sessions.push_back({id, {}, to_index(map.keyframes.size()), 0, id, {}, {}});
}

/// A session with fixes at these places, then another one with the query at the origin.
SlamMap two_sessions(const std::vector<Eigen::Vector3d>& places) {
  SlamMap map;
  begin_session(map);
  for (const Eigen::Vector3d& place : places) put(map, place);
  begin_session(map);
  put(map, {0, 0, 0});
  return map;
}

std::vector<Index> proposals(const GnssCandidateOptions& options, const SlamMap& map, Index query) {
  std::vector<Index> found;
  for (const KeyframeId id : GnssCandidates(options).find(map, KeyframeId{query})) found.push_back(id.value);
  return found;
}
std::vector<Index> proposals(const GnssCandidateOptions& options, const SlamMap& map) {
  return proposals(options, map, to_index(map.keyframes.size()) - 1);
}

constexpr GnssCandidateOptions all{.min_separation = 0, .max_count = 100};

/// The definition, keyframe by keyframe.
std::vector<Index> near_naively(const SlamMap& map, Index query, double radius) {
  const Keyframe& here = map.keyframes[static_cast<std::size_t>(query)];
  const Eigen::Vector3d up = here.gnss->position_ecef.normalized();
  std::vector<std::pair<double, Index>> near;
  for (const Keyframe& there : map.keyframes) {
    if (!(there.session < here.session)) continue;
    if (map.sessions[static_cast<std::size_t>(there.session.value)].frame ==
        map.sessions[static_cast<std::size_t>(here.session.value)].frame)
      continue;
    const Eigen::Vector3d way = there.gnss->position_ecef - here.gnss->position_ecef;
    const double distance = (way - way.dot(up) * up).norm();
    if (distance <= radius && std::abs(way.dot(up)) <= 50) near.emplace_back(distance, there.id.value);
  }
  std::ranges::sort(near);
  std::vector<Index> ids;
  for (const auto& one : near) ids.push_back(one.second);
  return ids;
}

}  // namespace

TEST_SUITE("slam/gnss_candidates") {
  TEST_CASE(
      "fixes within the radius along the ground are proposed, nearest first, whatever their height up to a bound") {
    const SlamMap map = two_sessions({{9.9, 0, 0}, {10.1, 0, 0}, {0, -5, 49}, {3, 3, -49}, {1, 0, 51}, {1.1, 0, -51}});
    CHECK(proposals(all, map) == std::vector<Index>{3, 2, 0});
    GnssCandidateOptions options = all;
    options.radius = 4.5;
    CHECK(proposals(options, map) == std::vector<Index>{3});
    options.max_height = 60;
    CHECK(proposals(options, map) == std::vector<Index>{4, 5, 3});
  }

  TEST_CASE("fixes that the receiver does not trust, or that are no numbers, count on neither side") {
    const std::vector<Eigen::Vector3d> places(2, {1, 0, 0});
    const auto found_with = [&](auto&& spoil) {
      for (const std::size_t side : {0U, 2U}) {
        SlamMap map = two_sessions(places);
        spoil(map.keyframes[side]);
        const std::vector<Index> expected = side == 0 ? std::vector<Index>{1} : std::vector<Index>{};
        CHECK(proposals(all, map) == expected);
      }
    };
    found_with([](Keyframe& keyframe) { keyframe.gnss.reset(); });
    found_with([](Keyframe& keyframe) { keyframe.gnss->quality = GnssQuality::none; });
    found_with([](Keyframe& keyframe) { keyframe.gnss->covariance_ecef(2, 2) = 20.1 * 20.1; });
    for (int axis = 0; axis < 3; ++axis) {
      found_with([=](Keyframe& keyframe) { keyframe.gnss->position_ecef[axis] = nan; });
      found_with([=](Keyframe& keyframe) { keyframe.gnss->covariance_ecef(axis, axis) = nan; });
      found_with([=](Keyframe& keyframe) {
        keyframe.gnss->covariance_ecef(axis, axis) = std::numeric_limits<double>::infinity();
      });
    }
    SlamMap map = two_sessions(places);
    map.keyframes[2].gnss->covariance_ecef *= 19.9 * 19.9;
    CHECK(proposals(all, map) == std::vector<Index>{0, 1});
  }

  TEST_CASE("neither the query's own session, nor one joined with it, nor a later one is proposed") {
    SlamMap map;
    for (int session = 0; session < 4; ++session) {
      begin_session(map);
      put(map, {0.1 * session, 0, 0});
      put(map, {0.1 * session + 2, 0, 0});
    }
    CHECK(proposals(all, map, 4) == std::vector<Index>{2, 0, 1, 3});
    map.sessions[1].frame = SessionId{0};
    CHECK(proposals(all, map, 4) == std::vector<Index>{2, 0, 1, 3});
    map.sessions[2].frame = SessionId{0};
    CHECK(proposals(all, map, 4).empty());
    CHECK(proposals(all, map, 0).empty());
    CHECK(proposals(all, map, 6) == std::vector<Index>{4, 2, 0, 1, 3, 5});
  }

  TEST_CASE(
      "a session that has just been joined is not proposed again, though its fixes were put into the tree before") {
    SlamMap map = two_sessions({{1, 0, 0}});
    GnssCandidates candidates(all);
    CHECK(candidates.find(map, KeyframeId{1}).size() == 1);
    map.sessions[1].frame = SessionId{0};
    CHECK(candidates.find(map, KeyframeId{1}).empty());
    begin_session(map);
    const KeyframeId later{put(map, {0, 0, 0})};
    CHECK(candidates.find(map, later).size() == 2);
  }

  TEST_CASE("the radius can be one in space") {
    const SlamMap map = two_sessions({{6, 0, 9}, {9, 0, 1}});
    GnssCandidateOptions options = all;
    CHECK(proposals(options, map) == std::vector<Index>{0, 1});
    options.with_height = true;
    CHECK(proposals(options, map) == std::vector<Index>{1});
  }

  TEST_CASE("of neighbours in one session only the nearest is proposed, and no more than the count") {
    std::vector<Eigen::Vector3d> places;
    for (int i = 0; i < 30; ++i) places.emplace_back(0.5 * std::abs(i - 14), 1, 0);
    const SlamMap map = two_sessions(places);
    GnssCandidateOptions options = all;
    options.min_separation = 10;
    CHECK(proposals(options, map) == std::vector<Index>{14, 4, 24});
    options.max_count = 2;
    CHECK(proposals(options, map) == std::vector<Index>{14, 4});
    options.max_count = 0;
    CHECK(proposals(options, map).empty());
  }

  TEST_CASE("whatever the fixes, what is proposed is what going through all of them finds") {
    for_all(60, [](Rng& rng, int size) {
      SlamMap map;
      const int sessions = 2 + static_cast<int>(rng.uniform_index(3));
      for (int session = 0; session < sessions; ++session) {
        begin_session(map);
        if (session == 1 && size % 3 == 0) map.sessions[1].frame = SessionId{0};
        for (int i = 0; i < size; ++i) put(map, {rng.uniform(-30, 30), rng.uniform(-30, 30), rng.uniform(-40, 40)});
      }
      GnssCandidates candidates(all);
      for (Index query = 0; query < to_index(map.keyframes.size()); query += 1 + size / 5) {
        std::vector<Index> found;
        for (const KeyframeId id : candidates.find(map, KeyframeId{query})) found.push_back(id.value);
        std::vector<Index> expected = near_naively(map, query, all.radius);
        if (to_index(expected.size()) > all.max_count) expected.resize(static_cast<std::size_t>(all.max_count));
        CHECK(found == expected);
      }
    });
  }

  TEST_CASE("of its own frame, what the map has far from where fixes put it is proposed, and nothing else") {
    SlamMap map = two_sessions({{3, 0, 0}, {4, 0, 0}, {5, 0, 0}, {25, 0, 0}});
    map.sessions[1].frame = SessionId{0};
    map.keyframes[0].T_map_body = test::shift(12, 0, 0);
    map.keyframes[1].T_map_body = test::shift(39.9, 0, 0);  // 10 + 30 m are allowed
    map.keyframes[2].T_map_body = test::shift(0, 40.1, 0);
    map.keyframes[3].T_map_body = test::shift(90, 0, 0);
    const auto misplaced = [&](const GnssCandidateOptions& options) {
      std::vector<Index> found;
      for (const KeyframeId id : GnssCandidates(options).misplaced(map, KeyframeId{4})) found.push_back(id.value);
      return found;
    };
    CHECK(proposals(all, map).empty());
    CHECK(misplaced(all) == std::vector<Index>{2});
    GnssCandidateOptions near = all;
    near.misplaced = 0;
    CHECK(misplaced(near) == std::vector<Index>{0, 1, 2});
    map.sessions[1].frame = SessionId{1};
    CHECK(misplaced(all).empty());
  }

  TEST_CASE("an empty map of earlier sessions gives nothing") { CHECK(proposals(all, two_sessions({})).empty()); }
}

}  // namespace chainslam
