#include "chainslam/slam/place_candidates.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <numbers>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "chainslam/slam/map_merger.hpp"
#include "chainslam/slam/proximity_or_places.hpp"
#include "slam/courtyard.hpp"
#include "slam/street.hpp"
#include "support/property.hpp"
#include "support/real_data.hpp"
#include "support/real_matrix.hpp"

namespace chainslam {
namespace {

static_assert(MergeCandidates<PlaceCandidates>);

using test::for_courtyard;
using test::two_walks;
using test::TwoSessions;

double in_degrees(double radians) { return radians * 180 / std::numbers::pi; }

/// How many guesses are right, within 1 m along the ground and 5 degrees, and how many are not.
struct Guessed {
  int right = 0, wrong = 0;
  double height = 0;  ///< metres, the largest error of right ones
};

Guessed guessed(const TwoSessions& sessions, PlaceCandidates& candidates, const std::vector<KeyframeId>& queries) {
  Guessed counts;
  for (const KeyframeId query : queries)
    for (const KeyframeId from : candidates.find(sessions.map, query)) {
      const std::optional<SE3d> guess = candidates.guess(from, query);
      REQUIRE(guess);
      const SE3d off = sessions.truth(from, query).inverse() * *guess;
      const bool right = off.translation().head<2>().norm() < 1 && in_degrees(off.rotation().log().norm()) < 5;
      right ? ++counts.right : ++counts.wrong;
      if (right) counts.height = std::max(counts.height, std::abs(off.translation().z()));
    }
  return counts;
}

}  // namespace

TEST_SUITE("slam/place_candidates") {
  TEST_CASE(
      "a courtyard walked twice: submaps of 10 m find their place, whatever the heading, none finds a wrong one") {
    for (const double heading : {0.0, 0.6, 2.0}) {
      const std::optional<TwoSessions> sessions = two_walks(heading);
      if (!sessions) return;
      PlaceCandidates candidates(for_courtyard());
      const std::vector<KeyframeId> queries = sessions->queries(2.3);
      const Guessed counts = guessed(*sessions, candidates, queries);
      MESSAGE("heading ", heading, ": of ", queries.size(), " submaps ", counts.right, " right, ", counts.wrong,
              " wrong, heights within ", counts.height, " m");
      CHECK(queries.size() >= 23);
      CHECK(counts.right + 1 >= static_cast<int>(queries.size()));
      CHECK(counts.wrong == 0);
      CHECK(counts.height < 1.0);
    }
  }

  TEST_CASE("a courtyard walked twice is merged without a fix, from guesses that closures' gate accepts") {
    std::optional<TwoSessions> sessions = two_walks(2.0);
    if (!sessions) return;
    SlamMap& map = sessions->map;
    MapMerger<GnssOrPlaces<>> merger({}, GnssOrPlaces<>(GnssCandidates(), PlaceCandidates(for_courtyard())));
    LoopCloser<> closer;
    std::vector<LoopClosure> accepted;
    for (Index i = map.sessions[1].first_keyframe; i < to_index(map.keyframes.size()) && accepted.empty(); ++i)
      for (const LoopClosure& closure : merger.attempt(map, KeyframeId{i}, closer))
        if (closure.verdict == ClosureVerdict::accepted) accepted.push_back(closure);
    REQUIRE(accepted.size() >= 2);  // that agree
    for (const LoopClosure& closure : accepted) {
      const SE3d off = sessions->truth(closure.from, closure.to).inverse() * closure.T_from_to;
      CHECK(off.translation().norm() < 0.5);
      CHECK(in_degrees(off.rotation().log().norm()) < 2);
      CHECK(closure.kind == ClosureKind::merge);
    }
  }

  TEST_CASE("within a session the start is found again although odometry is 40 m and a radian off by then") {
    std::optional<TwoSessions> sessions = two_walks(0.0);
    if (!sessions) return;
    std::vector<Keyframe> keyframes(sessions->map.keyframes.begin(),
                                    sessions->map.keyframes.begin() + sessions->map.sessions[0].keyframes);
    const std::vector<Keyframe> truth = keyframes;
    const SE3d jump(SO3d::exp({0, 0, 1}), {40, 0, 0});
    const Index n = to_index(keyframes.size());
    for (Index i = n / 2; i < n; ++i) {
      Keyframe& keyframe = keyframes[static_cast<std::size_t>(i)];
      keyframe.T_odom_body = jump * keyframe.T_odom_body;
    }
    PlaceCandidates candidates(for_courtyard());
    int right = 0, wrong = 0;
    for (Index query = n - 40; query < n; query += 5) {
      const auto wanted = [&](const PlaceCandidates::Place& place) { return place.end < query - 100; };
      for (const KeyframeId from : candidates.find(keyframes, KeyframeId{query}, wanted)) {
        const SE3d T_from_to = truth[static_cast<std::size_t>(from.value)].T_odom_body.inverse() *
                               truth[static_cast<std::size_t>(query)].T_odom_body;
        const SE3d off = T_from_to.inverse() * candidates.guess(from, KeyframeId{query}).value();
        const bool is_right = off.translation().head<2>().norm() < 1 && in_degrees(off.rotation().log().norm()) < 5;
        is_right ? ++right : ++wrong;
      }
    }
    MESSAGE("of 8 scans at the end ", right, " find the start, ", wrong, " something else");
    CHECK(right >= 4);
    CHECK(wrong == 0);
  }

  TEST_CASE("what is recognized within a session lies far enough back, and is where it is said to be") {
    std::optional<TwoSessions> sessions = two_walks(0.0);
    if (!sessions) return;
    const std::span<const Keyframe> keyframes(sessions->map.keyframes.data(),
                                              static_cast<std::size_t>(sessions->map.sessions[0].keyframes));
    const auto at = [&](KeyframeId id) -> const Keyframe& { return keyframes[static_cast<std::size_t>(id.value)]; };
    PositionIndex index;
    index.rebuild(keyframes);
    const ProximityCandidates near{.radius = 1.0};
    ProximityOrPlaces candidates(near, PlaceCandidates(for_courtyard()));
    int recognized = 0, right = 0;
    for (KeyframeId query{0}; query.value < to_index(keyframes.size()); ++query.value) {
      const auto seen = keyframes.first(static_cast<std::size_t>(query.value) + 1);
      static_cast<void>(candidates.find(seen, index, query));
      for (const KeyframeId from : candidates.recognize(seen, index, query)) {
        ++recognized;
        CHECK(near.eligible(at(from), at(query)));
        const SE3d truth = at(from).T_odom_body.inverse() * at(query).T_odom_body;
        const SE3d off = truth.inverse() * candidates.guess(from, query).value();
        right += off.translation().head<2>().norm() < 1 && in_degrees(off.rotation().log().norm()) < 5 ? 1 : 0;
      }
      CHECK(candidates.recognize(seen, index, query).empty());  // asked once
    }
    MESSAGE(recognized, " recognized, ", right, " right");
    CHECK(recognized >= 3);
    CHECK(right == recognized);
  }

  TEST_CASE("keyframes of the query's own frame and of places that are not wanted are not proposed") {
    std::optional<TwoSessions> sessions = two_walks(0.0);
    if (!sessions) return;
    PlaceCandidates candidates(for_courtyard());
    const KeyframeId last = sessions->map.keyframes.back().id;
    REQUIRE(!candidates.find(sessions->map, last).empty());
    CHECK(!candidates.guess(last, last));
    CHECK(candidates.find(sessions->map.keyframes, last, [](const PlaceCandidates::Place&) { return false; }).empty());
    sessions->map.sessions[1].frame = sessions->map.sessions[0].frame;
    CHECK(candidates.find(sessions->map, last).empty());
  }

  TEST_CASE("nothing is sought before a fifth of a submap was seen, or when no place may be proposed") {
    const std::optional<TwoSessions> sessions = two_walks(0.0);
    if (!sessions) return;
    PlaceCandidateOptions options = for_courtyard();
    PlaceCandidates candidates(options);
    const KeyframeId first = KeyframeId{sessions->map.sessions[1].first_keyframe};
    CHECK(candidates.find(sessions->map, first).empty());
    CHECK(!candidates.places().empty());
    options.max_count = 0;
    PlaceCandidates none(options);
    CHECK(none.find(sessions->map, sessions->map.keyframes.back().id).empty());
    CHECK(none.places().empty());
  }

  TEST_CASE("a session with fixes is compared by them alone, one without by its places") {
    std::optional<TwoSessions> sessions = two_walks(0.0);
    if (!sessions) return;
    const KeyframeId last = sessions->map.keyframes.back().id;
    GnssOrPlaces<> candidates{GnssCandidates(), PlaceCandidates(for_courtyard())};
    const std::vector<KeyframeId> found = candidates.find(sessions->map, last);
    REQUIRE(!found.empty());
    CHECK(candidates.guess(found.front(), last));
    GnssOrPlaces<> with_fixes{GnssCandidates(), PlaceCandidates(for_courtyard())};
    sessions->map.keyframes.back().gnss = GnssFix{};
    CHECK(with_fixes.find(sessions->map, last).empty());
    CHECK(!with_fixes.guess(found.front(), last));
  }

  TEST_CASE("places are remembered once the path is half a submap long, and then with every spacing") {
    TwoSessions sessions;
    for (int session = 0; session < 2; ++session) {
      sessions.add_session();
      for (Index i = 0; i <= 50; ++i) {
        Keyframe keyframe;
        keyframe.T_odom_body = keyframe.T_map_body = SE3d(SO3d(), {2.0 * i, 0, 0});
        sessions.add(keyframe);
      }
    }
    PlaceCandidates candidates;  // submaps of 60 m, one every 15 m
    const KeyframeId last = sessions.map.keyframes.back().id;
    CHECK(candidates.find(sessions.map, last).empty());  // no scans, so nothing to see
    CHECK(candidates.places().size() == 8);              // the rest is remembered by the next call
    CHECK(candidates.find(sessions.map, last).empty());
    const auto places = candidates.places();
    REQUIRE(places.size() == 10);
    CHECK(places[0].begin == 0);
    CHECK(places[0].end == 16);  // 30 m
    CHECK(places[1].end == 24);  // 46 m: the first keyframe 15 m on
    CHECK(places[4].end - places[4].begin == 31);
    CHECK(places[5].begin == 51);
    CHECK(places[5].center.value == 59);
  }

  TEST_CASE("where a keyframe near closes the loop, the place is not remembered again") {
    TwoSessions sessions;
    const auto drive = [&] {
      sessions.add_session();
      for (Index i = 0; i <= 50; ++i) {
        Keyframe keyframe;
        keyframe.T_odom_body = SE3d(SO3d(), {2.0 * i, 0, 0});
        sessions.add(keyframe);
      }
    };
    drive();
    drive();
    const PositionIndex index;
    ProximityOrPlaces candidates;
    const auto go = [&](Index begin, Index end, bool closes) {
      for (KeyframeId query{begin}; query.value < end; ++query.value) {
        const auto seen = std::span<const Keyframe>(sessions.map.keyframes).first(static_cast<std::size_t>(end));
        static_cast<void>(candidates.find(seen, index, query));
        if (!closes) static_cast<void>(candidates.recognize(seen, index, query));
      }
      return candidates.places().places().size();
    };
    CHECK(go(0, 51, false) == 5);
    CHECK(go(51, 91, true) == 5);
    CHECK(go(91, 102, false) == 7);  // the first is due at once
    const auto places = candidates.places().places();
    CHECK(places[5].end == 92);
    CHECK(places[6].end == 100);
  }

  TEST_CASE("places of a loaded map are remembered bit by bit, whether or not what is near closes the loop") {
    TwoSessions sessions;
    for (const Index count : {200, 10}) {
      sessions.add_session();
      for (Index i = 0; i < count; ++i) {
        Keyframe keyframe;
        keyframe.T_odom_body = SE3d(SO3d(), {2.0 * i, 0, 0});
        sessions.add(keyframe);
      }
    }
    const PositionIndex index;
    ProximityOrPlaces candidates;
    const std::span<const Keyframe> keyframes = sessions.map.keyframes;
    for (const std::size_t remembered : {8U, 16U, 24U, 24U}) {
      static_cast<void>(candidates.find(keyframes, index, KeyframeId{to_index(keyframes.size()) - 1}));
      CHECK(candidates.places().places().size() == remembered);
    }
  }

  TEST_CASE("a way that several drives of one frame have gone is remembered once, and again from the other side") {
    TwoSessions sessions;
    const auto drive = [&](const SE3d& start, Index frame) {
      sessions.add_session();
      sessions.map.sessions.back().frame = SessionId{frame};
      for (Index i = 0; i <= 50; ++i) {
        Keyframe keyframe;
        keyframe.T_odom_body = SE3d(SO3d(), {2.0 * i, 0, 0});
        keyframe.T_map_body = start * keyframe.T_odom_body;
        sessions.add(keyframe);
      }
    };
    const SE3d same_lane, next_lane(SO3d(), {3, 4, 0}), next_street(SO3d(), {0, 40, 0});
    const SE3d oncoming(SO3d::exp({0, 0, std::numbers::pi}), {100, 4, 0});
    drive(same_lane, 0);
    drive(next_lane, 0);
    drive(next_street, 0);
    drive(oncoming, 0);
    drive(same_lane, 4);  // somewhere else
    drive(next_lane, 0);
    drive(same_lane, 6);  // the one that asks
    const KeyframeId last = sessions.map.keyframes.back().id;
    const auto of_each = [&](const PlaceCandidates& candidates) {  // session, places
      std::vector<int> count(7);
      for (const PlaceCandidates::Place& place : candidates.places()) {
        const Keyframe& center = sessions.map.keyframes[static_cast<std::size_t>(place.center.value)];
        ++count[static_cast<std::size_t>(center.session.value)];
      }
      return count;
    };
    PlaceCandidateOptions options;
    options.max_drawn = 0;
    PlaceCandidates of_map(options);
    static_cast<void>(of_map.find(sessions.map, last));
    CHECK(of_each(of_map) == std::vector<int>{5, 0, 5, 5, 5, 0, 5});

    sessions.map.sessions.back().frame = SessionId{0};
    PlaceCandidates merged(options);
    static_cast<void>(merged.find(sessions.map, last));
    CHECK(of_each(merged) == std::vector<int>{5, 0, 5, 5, 5, 0, 5});  // a drive that is not over may be elsewhere

    PositionIndex index;
    index.rebuild(sessions.map.keyframes, [](const Keyframe& one) { return one.session != SessionId{4}; });
    ProximityOrPlaces near({}, PlaceCandidates{options});
    static_cast<void>(near.find(sessions.map.keyframes, index, last));
    CHECK(of_each(near.places()) == std::vector<int>{5, 0, 5, 5, 5, 0, 0});
    static_cast<void>(near.recognize(sessions.map.keyframes, index, last));
    CHECK(of_each(near.places()) == std::vector<int>{5, 0, 5, 5, 5, 0, 5});

    PlaceCandidates each(options);
    each.remember(sessions.map.keyframes, last.value + 1);
    CHECK(of_each(each) == std::vector<int>(7, 5));
  }

  TEST_CASE("round and round, a drive is remembered once, and no less densely on the bend") {
    TwoSessions sessions;
    sessions.add_session();
    constexpr double radius = 20, length = 2 * std::numbers::pi * radius;  // metres
    for (Index i = 0; i < 3 * length; ++i) {
      Keyframe keyframe;
      const SO3d heading = SO3d::exp({0, 0, i / radius});
      keyframe.T_odom_body = keyframe.T_map_body = SE3d(heading, heading * Eigen::Vector3d(radius, 0, 0));
      sessions.add(keyframe);
    }
    PlaceCandidateOptions options;  // submaps of 60 m, one every 15 m
    options.max_drawn = 0;
    const Index end = to_index(sessions.map.keyframes.size());
    PlaceCandidates all(options), once(options);
    all.remember(sessions.map.keyframes, end);
    once.remember(sessions.map.keyframes, end, [](KeyframeId, KeyframeId) { return true; });
    CHECK(all.places().size() >= 20);
    CHECK(once.places().size() >= 8);  // 126 m round
    CHECK(once.places().size() <= 10);
    for (std::size_t k = 0; k < 7; ++k) CHECK(once.places()[k].center == all.places()[k].center);
  }

  TEST_CASE("the ground's height is that of the lower points around, seen from wherever, in a levelled frame") {
    std::vector<Keyframe> path(3);
    CHECK(!detail::ground_height(path, 1));
    for (Index i = 0; i < 3; ++i)
      path[static_cast<std::size_t>(i)].T_odom_body = SE3d(SO3d::exp({0, 0.3, 0}), {10.0 * i, 5, 5});
    PointCloud<float> cloud;
    for (double x = -3; x < 3; x += 0.1) {
      const SE3d T_body_odom = path[2].T_odom_body.inverse();
      cloud.positions.push_back((T_body_odom * Eigen::Vector3d(10 + x, 5, 3.5)).cast<float>());
      cloud.positions.push_back((T_body_odom * Eigen::Vector3d(10 + x, 6, 9)).cast<float>());
      cloud.positions.push_back((T_body_odom * Eigen::Vector3d(10, 11 + x * x, -20)).cast<float>());  // 6 m aside
    }
    path[2].cloud = std::make_shared<const PointCloud<float>>(cloud);
    CHECK(detail::ground_height(path, 1).value() == doctest::Approx(-1.5));
    CHECK(!detail::ground_height(std::span(path).first(2), 1));
  }

  TEST_CASE("options that make no sense are refused") {
    CHECK_THROWS_AS(PlaceCandidates({.submap_length = 0}), std::invalid_argument);
    CHECK_THROWS_AS(PlaceCandidates({.spacing = 0}), std::invalid_argument);
    CHECK_THROWS_AS(PlaceCandidates({.index = {.min_inliers = 2}}), std::invalid_argument);
  }
}

}  // namespace chainslam
