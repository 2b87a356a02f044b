#include "chainslam/trajectory/inter_session.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <optional>

#include "chainslam/core/random.hpp"
#include "evaluation/paths.hpp"
#include "support/property.hpp"

using namespace chainslam;
using test::seen_from, test::winding;

namespace {

/// Poses 1 m apart along x, `y` beside it, all facing `yaw`.
Trajectory lane(int count, double y, double yaw) {
  Trajectory path;
  for (int i = 0; i < count; ++i) path.poses.push_back(SE3d(SO3d::exp({0, 0, yaw}), {1.0 * i, y, 0}));
  return path;
}

SE3d random_pose(Rng& rng, double reach) {
  const auto number = [&rng](double bound) { return rng.uniform(-bound, bound); };
  const double x = number(reach), y = number(reach), z = number(1);
  const double roll = number(0.2), pitch = number(0.2), yaw = number(3);
  return SE3d(SO3d::exp({roll, pitch, yaw}), {x, y, z});
}

/// The pairs, pose by pose and by looking at all.
std::vector<CoLocatedPair> pairs_by_force(std::span<const Trajectory> references, const CoLocationOptions& options) {
  std::vector<CoLocatedPair> pairs;
  for (std::size_t b = 0; b < references.size(); ++b)
    for (std::size_t i = 0; i < references[b].size(); ++i)
      for (std::size_t a = 0; a < b; ++a) {
        std::optional<CoLocatedPair> best;
        double distance = std::numeric_limits<double>::infinity();
        for (std::size_t j = 0; j < references[a].size(); ++j) {
          const SE3d step = references[a].poses[j].inverse() * references[b].poses[i];
          const double here = (references[a].poses[j].translation() - references[b].poses[i].translation()).norm();
          if (here > options.max_distance || here >= distance) continue;
          if (step.rotation().log().norm() > options.max_angle) continue;
          distance = here;
          best = CoLocatedPair{to_index(a), to_index(j), to_index(b), to_index(i)};
        }
        if (best) pairs.push_back(*best);
      }
  return pairs;
}

}  // namespace

TEST_SUITE("evaluation/inter_session") {
  TEST_CASE("pairs agree with looking at all poses") {
    test::for_all(50, [](Rng& rng, int size) {
      std::vector<Trajectory> references(3);
      for (Trajectory& path : references)
        for (int i = 0; i < size; ++i) path.poses.push_back(random_pose(rng, 12));
      const CoLocationOptions options{.max_distance = 4, .max_angle = 0.9};
      CHECK(co_located_pairs(references, options) == pairs_by_force(references, options));
    });
  }

  TEST_CASE("each pose has one partner in each earlier session: the nearest that faces its way") {
    const std::vector<Trajectory> lanes{lane(20, 0, 0), lane(20, 3, 0), lane(20, 1, 3.0)};
    const auto pairs = co_located_pairs(lanes);
    REQUIRE(pairs.size() == 20);  // the third drives the other way
    for (Index i = 0; i < 20; ++i) CHECK(pairs[static_cast<std::size_t>(i)] == CoLocatedPair{0, i, 1, i});
    CHECK(co_located_pairs(lanes, {.max_distance = 2.5}).empty());
    CHECK(co_located_pairs(lanes, {.max_distance = 2.5, .max_angle = 3.1}).size() == 40);
  }

  TEST_CASE("the frames of truth and estimate do not matter, and a session out of its place shows in every pair") {
    const Trajectory path = winding(200);
    const SO3d turn = SO3d::exp({0.4, -0.2, 2.5});
    const Eigen::Vector3d shift(10, -20, 3);
    const Trajectory seen = seen_from(turn, shift, 1, path);
    const MatchedTrajectories good[] = {{path, seen}, {path, seen}};
    const auto none = inter_session_errors(good);
    REQUIRE(none.status == EvaluationStatus::evaluated);
    CHECK(none.translation.count == 200);
    CHECK(none.translation.max < 1e-12);
    CHECK(none.rotation.max < 1e-12);

    Trajectory moved = seen;  // in the body's frame, so that all pairs see the same
    const SE3d step(SO3d::exp({0, 0.1, 0}), {0.3, 0, 0.4});
    for (SE3d& pose : moved.poses) pose = pose * step;
    const MatchedTrajectories bad[] = {{path, seen}, {path, moved}};
    const auto found = inter_session_errors(bad);
    CHECK(found.translation.rmse == doctest::Approx(0.5));
    CHECK(found.translation.median == doctest::Approx(0.5));
    CHECK(found.rotation.rmse == doctest::Approx(0.1));
  }

  TEST_CASE("drift that both sessions share is no error between them") {
    Trajectory drifted = winding(100);
    for (std::size_t i = 0; i < drifted.size(); ++i)
      drifted.poses[i] = SE3d(SO3d(), {0.1 * static_cast<double>(i), 0, 0}) * drifted.poses[i];
    const MatchedTrajectories sessions[] = {{winding(100), drifted}, {winding(100), drifted}};
    CHECK(inter_session_errors(sessions, {.max_distance = 0.1}).translation.max < 1e-9);
  }

  TEST_CASE("one session, no session and sessions far apart have no pairs") {
    const MatchedTrajectories one[] = {{winding(50), winding(50)}};
    CHECK(inter_session_errors(one).status == EvaluationStatus::no_poses);
    CHECK(inter_session_errors({}).status == EvaluationStatus::no_poses);
    const MatchedTrajectories apart[] = {{lane(9, 0, 0), lane(9, 0, 0)}, {lane(9, 50, 0), lane(9, 50, 0)}, {{}, {}}};
    const auto found = inter_session_errors(apart);
    CHECK(found.status == EvaluationStatus::no_poses);
    CHECK(found.translation_errors.empty());
  }

  TEST_CASE("bounds and poses that mean nothing are refused") {
    const Trajectory lanes[] = {lane(3, 0, 0)};
    for (const double bound : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()}) {
      CHECK_THROWS_AS((void)co_located_pairs(lanes, {.max_distance = bound}), std::invalid_argument);
      CHECK_THROWS_AS((void)co_located_pairs(lanes, {.max_angle = bound}), std::invalid_argument);
    }
    const MatchedTrajectories bad[] = {{winding(5), test::with_nan(winding(5))}};
    CHECK_THROWS_WITH_AS((void)inter_session_errors(bad), "evaluation: pose 4 of the estimate is not finite",
                         std::invalid_argument);
    const MatchedTrajectories uneven[] = {{winding(5), winding(4)}};
    CHECK_THROWS_AS((void)inter_session_errors(uneven), std::invalid_argument);
  }
}
