#include <doctest/doctest.h>

#include <Eigen/Core>
#include <vector>

#include "slam/rounds.hpp"

// Each default of outlier rejection, held on a graph where a value four times smaller or larger is worse, if a value in
// that direction is. Thresholds were set on real drives: nclt_sessions_test.cpp.

namespace chainslam {
namespace {

using test::Growing;
using test::Rounds;

/// What was decided on some closures, and how far off the drive is.
struct Decided {
  Index in = 0, out = 0;
  double worst = 0;  ///< metres

  Decided(const Growing& map, const std::vector<Index>& closures) : worst(map.worst()) {
    for (const Index closure : closures) ++(map.verdict(closure) == ClosureVerdict::accepted ? in : out);
  }
};

/// A closure one round back, taken in at once.
Index close_round(Growing& map, Index to, const Eigen::Vector3d& off = Eigen::Vector3d::Zero()) {
  map.drive_to(to + 1);
  const Index closure = map.close(to - Rounds::a_round, to, off);
  CHECK(map.graph.optimize().ok());
  return closure;
}

/// The same, off by a way that is given in the map's frame: two such closures agree, wherever they are.
Index close_beside(Growing& map, Index to, const Eigen::Vector3d& off) {
  map.drive_to(to + 1);
  return close_round(map, to, map.rounds.truth[static_cast<std::size_t>(to)].rotation().inverse() * off);
}

/// A drive that is closed once before step 48 fails, and at these keyframes after it.
Decided broken_and_closed(const std::vector<Index>& at, double slip = 1) {
  const Rounds rounds(100, {48}, 0, slip);
  Growing map(rounds);
  close_round(map, 40);
  std::vector<Index> closures;
  for (const Index to : at) closures.push_back(close_round(map, to));
  return {map, closures};
}

}  // namespace

TEST_SUITE("slam/group_gnc: values") {
  TEST_CASE("closures: six deviations off is accepted and counts, ten is an outlier") {
    for (const double off : {0.3, 0.5}) {
      const Rounds rounds(70);
      Growing map(rounds);
      map.drive_to(61);
      for (Index i = 0; i < 20; ++i)
        if (i != 10) map.close(i, i + Rounds::a_round);
      CHECK(map.graph.optimize().ok());
      const Index closure = close_round(map, 50, {0, off, 0});
      CHECK((map.verdict(closure) == ClosureVerdict::accepted) == (off == 0.3));
    }
  }

  TEST_CASE(
      "odometry: a pair of wrong closures is not worth two steps of odometry, a pair of right ones is worth one") {
    const Rounds rounds(90);
    Growing map(rounds);
    map.drive_to(46);
    map.close(5, 45);
    map.close(4, 44);
    CHECK(map.graph.optimize().ok());
    map.drive_to(61);
    map.close(19, 59);
    map.close(20, 60);
    CHECK(map.graph.optimize().ok());
    // Two steps that fail are one failure only if they are near each other.
    const Decided wrong(map, {close_beside(map, 50, {5, 6, 0}), close_beside(map, 55, {5, 6, 0})});
    CHECK(wrong.in == 0);
    CHECK(wrong.worst < 0.5);
    const Decided right = broken_and_closed({55, 60});
    CHECK(right.in == 2);
    CHECK(right.worst < 0.5);
  }

  TEST_CASE("judged: a step that failed by 1.8 m and 0.25 rad is found, spread over its neighbours as it is") {
    const Decided decided = broken_and_closed({53, 56, 59}, 0.5);
    CHECK(decided.in == 3);
    CHECK(decided.worst < 0.5);
  }

  TEST_CASE("support: two closures that agree overrule odometry that failed, one does not") {
    CHECK(broken_and_closed({52}).in == 0);
    CHECK(broken_and_closed({52, 57}).in == 2);
  }

  TEST_CASE("max_blur: closures 75 m apart still confirm each other, those 180 m apart would whatever they say") {
    const Decided right = broken_and_closed({52, 67});
    CHECK(right.in == 2);
    CHECK(right.worst < 0.5);
    const Rounds rounds(100);
    Growing map(rounds);
    close_round(map, 40);
    const Decided wrong(map, {close_beside(map, 52, {0, 8, 0}), close_beside(map, 88, {0, 8, 0})});
    CHECK(wrong.in == 0);
    CHECK(wrong.worst < 0.5);
  }

  TEST_CASE("memory: a closure confirms one that came before thirty wrong ones") {
    const Rounds rounds(70, {48});
    Growing map(rounds);
    close_round(map, 40);
    const Index first = close_round(map, 52);
    map.drive_to(56);
    Rng rng(5);
    for (Index k = 0; k < 30; ++k) {
      map.close(k, 55, {rng.uniform(-20, 20), rng.uniform(-20, 20), rng.uniform(-5, 5)});
      CHECK(map.graph.optimize().ok());
    }
    CHECK(map.verdict(first) == ClosureVerdict::inconsistent);
    const Decided decided(map, {first, close_round(map, 58)});
    CHECK(map.verdict(first) == ClosureVerdict::accepted);
    CHECK(map.worst() < 0.5);
  }

  TEST_CASE("consecutive_price, consecutive_gap: four steps that fail one after another are found by six closures") {
    const Rounds rounds(60, {46, 47, 48, 49});
    Growing map(rounds);
    close_round(map, 40);
    close_round(map, 45);
    std::vector<Index> closures;
    for (Index to = 46; to < 52; ++to) closures.push_back(close_round(map, to));
    const Decided decided(map, closures);
    CHECK(decided.in == 6);
    CHECK(decided.worst < 0.5);
  }

  TEST_CASE("tried_rows: a wrong closure that came first is found out by fifty weak ones, each of which it bends") {
    const Rounds rounds(50);
    Growing map(rounds);
    map.drive_to(46);
    const Index wrong = map.close(4, 44, {0, 1, 0}, -1, 0.02);
    CHECK(map.graph.optimize().ok());
    CHECK(map.verdict(wrong) == ClosureVerdict::accepted);
    std::vector<Index> right;
    for (Index to = 36; to < 44; ++to)
      for (Index from = 0; from < 7; ++from) {
        right.push_back(map.close(from, to, {0, 0, 0}, -1, 0.6));
        CHECK(map.graph.optimize().ok());
      }
    CHECK(map.verdict(wrong) == ClosureVerdict::inconsistent);
    CHECK(Decided(map, right).out == 0);
    CHECK(map.worst() < 0.3);
  }
}

}  // namespace chainslam
