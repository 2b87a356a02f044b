#include "chainslam/registration/feature_registration.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <numbers>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "registration/scenes.hpp"
#include "support/numbers.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

static_assert(GlobalRegistration<FeatureRegistration<>, std::vector<Eigen::Vector3d>, PointCloud<float>>);
static_assert(!GlobalRegistration<Ransac, PointCloud<float>, PointCloud<float>>);
struct Nothing {};
static_assert(ConsensusEstimator<Ransac> && !ConsensusEstimator<Nothing>);

/// For a yard 20 m wide. It is bare: of twenty matches one is right, which takes more than the usual hypotheses.
FeatureRegistration<> small_scale() {
  return {.voxel_size = 0.4,
          .normals = {.neighbors = 30, .radius = 0.8},
          .features = {.radius = 2.0},
          .estimator = {.max_distance = 0.4, .max_iterations = 100'000}};
}

/// Points of the yard with noise of 2 cm, in the frame of a sensor that stands there.
PointCloud<float> view(Rng& rng, const SE3d& T_yard_sensor, Index count) {
  return seen_from(sample(rng, yard(), count, 0.02), T_yard_sensor);
}

/// A stand in the yard, turned by any angle about the vertical and tilted a little.
SE3d stand(Rng& rng) {
  return SE3d(SO3d::exp(Eigen::Vector3d(rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(-3, 3))),
              Eigen::Vector3d(rng.uniform(-6, 0), rng.uniform(-3, 3), 1.5));
}

}  // namespace

TEST_SUITE("registration/feature_registration") {
  TEST_CASE("aligns two views of a yard without a guess, in the direction that its name says") {
    for_all(10, [](Rng& rng, int) {
      const SE3d T_yard_source = stand(rng), T_yard_target = stand(rng);
      const SE3d truth = T_yard_target.inverse() * T_yard_source;
      const GlobalAlignResult result =
          small_scale().align(view(rng, T_yard_source, 8000), view(rng, T_yard_target, 8000));
      REQUIRE(result.status == GlobalAlignStatus::found);
      CHECK(translation_error(truth, result.T_target_source) < 0.3);
      CHECK(rotation_error(truth, result.T_target_source) < 2 * degree);
      CHECK(result.fitness_source > 0.9);
      CHECK(result.fitness_target > 0.9);
    });
  }

  THREADS_TEST_CASE("registration/feature_registration",
                    "described once or in one go, on one thread or four: the same bits") {
    Rng rng(2);
    const PointCloud<float> source = view(rng, stand(rng), 6000), target = view(rng, stand(rng), 6000);
    const FeatureRegistration<> registration = small_scale();
    const GlobalAlignResult result = registration.align(source, target);
    const GlobalAlignResult described =
        registration.align(registration.describe(source), registration.describe(target));
    CHECK(described.T_target_source == result.T_target_source);
    for (const Index threads : {1, 2, 4}) {
      const GlobalAlignResult parallel = registration.align(source, target, ThreadPool(threads));
      CHECK(parallel.T_target_source == result.T_target_source);
      CHECK(parallel.matches == result.matches);
      CHECK(parallel.fitness_target == result.fitness_target);
    }
  }

  TEST_CASE("normals that come with the points say which side was seen") {
    Rng rng(3);
    PointCloud<float> cloud = sample(rng, {yard().front()}, 4000, 0.01);  // a floor through the frame's origin
    for (std::size_t i = 0; i < cloud.size(); ++i) cloud.normals[i] = {0, 0, cloud.positions[i].x() < 0 ? 1.0F : -1.0F};
    const DescribedCloud described = small_scale().describe(cloud);
    for (std::size_t i = 0; i < described.cloud.cloud().size(); ++i) {
      const Eigen::Vector3f& p = described.cloud.cloud().positions[i];
      if (std::abs(p.x()) < 0.3F) continue;  // voxels that hold both
      CHECK(described.cloud.cloud().normals[i].z() * p.x() < 0);
    }
  }

  TEST_CASE("a share of the target is overlapped by a smaller source") {
    Rng rng(4);
    const SE3d T_yard_source = stand(rng), T_yard_target = stand(rng);
    const PointCloud<float> all = sample(rng, yard(), 16000, 0.02);
    PointCloud<float> half;
    for (const Eigen::Vector3f& p : all.positions)
      if (p.x() < 2) half.positions.push_back(p);
    const GlobalAlignResult result = small_scale().align(seen_from(half, T_yard_source), seen_from(all, T_yard_target));
    REQUIRE(result.status == GlobalAlignStatus::found);
    CHECK(translation_error(T_yard_target.inverse() * T_yard_source, result.T_target_source) < 0.4);
    CHECK(result.fitness_source > 0.95);
    CHECK(result.fitness_target < 0.8);
    CHECK(result.fitness_target > 0.4);
  }

  TEST_CASE("a bare plane is no place to be found on, and nothing at all says so") {
    Rng rng(5);
    const PointCloud<float> plane = sample(rng, {yard().front()}, 5000);
    const FeatureRegistration<> registration = small_scale();
    const SE3d high(SO3d(), Eigen::Vector3d(0, 0, 2));
    const GlobalAlignResult flat = registration.align(seen_from(plane, high), seen_from(plane, high));
    CHECK(is_finite(flat.T_target_source.matrix()));
    PointCloud<float> nan;
    nan.positions.assign(50, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
    for (const PointCloud<float>& nothing : {PointCloud<float>{}, nan}) {
      CHECK(registration.align(nothing, plane).status == GlobalAlignStatus::too_few_points);
      CHECK(registration.align(plane, nothing).status == GlobalAlignStatus::too_few_points);
    }
    PointCloud<float> lone;  // points too far from each other for normals
    for (int i = 0; i < 50; ++i) lone.positions.emplace_back(static_cast<float>(10 * i), 0.0F, 0.0F);
    CHECK(registration.align(lone, plane).status == GlobalAlignStatus::too_few_matches);
  }
}

}  // namespace chainslam::test
