#include "chainslam/trajectory/association.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <random>
#include <set>
#include <vector>

using namespace chainslam;

namespace {

Trajectory timed(const std::vector<double>& times) {
  Trajectory trajectory;
  for (const double time : times) {
    trajectory.times.push_back(Timestamp::from_seconds(time));
    trajectory.poses.push_back(SE3d(SO3d(), Eigen::Vector3d(time, 0, 0)));
  }
  return trajectory;
}

using Matches = std::vector<Match>;

/// Sorted, distinct times in milliseconds.
Trajectory random_times(std::mt19937& generator, int count, int span) {
  std::set<int> times;
  for (int i = 0; i < count; ++i) times.insert(static_cast<int>(generator() % static_cast<unsigned>(span)));
  Trajectory trajectory;
  for (const int time : times) {
    trajectory.times.push_back(Timestamp::from_microseconds(1000 * time));
    trajectory.poses.push_back(SE3d());
  }
  return trajectory;
}

/// What evo's rule says, by trying every pair: each of the shorter takes the nearest of the longer, the first of
/// equals.
Matches by_trying_all(const Trajectory& reference, const Trajectory& estimate, Duration max_difference) {
  const bool estimate_longer = estimate.size() > reference.size();
  const auto& shorter = estimate_longer ? reference.times : estimate.times;
  const auto& longer = estimate_longer ? estimate.times : reference.times;
  Matches matches;
  for (std::size_t i = 0; i < shorter.size(); ++i) {
    std::size_t best = 0;
    for (std::size_t j = 1; j < longer.size(); ++j)
      if (std::chrono::abs(longer[j] - shorter[i]) < std::chrono::abs(longer[best] - shorter[i])) best = j;
    if (longer.empty() || std::chrono::abs(longer[best] - shorter[i]) > max_difference) continue;
    const auto a = static_cast<Index>(i), b = static_cast<Index>(best);
    matches.push_back(estimate_longer ? Match{a, b} : Match{b, a});
  }
  return matches;
}

}  // namespace

TEST_SUITE("trajectory/association") {
  TEST_CASE("each pose of the shorter takes the nearest of the longer within the allowed difference") {
    const auto reference = timed({0, 0.1, 0.2, 0.3, 0.4});
    const auto estimate = timed({0.098, 0.205, 0.35});
    const auto found = associate_by_time(reference, estimate);
    CHECK(found.matches == Matches{{1, 0}, {2, 1}});
    CHECK(found.largest_difference == std::chrono::milliseconds(5));
    CHECK(found.estimate == UnmatchedCounts{.too_far = 1});
    CHECK(found.reference == UnmatchedCounts{.before = 1, .after = 1, .too_far = 1});
  }

  TEST_CASE("the difference allowed is itself allowed") {
    const auto found = associate_by_time(timed({1}), timed({1.01}), {.max_difference = std::chrono::milliseconds(10)});
    CHECK(found.matches.size() == 1);
  }

  TEST_CASE("two that want the same pose: the nearer gets it, the other is counted; evo would keep both") {
    const auto reference = timed({0, 1, 5, 9}), estimate = timed({1.004, 1.008, 9});
    const auto found = associate_by_time(reference, estimate);
    CHECK(found.matches == Matches{{1, 0}, {3, 2}});
    CHECK(found.estimate == UnmatchedCounts{.taken = 1});
    const auto as_evo = associate_by_time(reference, estimate, {.one_to_one = false});
    CHECK(as_evo.matches == Matches{{1, 0}, {1, 1}, {3, 2}});
  }

  TEST_CASE("trajectories without overlap, or empty ones, have no match and say why") {
    const auto apart = associate_by_time(timed({0, 1}), timed({100, 101}));
    CHECK(apart.matches.empty());
    CHECK(apart.estimate == UnmatchedCounts{.after = 2});
    CHECK(apart.reference == UnmatchedCounts{.before = 2});
    const auto empty = associate_by_time({}, timed({1}));
    CHECK(empty.matches.empty());
    CHECK(empty.estimate.total() == 1);
    CHECK(associate_by_time({}, {}).matches.empty());
  }

  TEST_CASE("agrees with trying every pair, and every pose is matched or counted once") {
    for (unsigned seed = 0; seed < 200; ++seed) {
      CAPTURE(seed);
      std::mt19937 generator(seed);
      const auto reference = random_times(generator, static_cast<int>(generator() % 40), 300);
      const auto estimate = random_times(generator, static_cast<int>(generator() % 40), 300);
      const Duration allowed = std::chrono::milliseconds(generator() % 12);
      const auto as_evo = associate_by_time(reference, estimate, {.max_difference = allowed, .one_to_one = false});
      CHECK(as_evo.matches == by_trying_all(reference, estimate, allowed));

      const auto found = associate_by_time(reference, estimate, {.max_difference = allowed});
      std::set<Index> references, estimates;
      for (const Match& match : found.matches) {
        CHECK(std::find(as_evo.matches.begin(), as_evo.matches.end(), match) != as_evo.matches.end());
        references.insert(match.reference);
        estimates.insert(match.estimate);
      }
      CHECK(references.size() == found.matches.size());
      CHECK(estimates.size() == found.matches.size());
      CHECK(found.matches.size() + static_cast<std::size_t>(found.reference.total()) == reference.size());
      CHECK(found.matches.size() + static_cast<std::size_t>(found.estimate.total()) == estimate.size());
    }
  }

  TEST_CASE("times that go back, or none, are refused with what to do") {
    CHECK_THROWS_WITH_AS(
        (void)associate_by_time(timed({1, 0}), timed({1})),
        "association by time: time 1 of the reference is earlier than the one before; use sorted_by_time",
        std::invalid_argument);
    CHECK_THROWS_WITH_AS((void)associate_by_time(timed({1}), {{}, {SE3d()}}),
                         "association by time: the estimate has no times; associate by index", std::invalid_argument);
  }

  TEST_CASE("of poses with one time the first is matched") {
    const auto repeated = timed({0, 1, 1, 2}), single = timed({0, 1, 2});
    CHECK(associate_by_time(single, repeated).matches == Matches{{0, 0}, {1, 1}, {2, 3}});
    CHECK(associate_by_time(single, repeated).estimate == UnmatchedCounts{.taken = 1});
    CHECK(associate_by_time(repeated, single).matches == Matches{{0, 0}, {1, 1}, {3, 2}});
    CHECK(match_interpolated(repeated, timed({0.5, 1, 1.5}), seconds(1)).trajectories.reference.size() == 3);
  }

  TEST_CASE("by index, what one has more is left over") {
    const auto found = associate_by_index(timed({0, 1, 2}), {{}, {SE3d(), SE3d()}});
    CHECK(found.matches == Matches{{0, 0}, {1, 1}});
    CHECK(found.reference.after == 1);
    CHECK(found.estimate.total() == 0);
  }

  TEST_CASE("matched trajectories hold the pairs in order") {
    const auto reference = timed({0, 1, 2, 3}), estimate = timed({1.001, 3.002});
    const auto pair = matched(reference, estimate, associate_by_time(reference, estimate));
    REQUIRE(pair.reference.size() == 2);
    CHECK(pair.reference.poses[1] == reference.poses[3]);
    CHECK(pair.estimate.times == estimate.times);
  }

  TEST_CASE("an interpolated reference meets the estimate's times exactly") {
    const auto reference = timed({0, 1, 2, 10}), estimate = timed({-1, 0.25, 1.5, 5, 11});
    const auto found = match_interpolated(reference, estimate, seconds(2));
    REQUIRE(found.trajectories.reference.size() == 2);
    CHECK(found.trajectories.reference.times == found.trajectories.estimate.times);
    for (std::size_t i = 0; i < 2; ++i)  // the position is the time itself
      CHECK(found.trajectories.reference.poses[i].translation().isApprox(
          found.trajectories.estimate.poses[i].translation()));
    CHECK(found.estimate == UnmatchedCounts{.before = 1, .after = 1, .too_far = 1});
    CHECK(match_interpolated({}, estimate, seconds(1)).estimate.total() == 5);
  }
}
