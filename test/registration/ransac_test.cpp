#include "chainslam/registration/ransac.hpp"

#include <doctest/doctest.h>

#include <chrono>
#include <limits>
#include <numbers>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "registration/scenes.hpp"
#include "support/numbers.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

/// Points in a yard, the same ones seen from elsewhere with noise, and matches
/// of which some are wrong.
struct MatchedScene {
  PointCloud<float> source, target;
  std::vector<FeatureMatch> matches;
  SE3d truth;
};

MatchedScene scene(Rng& rng, Index count, double wrong_share, double noise) {
  MatchedScene made;
  made.truth = SE3d(SO3d::exp(Eigen::Vector3d(rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), rng.uniform(-3, 3))),
                    Eigen::Vector3d(rng.uniform(-30, 30), rng.uniform(-30, 30), rng.uniform(-2, 2)));
  made.target = sample(rng, yard(), count);
  made.source = seen_from(made.target, made.truth);
  for (Eigen::Vector3f& p : made.source.positions)
    p += (noise * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal())).cast<float>();
  for (Index i = 0; i < count; ++i) made.matches.push_back({i, i < wrong_share * count ? rng.uniform_index(count) : i});
  return made;
}

GlobalAlignResult align(const Ransac& ransac, const MatchedScene& made) {
  return ransac.align(made.source, KdTree<float>(made.target), made.matches);
}

}  // namespace

TEST_SUITE("registration/ransac") {
  TEST_CASE("finds T_target_source, which maps source to target, not its inverse") {
    Rng rng(1);
    MatchedScene made = scene(rng, 200, 0.3, 0.0);
    made.truth = asymmetric_pose();
    made.source = seen_from(made.target, made.truth);
    const GlobalAlignResult result = align({.max_distance = 0.2}, made);
    REQUIRE(result.status == GlobalAlignStatus::found);
    for (std::size_t i = 0; i < made.source.size(); ++i)
      CHECK((result.T_target_source * position(made.source, i) - position(made.target, i)).norm() < 1e-4);
    CHECK(translation_error(made.truth.inverse(), result.T_target_source) > 1.0);
  }

  TEST_CASE("finds the motion among as many as nine wrong matches of ten") {
    for (const double wrong : {0.0, 0.5, 0.8, 0.9}) {
      CAPTURE(wrong);
      for_all(10, [wrong](Rng& rng, int) {
        const MatchedScene made = scene(rng, 600, wrong, 0.05);
        const GlobalAlignResult result = align({.max_distance = 0.3, .seed = rng.bits()}, made);
        CHECK(result.status == GlobalAlignStatus::found);
        CHECK(result.matches == 600);
        // The fit of n >= 60 matches with 5 cm each way: 5 cm / sqrt 60 = 6 mm;
        // wrong ones that agree by chance add some.
        CHECK(translation_error(made.truth, result.T_target_source) < 0.06);
        CHECK(rotation_error(made.truth, result.T_target_source) < 0.5 * degree);
        const double right = 1 - wrong;
        CHECK(result.putative_ratio > right - 0.01);
        CHECK(result.putative_ratio < right + 0.05);
        CHECK(result.fitness_source > 0.99);
        CHECK(result.fitness_target > 0.99);
        CHECK(result.inlier_rmse < 0.15);
      });
    }
  }

  TEST_CASE("stops after as many hypotheses as the share of right matches asks for") {
    // A triple of right matches is among k with 0.999 if k = log(0.001) / log(1
    // - 0.5^3) = 52; noise wants a few more.
    Rng rng(3);
    const MatchedScene half = scene(rng, 1000, 0.5, 0.0);
    const GlobalAlignResult result = align({.max_distance = 0.3, .edge_length_ratio = 0}, half);
    CHECK(result.iterations >= 40);
    CHECK(result.iterations <= 60);
    const MatchedScene all = scene(rng, 1000, 0.0, 0.0);
    CHECK(align({}, all).iterations < 10);
    const MatchedScene few = scene(rng, 1000, 0.97, 0.0);
    CHECK(align({.max_distance = 0.1, .max_iterations = 700}, few).iterations == 700);
  }

  TEST_CASE("the figures are what measuring by hand gives") {
    Rng rng(4);
    const MatchedScene made = scene(rng, 400, 0.6, 0.05);
    const GlobalAlignResult result = align({.max_distance = 0.25}, made);
    Index consensus = 0;
    for (const FeatureMatch& match : made.matches) {
      const Eigen::Vector3d p = position(made.source, static_cast<std::size_t>(match.source));
      const Eigen::Vector3d q = position(made.target, static_cast<std::size_t>(match.target));
      consensus += (result.T_target_source * p - q).norm() <= 0.25 ? 1 : 0;
    }
    CHECK(result.consensus == consensus);
    CHECK(result.putative_ratio == doctest::Approx(consensus / 400.0));
    const Overlap overlap = measure_overlap(made.source, KdTree<float>(made.target), result.T_target_source, 0.25);
    CHECK(result.inliers == overlap.inliers);
    CHECK(result.fitness_source == overlap.share_of_source);
    CHECK(result.fitness_target == overlap.share_of_target);
    CHECK(result.inlier_rmse == overlap.rmse);
  }

  TEST_CASE("fitting again to all that agree brings the pose nearer") {
    double once = 0, again = 0;
    for_all(20, [&](Rng& rng, int) {
      const MatchedScene made = scene(rng, 300, 0.5, 0.1);
      once += translation_error(
          made.truth, align({.max_distance = 0.5, .local_optimization = {.rounds = 0}}, made).T_target_source);
      again += translation_error(made.truth, align({.max_distance = 0.5}, made).T_target_source);
    });
    CHECK(again < 0.5 * once);
  }

  THREADS_TEST_CASE("registration/ransac", "the same bits on one, two and four threads; another seed, another way") {
    for_all(10, [](Rng& rng, int) {
      const MatchedScene made = scene(rng, 500, 0.85, 0.1);
      const KdTree<float> target(made.target);
      const Ransac ransac{.max_distance = 0.3, .seed = rng.bits()};
      const GlobalAlignResult serial = ransac.align(made.source, target, made.matches);
      for (const Index threads : {1, 2, 4}) {
        const GlobalAlignResult parallel = ransac.align(made.source, target, made.matches, ThreadPool(threads));
        CHECK(parallel.T_target_source == serial.T_target_source);
        CHECK(parallel.consensus == serial.consensus);
        CHECK(parallel.iterations == serial.iterations);
        CHECK(parallel.fitness_target == serial.fitness_target);
        CHECK(parallel.inlier_rmse == serial.inlier_rmse);
      }
      const Ransac other{.max_distance = 0.3, .seed = ransac.seed + 1, .local_optimization = {.rounds = 0}};
      CHECK(!(other.align(made.source, target, made.matches).T_target_source == serial.T_target_source));
    });
  }

  TEST_CASE(
      "giving up early changes nothing where it is bounded, and little "
      "by the sequential test") {
    int same = 0;
    for_all(20, [&same](Rng& rng, int) {
      const MatchedScene made = scene(rng, 600, 0.85, 0.05);
      const KdTree<float> target(made.target);
      const BasicRansac<Refit, NoBailOut> whole{.max_distance = 0.3, .seed = rng.bits()};
      const BasicRansac<Refit, BoundedScoring> bounded{.max_distance = 0.3, .seed = whole.seed};
      const BasicRansac<Refit, SequentialTest> tested{.max_distance = 0.3, .seed = whole.seed};
      const GlobalAlignResult expected = whole.align(made.source, target, made.matches);
      const GlobalAlignResult result = bounded.align(made.source, target, made.matches);
      CHECK(result.T_target_source == expected.T_target_source);
      CHECK(result.iterations == expected.iterations);
      const GlobalAlignResult guessed = tested.align(made.source, target, made.matches);
      REQUIRE(guessed.found());
      CHECK(translation_error(made.truth, guessed.T_target_source) < 0.1);
      same += guessed.T_target_source == expected.T_target_source ? 1 : 0;
    });
    CHECK(same >= 10);
    // Of 64 matches, none agree: 64 log(0.99 / 0.9) = 6.1 exceeds -log 0.01
    // = 4.6; of 40, it is 3.8.
    const SequentialTest test;
    CHECK(test.give_up(64, 1000, 0, 0, 1, 0));
    CHECK(!test.give_up(40, 1000, 0, 0, 1, 0));
    CHECK(!test.give_up(64, 1000, 5, 5, 1, 0));
    CHECK(BoundedScoring{}.give_up(90, 100, 40, 40, 1, 50));
    CHECK(!BoundedScoring{}.give_up(89, 100, 40, 40, 1, 50));
  }

  TEST_CASE("a deadline that has passed ends the search with the best so far") {
    Rng rng(8);
    const MatchedScene made = scene(rng, 400, 1.0, 0.0);  // else all hypotheses are tried
    const Deadline passed = Deadline::in(std::chrono::nanoseconds(0));
    const GlobalAlignResult result =
        Ransac{.max_distance = 0.05}.align(made.source, KdTree<float>(made.target), made.matches, Serial{}, passed);
    CHECK(result.iterations < 1000);
    CHECK(result.status == GlobalAlignStatus::no_consensus);
  }

  TEST_CASE("matches that agree on nothing, or on a line, are no consensus") {
    Rng rng(5);
    const MatchedScene wrong = scene(rng, 200, 1.0, 0.0);
    const GlobalAlignResult result = align({.max_distance = 0.05}, wrong);
    CHECK(result.status == GlobalAlignStatus::no_consensus);
    CHECK(result.T_target_source == SE3d());
    CHECK(result.fitness_target == 0);
    CHECK(result.iterations == 10'000);

    MatchedScene line;
    for (Index i = 0; i < 50; ++i) {
      line.source.positions.emplace_back(static_cast<float>(i), 0.0F, 0.0F);
      line.target.positions.emplace_back(0.0F, static_cast<float>(i), 0.0F);
      line.matches.push_back({i, i});
    }
    CHECK(align({}, line).status == GlobalAlignStatus::no_consensus);
    for (Eigen::Vector3f& p : line.target.positions) p.setOnes();
    CHECK(align({}, line).status == GlobalAlignStatus::no_consensus);
    for (Eigen::Vector3f& p : line.source.positions) p.setOnes();
    CHECK(align({}, line).status == GlobalAlignStatus::no_consensus);
  }

  TEST_CASE("fewer than three matches, or NaN in them, are too few") {
    Rng rng(6);
    MatchedScene made = scene(rng, 50, 0.0, 0.0);
    made.matches.resize(2);
    CHECK(align({}, made).status == GlobalAlignStatus::too_few_matches);
    made.matches.clear();
    CHECK(align({}, made).status == GlobalAlignStatus::too_few_matches);
    MatchedScene holes = scene(rng, 50, 0.0, 0.0);
    for (std::size_t i = 0; i < 48; ++i) holes.source.positions[i].setConstant(std::numeric_limits<float>::quiet_NaN());
    const GlobalAlignResult result = align({}, holes);
    CHECK(result.status == GlobalAlignStatus::too_few_matches);
    CHECK(result.matches == 2);
  }

  TEST_CASE("a caller's mistakes are thrown at the door") {
    Rng rng(7);
    MatchedScene made = scene(rng, 50, 0.0, 0.0);
    CHECK_THROWS_AS((void)align({.max_distance = 0}, made), std::invalid_argument);
    CHECK_THROWS_AS((void)align({.edge_length_ratio = 1.1}, made), std::invalid_argument);
    CHECK_THROWS_AS((void)align({.max_iterations = 0}, made), std::invalid_argument);
    CHECK_THROWS_AS((void)align({.confidence = 1.0}, made), std::invalid_argument);
    made.matches.push_back({50, 0});
    CHECK_THROWS_AS((void)align({}, made), std::invalid_argument);
    made.matches.back() = {-1, 0};
    CHECK_THROWS_AS((void)align({}, made), std::invalid_argument);
  }
}

}  // namespace chainslam::test
