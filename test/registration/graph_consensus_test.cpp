#include "chainslam/registration/graph_consensus.hpp"

#include <doctest/doctest.h>

#include <chrono>
#include <limits>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/registration/gnc.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "registration/scenes.hpp"
#include "support/numbers.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

/// Points in a yard with normals, the same seen from elsewhere with noise, and
/// matches of which some are wrong.
struct OrientedMatches {
  PointCloud<float> source, target;
  std::vector<FeatureMatch> matches;
  SE3d truth;
};

OrientedMatches oriented_matches(Rng& rng, Index count, double wrong_share, const SE3d& truth) {
  OrientedMatches made{.source = {}, .target = sample(rng, yard(), count), .matches = {}, .truth = truth};
  made.source = seen_from(made.target, truth);
  for (Eigen::Vector3f& p : made.source.positions)
    p += 0.05F * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).cast<float>();
  const SO3d R_source_target = truth.rotation().inverse();
  for (const Eigen::Vector3f& n : made.target.normals)
    made.source.normals.push_back((R_source_target * n.cast<double>().eval()).cast<float>());
  for (Index i = 0; i < count; ++i) made.matches.push_back({i, i < wrong_share * count ? rng.uniform_index(count) : i});
  return made;
}

SE3d far_motion(Rng& rng) { return random_motion(rng, 30, 2); }

GraphConsensus<> yard_scale() {
  return {.consistency = {.max_stretch = 0.3}, .max_distance = 0.3, .gnc = {.noise_bound = 0.2}};
}

}  // namespace

TEST_SUITE("registration/gnc") {
  TEST_CASE(
      "finds the motion among seven wrong pairs of ten, and says which "
      "are right") {
    for_all(20, [](Rng& rng, int) {
      const SE3d truth = far_motion(rng);
      std::vector<Eigen::Vector3d> source, target;
      for (int i = 0; i < 100; ++i) {
        source.emplace_back(rng.uniform(-20, 20), rng.uniform(-20, 20), rng.uniform(-3, 3));
        const Eigen::Vector3d noise(rng.normal(), rng.normal(), rng.normal());
        target.push_back(i < 70 ? Eigen::Vector3d(truth * source[0] + 20 * noise)
                                : Eigen::Vector3d(truth * source.back() + 0.02 * noise));
      }
      const std::optional<GncResult> result = GncTls<>{.noise_bound = 0.2}.solve(source, target);
      REQUIRE(result);
      CHECK(translation_error(truth, result->T_target_source) < 0.05);
      CHECK(rotation_error(truth, result->T_target_source) < 0.2 * degree);
      CHECK(result->inliers == 30);
      for (std::size_t i = 0; i < 100; ++i) CHECK((result->weights[i] >= 0.5) == (i >= 70));
    });
  }

  TEST_CASE(
      "with only right pairs it is plain least squares; upright, the "
      "heading alone is found") {
    const SE3d upright(SO3d::exp(Eigen::Vector3d(0, 0, 2.5)), Eigen::Vector3d(4, -3, 1));
    std::vector<Eigen::Vector3d> source{{0, 0, 0}, {1, 5, 2}, {-3, 2, 1}, {4, 4, -2}}, target;
    for (const Eigen::Vector3d& p : source) target.push_back(upright * p);
    CHECK(GncTls<>{}.solve(source, target)->iterations == 0);
    CHECK(translation_error(upright, GncTls<>{}.solve(source, target)->T_target_source) < 1e-9);
    CHECK(translation_error(upright, GncTls<YawOnly>{}.solve(source, target)->T_target_source) < 1e-9);
    // Two pairs do for a heading, and a tilt in the points does not become one
    // of the answer.
    const std::vector<Eigen::Vector3d> tilted{target[0], target[1] + Eigen::Vector3d(0, 0, 0.4)};
    const std::optional<GncResult> two = GncTls<YawOnly>{}.solve(std::span(source).first(2), tilted);
    REQUIRE(two);
    CHECK(rotation_error(upright, two->T_target_source) < 1e-9);
    CHECK(!GncTls<>{}.solve(std::span(source).first(2), std::span(target).first(2)));
  }

  TEST_CASE(
      "what does not tell a motion gives none, and mistakes are thrown "
      "at the door") {
    const std::vector<Eigen::Vector3d> line{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}, place(3, Eigen::Vector3d(1, 1, 1));
    CHECK(!GncTls<>{}.solve(line, line));
    CHECK(!GncTls<>{}.solve(place, place));
    CHECK(!GncTls<YawOnly>{}.solve(place, place));
    CHECK(!GncTls<>{}.solve({}, {}));
    CHECK_THROWS_AS((void)GncTls<>{}.solve(line, std::span(line).first(2)), std::invalid_argument);
    CHECK_THROWS_AS((void)GncTls<>{.noise_bound = 0}.solve(line, line), std::invalid_argument);
    CHECK_THROWS_AS((void)GncTls<>{.factor = 1}.solve(line, line), std::invalid_argument);
  }
}

TEST_SUITE("registration/graph_consensus") {
  TEST_CASE(
      "finds T_target_source among as many as nineteen wrong matches of "
      "twenty, by clique or core") {
    for (const double wrong : {0.0, 0.5, 0.9, 0.95}) {
      CAPTURE(wrong);
      for_all(6, [wrong](Rng& rng, int) {
        const OrientedMatches made = oriented_matches(rng, 800, wrong, far_motion(rng));
        const IndexedCloud<> target(made.target);
        for (const Pruning pruning : {Pruning::clique, Pruning::core}) {
          GraphConsensus<> graph = yard_scale();
          graph.pruning = pruning;
          const GlobalAlignResult result = graph.align(made.source, target, made.matches);
          REQUIRE(result.found());
          const double slack = wrong < 0.95 ? 1 : 2;  // forty right ones tell a motion less well than eighty
          CHECK(translation_error(made.truth, result.T_target_source) < slack * 0.08);
          CHECK(rotation_error(made.truth, result.T_target_source) < slack * 0.5 * degree);
          CHECK(result.matches == 800);
          CHECK(result.putative_ratio > 0.97 - wrong);
          CHECK(result.fitness_source > 0.98);
        }
      });
    }
  }

  THREADS_TEST_CASE("registration/graph_consensus",
                    "swapped, it gives the inverse; the same bits on one, two and "
                    "eight threads") {
    for_all(6, [](Rng& rng, int) {
      const OrientedMatches made = oriented_matches(rng, 500, 0.8, asymmetric_pose());
      std::vector<FeatureMatch> swapped;
      for (const FeatureMatch& match : made.matches) swapped.push_back({match.target, match.source});
      const IndexedCloud<> source(made.source), target(made.target);
      const GlobalAlignResult forth = yard_scale().align(made.source, target, made.matches);
      const GlobalAlignResult back = yard_scale().align(made.target, source, swapped);
      CHECK(translation_error(SE3d(), forth.T_target_source * back.T_target_source) < 1e-3);
      CHECK(rotation_error(SE3d(), forth.T_target_source * back.T_target_source) < 1e-3);
      for (const Index threads : {1, 2, 8}) {
        const GlobalAlignResult result = yard_scale().align(made.source, target, made.matches, ThreadPool(threads));
        CHECK(result.T_target_source == forth.T_target_source);
        CHECK(result.consensus == forth.consensus);
        CHECK(result.inlier_rmse == forth.inlier_rmse);
      }
    });
  }

  TEST_CASE(
      "two motions that matches speak for are both found, the one that "
      "more speak for first") {
    Rng rng(3);
    OrientedMatches made = oriented_matches(rng, 300, 0.0, asymmetric_pose());
    const SE3d other = far_motion(rng);
    MatchedPoints points = gather_matches(made.source, IndexedCloud<>(made.target), made.matches, "test");
    points.source_normals.clear();
    points.target_normals.clear();
    for (std::size_t i = 0; i < 100; ++i) points.target[i] = other * points.source[i];
    const std::vector<Hypothesis> found = yard_scale().hypotheses(points, 3);
    REQUIRE(found.size() >= 2);
    CHECK(translation_error(made.truth, found[0].T_target_source) < 0.05);
    CHECK(translation_error(other, found[1].T_target_source) < 0.05);
    CHECK(found[0].consensus >= 200);
    CHECK(found[1].consensus >= 95);
    CHECK(found[0].gain > found[1].gain);
    CHECK(yard_scale().hypotheses(points, 3, Serial{}, Deadline::in(std::chrono::nanoseconds(0))).size() == 1);
  }

  TEST_CASE("upright clouds: a handful of matches among many tells the heading") {
    for_all(5, [](Rng& rng, int) {
      const SE3d upright(SO3d::exp(Eigen::Vector3d(0, 0, rng.uniform(-3, 3))), Eigen::Vector3d(5, -8, 1));
      const OrientedMatches made = oriented_matches(rng, 600, 0.95, upright);
      const GraphConsensus<YawOnly> graph{
          .consistency = {.max_stretch = 0.3}, .max_distance = 0.3, .gnc = {.noise_bound = 0.2}};
      const GlobalAlignResult result = graph.align(made.source, IndexedCloud<>(made.target), made.matches);
      REQUIRE(result.found());
      CHECK(translation_error(upright, result.T_target_source) < 0.1);
      const Eigen::Vector3d up = result.T_target_source.rotation() * Eigen::Vector3d::UnitZ().eval();
      CHECK((up - Eigen::Vector3d::UnitZ()).norm() < 1e-9);
    });
  }

  TEST_CASE(
      "matches in one place, on a line, mirrored, wrong, NaN or none: a "
      "status, and the identity") {
    Rng rng(4);
    OrientedMatches made = oriented_matches(rng, 200, 0.0, asymmetric_pose());
    const auto status = [&made] {
      const GlobalAlignResult result = yard_scale().align(made.source, IndexedCloud<>(made.target), made.matches);
      if (!result.found()) CHECK(result.T_target_source == SE3d());
      return result.status;
    };
    OrientedMatches whole = made;
    for (Eigen::Vector3f& p : made.source.positions) p = {1, 2, 3};  // duplicates
    CHECK(status() == GlobalAlignStatus::no_consensus);
    made = whole;
    made.source.normals.clear();
    for (std::size_t i = 0; i < 200; ++i) {  // a mirror image, which no rotation undoes
      const Eigen::Vector3d p(rng.uniform(-10, 10), rng.uniform(-10, 10), rng.uniform(-10, 10));
      made.target.positions[i] = p.cast<float>();
      made.source.positions[i] = {-made.target.positions[i].x(), made.target.positions[i].y(),
                                  made.target.positions[i].z()};
    }
    CHECK(status() == GlobalAlignStatus::no_consensus);
    made = whole;
    for (std::size_t i = 0; i < 200; ++i) {
      made.source.positions[i] = {static_cast<float>(i), 0, 0};
      made.target.positions[i] = {0, static_cast<float>(i), 0};
    }
    CHECK(status() == GlobalAlignStatus::no_consensus);
    made = oriented_matches(rng, 200, 1.0, asymmetric_pose());
    CHECK(status() == GlobalAlignStatus::no_consensus);
    made = whole;
    for (Eigen::Vector3f& p : made.source.positions) p.setConstant(std::numeric_limits<float>::quiet_NaN());
    CHECK(status() == GlobalAlignStatus::too_few_matches);
    made.matches.clear();
    CHECK(status() == GlobalAlignStatus::too_few_matches);
    made.matches = {{200, 0}};
    CHECK_THROWS_AS((void)status(), std::invalid_argument);
  }

  TEST_CASE("of too many matches the ones that stand out are taken") {
    Rng rng(5);
    OrientedMatches made = oriented_matches(rng, 600, 0.5, asymmetric_pose());
    for (std::size_t i = 0; i < 600; ++i) made.matches[i].ratio = i < 300 ? 0.9F : 0.5F;  // the right ones
    GraphConsensus<> graph = yard_scale();
    graph.max_matches = 300;
    const GlobalAlignResult result = graph.align(made.source, IndexedCloud<>(made.target), made.matches);
    CHECK(result.matches == 300);
    CHECK(result.putative_ratio > 0.95);
  }
}

}  // namespace chainslam::test
