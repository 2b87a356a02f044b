#include "chainslam/trajectory/pose_errors.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "evaluation/paths.hpp"

using namespace chainslam;
using test::seen_from, test::winding;
using Pairs = std::vector<PosePair>;

namespace {

std::vector<SE3d> along_x(const std::vector<double>& positions) {
  std::vector<SE3d> poses;
  for (const double x : positions) poses.push_back(SE3d(SO3d(), {x, 0, 0}));
  return poses;
}

/// From each pose the later one whose way is nearest to delta, the first of equals, by trying all.
Pairs by_trying_all(const std::vector<SE3d>& poses, double delta, double tolerance) {
  const auto lengths = path_lengths(poses);
  Pairs pairs;
  for (std::size_t i = 0; i + 1 < poses.size(); ++i) {
    std::size_t best = i + 1;
    for (std::size_t j = i + 2; j < poses.size(); ++j)
      if (std::abs(lengths[j] - lengths[i] - delta) < std::abs(lengths[best] - lengths[i] - delta)) best = j;
    if (std::abs(lengths[best] - lengths[i] - delta) <= tolerance)
      pairs.emplace_back(static_cast<Index>(i), static_cast<Index>(best));
  }
  return pairs;
}

}  // namespace

TEST_SUITE("evaluation/rpe") {
  TEST_CASE("consecutive pairs in metres join the ends of stretches; the way to the first end belongs to none") {
    const auto poses = along_x({0, 1, 2, 3, 5, 6, 7, 7, 8, 9});
    CHECK(rpe_pairs(poses, {.delta = 2, .unit = DeltaUnit::metres}) == Pairs{{2, 4}, {4, 6}, {6, 9}});
  }

  TEST_CASE("all pairs in metres take the nearest way within the tolerance") {
    const auto poses = along_x({0, 1, 2, 2, 3.15, 4});
    const RpeOptions options{.delta = 2, .unit = DeltaUnit::metres, .pairs = PairChoice::all};
    CHECK(rpe_pairs(poses, options) == Pairs{{0, 2}, {1, 4}, {2, 5}, {3, 5}});
  }

  TEST_CASE("all pairs in metres agree with trying them all, standing stretches included") {
    auto poses = winding(300).poses;
    for (std::size_t i = 100; i < 140; ++i) poses[i] = poses[100];
    for (const double delta : {0.5, 3.0, 10.0, 500.0})
      CHECK(rpe_pairs(poses, {.delta = delta, .unit = DeltaUnit::metres, .pairs = PairChoice::all}) ==
            by_trying_all(poses, delta, 0.1 * delta));
  }

  TEST_CASE("pairs in frames, consecutive and all") {
    const auto poses = along_x({0, 1, 2, 3, 4, 5});
    CHECK(rpe_pairs(poses, {.delta = 2}) == Pairs{{0, 2}, {2, 4}});
    CHECK(rpe_pairs(poses, {.delta = 2, .pairs = PairChoice::all}) == Pairs{{0, 2}, {1, 3}, {2, 4}, {3, 5}});
    CHECK(rpe_pairs(poses, {.delta = 5}) == Pairs{{0, 5}});
    CHECK(rpe_pairs(poses, {.delta = 6}).empty());
    CHECK(rpe_pairs({}, {.delta = 1}).empty());
    CHECK(rpe_pairs({}, {.delta = 1, .unit = DeltaUnit::metres, .pairs = PairChoice::all}).empty());
  }

  TEST_CASE("a delta that means nothing is refused") {
    const auto poses = along_x({0, 1});
    CHECK_THROWS_AS((void)rpe_pairs(poses, {.delta = 0}), std::invalid_argument);
    CHECK_THROWS_AS((void)rpe_pairs(poses, {.delta = -1, .unit = DeltaUnit::metres}), std::invalid_argument);
    CHECK_THROWS_AS((void)rpe_pairs(poses, {.delta = 1.5}), std::invalid_argument);
    CHECK_THROWS_AS((void)rpe_pairs(poses, {.delta = std::numeric_limits<double>::quiet_NaN()}), std::invalid_argument);
  }

  TEST_CASE("it does not see where the estimate's frame lies") {
    const Trajectory reference = winding(200);
    const auto found = rpe(reference, seen_from(SO3d::exp({1, 2, 0.5}), {100, -50, 3}, 1, reference));
    REQUIRE(found.status == EvaluationStatus::evaluated);
    CHECK(found.translation.count == 199);
    CHECK(found.translation.max < 1e-12);
    CHECK(found.rotation.max < 1e-12);
  }

  TEST_CASE("one wrong step is the error of the one pair that holds it") {
    const Trajectory reference = winding(100);
    Trajectory estimate = reference;
    const SE3d slip(SO3d::exp({0, 0, 0.02}), {0.3, 0.4, 0});
    for (std::size_t i = 50; i < 100; ++i)  // all from pose 50 on move by a slip made in its frame
      estimate.poses[i] = reference.poses[50] * slip * reference.poses[50].inverse() * reference.poses[i];
    const auto found = rpe(reference, estimate);
    for (std::size_t i = 0; i < 99; ++i) {
      CHECK(found.translation_errors[i] == doctest::Approx(i == 49 ? 0.5 : 0.0));
      CHECK(found.rotation_errors[i] == doctest::Approx(i == 49 ? 0.02 : 0.0));
    }
  }

  TEST_CASE("an estimate too large by a tenth errs by a tenth of each step") {
    Trajectory reference, estimate;
    reference.poses = along_x({0, 1, 2, 3, 4});
    estimate.poses = along_x({0, 1.1, 2.2, 3.3, 4.4});
    CHECK(rpe(reference, estimate).translation.mean == doctest::Approx(0.1));
    CHECK(rpe(reference, estimate, {.delta = 2}).translation.mean == doctest::Approx(0.2));
  }

  TEST_CASE("pairs do not reach from one session into the next") {
    const MatchedTrajectories sessions[] = {{winding(10), winding(10)}, {winding(7), winding(7)}};
    const auto aligned = align_sessions(sessions, {.align = Alignment::none});
    CHECK(rpe(aligned, {.delta = 1}).translation.count == 9 + 6);
  }

  TEST_CASE("without poses or pairs there are no errors") {
    CHECK(rpe(Trajectory{}, Trajectory{}).status == EvaluationStatus::no_poses);
    const auto lone = rpe(winding(1), winding(1));
    CHECK(lone.status == EvaluationStatus::evaluated);
    CHECK(lone.translation.count == 0);
    CHECK_THROWS_AS((void)rpe(winding(5), test::with_nan(winding(5))), std::invalid_argument);
  }
}
