#include "chainslam/trajectory/pose_errors.hpp"

#include <doctest/doctest.h>

#include "evaluation/paths.hpp"

using namespace chainslam;
using test::seen_from, test::winding;

namespace {

const SO3d turn = SO3d::exp({0.4, -0.2, 2.5});
const Eigen::Vector3d shift(10, -20, 3);

}  // namespace

TEST_SUITE("evaluation/ape") {
  TEST_CASE("a moved and turned estimate is without error once aligned, and its transform is found") {
    const Trajectory reference = winding(200), estimate = seen_from(turn, shift, 1, reference);
    const auto found = ape(reference, estimate);
    REQUIRE(found.status == EvaluationStatus::evaluated);
    CHECK(found.translation.count == 200);
    CHECK(found.translation.max < 1e-12);
    CHECK(found.rotation.max < 1e-12);
    CHECK((found.S_reference_estimate.rotation() * turn).log().norm() < 1e-12);
    CHECK((found.S_reference_estimate * shift).norm() < 1e-12);
  }

  TEST_CASE("a scaled estimate needs the scale") {
    const Trajectory reference = winding(200), estimate = seen_from(turn, shift, 0.5, reference);
    CHECK(ape(reference, estimate, {.align = Alignment::sim3}).translation.max < 1e-12);
    CHECK(ape(reference, estimate, {.align = Alignment::sim3}).S_reference_estimate.scale() == doctest::Approx(2));
    CHECK(ape(reference, estimate, {.align = Alignment::se3}).translation.rmse > 1);
  }

  TEST_CASE("unaligned, a shift in the reference's frame is the error of every pose") {
    const Trajectory reference = winding(50), estimate = seen_from(SO3d(), {3, 0, 4}, 1, reference);
    const auto found = ape(reference, estimate, {.align = Alignment::none});
    CHECK(found.translation.min == doctest::Approx(5));
    CHECK(found.translation.max == doctest::Approx(5));
    CHECK(found.translation.sse == doctest::Approx(50 * 25));
    CHECK(found.rotation.max < 1e-12);
  }

  TEST_CASE("unaligned, a turn in the body's frame is the error of every rotation, up to pi") {
    Trajectory reference = winding(50), estimate = reference;
    const double pi = 3.14159265358979323846;
    for (const double angle : {0.1, 3.0, pi}) {
      for (std::size_t i = 0; i < 50; ++i)
        estimate.poses[i] = reference.poses[i] * SE3d(SO3d::exp({0, angle, 0}), Eigen::Vector3d::Zero());
      const auto found = ape(reference, estimate, {.align = Alignment::none});
      CHECK(found.rotation.mean == doctest::Approx(angle));
      CHECK(found.translation.max < 1e-12);
    }
  }

  TEST_CASE("aligned by origin, the first poses agree and a drift shows in full at the end") {
    const Trajectory reference = winding(50);
    Trajectory estimate = seen_from(turn, shift, 1, reference);
    estimate.poses.back() = estimate.poses.back() * SE3d(SO3d(), {0, 0, 2});
    const auto found = ape(reference, estimate, {.align = Alignment::origin});
    CHECK(found.translation_errors.front() < 1e-12);
    CHECK(found.translation_errors.back() == doctest::Approx(2));
  }

  TEST_CASE("laid flat, height, roll and pitch do not count") {
    const Trajectory reference = winding(100);
    Trajectory estimate = reference;
    for (SE3d& pose : estimate.poses) pose = SE3d(pose.rotation(), pose.translation() + Eigen::Vector3d(0, 0, 7));
    CHECK(ape(reference, estimate, {.align = Alignment::none}).translation.rmse == doctest::Approx(7));
    const auto flat = ape(reference, estimate, {.align = Alignment::none, .project_xy = true});
    CHECK(flat.translation.max < 1e-12);
    CHECK(flat.rotation.max < 1e-12);
    const auto turned =
        ape(reference, seen_from(SO3d::exp({0, 0, 0.3}), {1, 2, 9}, 1, reference), {.project_xy = true});
    REQUIRE(turned.status == EvaluationStatus::evaluated);
    CHECK(turned.translation.max < 1e-12);
    CHECK(turned.rotation.max < 1e-12);
  }

  TEST_CASE("a projected pose keeps its yaw") {
    const SE3d pose(SO3d::exp({0, 0, 1.2}) * SO3d::exp({0, 0.4, 0}) * SO3d::exp({-0.7, 0, 0}), {1, 2, 3});
    const SE3d flat = projected_to_xy(pose);
    CHECK(flat.rotation().log().isApprox(Eigen::Vector3d(0, 0, 1.2)));
    CHECK(flat.translation() == Eigen::Vector3d(1, 2, 0));
  }

  TEST_CASE("several sessions share one alignment: an error between them stays visible") {
    const Trajectory first = winding(100);
    Trajectory second = first;
    for (SE3d& pose : second.poses) pose = SE3d(pose.rotation(), pose.translation() + Eigen::Vector3d(0, 0, 5));
    const MatchedTrajectories together[] = {{first, first}, {first, second}};
    const auto found = ape(together);
    REQUIRE(found.status == EvaluationStatus::evaluated);
    CHECK(found.translation.count == 200);
    CHECK(found.translation.rmse == doctest::Approx(2.5));  // the best shift halves the step of 5 m
    CHECK(ape(first, second).translation.rmse < 1e-12);     // alone, each would be perfect
  }

  TEST_CASE("nothing to compare is a status, and so is a path that fixes no rotation") {
    CHECK(ape(Trajectory{}, Trajectory{}).status == EvaluationStatus::no_poses);
    CHECK(ape(std::span<const MatchedTrajectories>{}).status == EvaluationStatus::no_poses);
    CHECK(ape(winding(1), winding(1)).status == EvaluationStatus::degenerate_alignment);
    CHECK(ape(winding(1), winding(1)).translation.count == 0);
    CHECK(ape(winding(1), winding(1), {.align = Alignment::none}).status == EvaluationStatus::evaluated);
    CHECK(ape(winding(1), winding(1), {.align = Alignment::origin}).translation.max < 1e-12);
    Trajectory straight;
    for (int i = 0; i < 10; ++i) straight.poses.push_back(SE3d(SO3d(), {1.0 * i, 2.0 * i, 0}));
    CHECK(ape(straight, straight).status == EvaluationStatus::degenerate_alignment);
    Trajectory standing;
    standing.poses.assign(10, SE3d(SO3d(), {1, 2, 3}));
    CHECK(ape(standing, standing).status == EvaluationStatus::degenerate_alignment);
  }

  TEST_CASE("trajectories that do not belong together are refused by name") {
    CHECK_THROWS_WITH_AS((void)ape(winding(3), winding(4)),
                         "evaluation: 3 reference poses and 4 estimated ones; associate them first",
                         std::invalid_argument);
    CHECK_THROWS_WITH_AS((void)ape(winding(5), test::with_nan(winding(5))),
                         "evaluation: pose 4 of the estimate is not finite", std::invalid_argument);
    CHECK_THROWS_WITH_AS((void)ape(test::with_nan(winding(5)), winding(5)),
                         "evaluation: pose 4 of the reference is not finite", std::invalid_argument);
  }
}
