#include "chainslam/registration/verified_registration.hpp"

#include <doctest/doctest.h>

#include <chrono>
#include <limits>
#include <string>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "registration/scenes.hpp"
#include "support/numbers.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

/// Voxels of 0.3 m in a yard 20 m wide.
VerifiedRegistration<> yard_registration() {
  VerifiedRegistration<> registration;
  registration.features = {
      .voxel_size = 0.3,
      .normals = {.neighbors = 0, .radius = 0.9},
      .features = {.radius = 1.8, .max_neighbors = 0},
      .estimator = {.consistency = {.max_stretch = 0.3}, .max_distance = 0.45, .gnc = {.noise_bound = 0.3}}};
  registration.check.max_distance = 0.45;
  return registration;
}

/// What a sensor 1.5 m above the yard's floor at some place sees: each side of
/// a surface is told by where it stands.
PointCloud<float> seen_yard(Rng& rng, const SE3d& T_yard_sensor, Index count = 9000) {
  return seen_from(sample(rng, yard(), count, 0.02), T_yard_sensor);
}

SE3d any_stand(Rng& rng) {
  return SE3d(SO3d::exp(Eigen::Vector3d(rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(-3, 3))),
              Eigen::Vector3d(rng.uniform(-6, 0), rng.uniform(-3, 3), 1.5));
}

}  // namespace

TEST_SUITE("registration/verifier") {
  TEST_CASE(
      "the true pose is accepted; others are refused for the reason that "
      "is theirs") {
    Rng rng(1);
    const VerifiedRegistration<> registration = yard_registration();
    const SE3d T_yard_target(SO3d(), Eigen::Vector3d(-3, 0, 1.5)), T_yard_source(SO3d(), Eigen::Vector3d(-2, 1, 1.5));
    const DescribedCloud source = registration.describe(seen_yard(rng, T_yard_source));
    const DescribedCloud target = registration.describe(seen_yard(rng, T_yard_target));
    const SE3d truth = T_yard_target.inverse() * T_yard_source;
    const auto check = [&](const SE3d& T) { return registration.check.verify(source.cloud.cloud(), target.cloud, T); };
    const Verification right = check(truth);
    CHECK(right.accepted());
    CHECK(right.share_of_smaller > 0.95);
    CHECK(right.plane_rmse < 0.06);
    CHECK(right.aligned_normals > 0.9);
    CHECK(right.in_view == 0);  // nobody said from where it was seen
    CHECK(check(SE3d(SO3d(), Eigen::Vector3d(100, 0, 0))).refusal == Refusal::low_overlap);
    const SE3d raised(SO3d(), truth.translation() + Eigen::Vector3d(0, 0, 0.35));
    CHECK(check(raised).refusal == Refusal::high_residual);
    // Upside down in the plane of the floor: it fits, but the floor's normals
    // look down.
    const SE3d over(SO3d::exp(Eigen::Vector3d(std::numbers::pi, 0, 0)), Eigen::Vector3d(0, 0, -3));
    CHECK(check(over).refusal == Refusal::turned_normals);
    CHECK(std::string(to_string(Refusal::seen_through)).find("saw through") != std::string::npos);
  }

  TEST_CASE(
      "points where the other sensor saw through speak against a pose, "
      "behind what it saw they do not") {
    // The target sees a wall 10 m ahead. The source's wall, put at 5 m, stands
    // in the target's way; at 15 m it is hidden.
    const auto wall = [](float distance) {
      PointCloud<float> cloud;
      for (int y = -20; y <= 20; ++y)
        for (int z = -5; z <= 5; ++z)
          cloud.positions.emplace_back(distance, 0.3F * static_cast<float>(y), 0.3F * static_cast<float>(z));
      return cloud;
    };
    const Verifier verifier{.max_distance = 30, .max_plane_rmse = 30};
    const IndexedCloud<> target(wall(10));
    const auto through = [&](double moved) {
      return verifier.verify(wall(10), target, SE3d(SO3d(), Eigen::Vector3d(moved, 0, 0)), Viewpoints{});
    };
    CHECK(through(0).accepted());
    CHECK(through(0).seen_through == 0);
    CHECK(through(0).in_view > 700);
    CHECK(through(-5).refusal == Refusal::seen_through);
    CHECK(through(-5).seen_through > 0.1);
    const Verification behind =
        verifier.verify(wall(15), target, SE3d(), Viewpoints{.source = {13, 0, 0}, .target = {0, 0, 0}});
    CHECK(behind.accepted());
  }

  THREADS_TEST_CASE("registration/verifier",
                    "any number of threads gives the same figures; empty clouds are "
                    "refused, mistakes thrown") {
    Rng rng(2);
    const PointCloud<float> source = sample(rng, yard(), 3000);
    const IndexedCloud<> target(sample(rng, yard(), 3000));
    const Verification expected = Verifier{}.verify(source, target, SE3d(), Viewpoints{});
    for (const Index threads : quick() ? std::vector<Index>{2} : std::vector<Index>{1, 2, 8}) {
      const Verification result = Verifier{}.verify(source, target, SE3d(), Viewpoints{}, ThreadPool(threads));
      CHECK(result.plane_rmse == expected.plane_rmse);
      CHECK(result.aligned_normals == expected.aligned_normals);
      CHECK(result.seen_through == expected.seen_through);
    }
    CHECK(Verifier{}.verify(PointCloud<float>{}, target, SE3d()).refusal == Refusal::low_overlap);
    CHECK(Verifier{}.verify(source, IndexedCloud<>{}, SE3d(), Viewpoints{}).refusal == Refusal::low_overlap);
    CHECK_THROWS_AS((void)Verifier{.view_cell = 0}.verify(source, target, SE3d()), std::invalid_argument);
    CHECK_THROWS_AS((void)Verifier{.max_distance = 0}.verify(source, target, SE3d()), std::invalid_argument);
  }
}

TEST_SUITE("registration/verified_registration") {
  THREADS_TEST_CASE("registration/verified_registration",
                    "aligns two views of a yard to centimetres, in the direction that "
                    "its name says, and back") {
    for_all(6, [](Rng& rng, int) {
      const SE3d T_yard_source = any_stand(rng), T_yard_target = any_stand(rng);
      const SE3d truth = T_yard_target.inverse() * T_yard_source;
      const VerifiedRegistration<> registration = yard_registration();
      const DescribedCloud source = registration.describe(seen_yard(rng, T_yard_source));
      const DescribedCloud target = registration.describe(seen_yard(rng, T_yard_target));
      const GlobalAlignResult forth = registration.align(source, target), back = registration.align(target, source);
      REQUIRE(forth.status == GlobalAlignStatus::found);
      REQUIRE(back.status == GlobalAlignStatus::found);
      CHECK(translation_error(truth, forth.T_target_source) < 0.05);
      CHECK(rotation_error(truth, forth.T_target_source) < 0.3 * degree);
      CHECK(translation_error(SE3d(), forth.T_target_source * back.T_target_source) < 0.06);
      CHECK(rotation_error(SE3d(), forth.T_target_source * back.T_target_source) < 0.4 * degree);
      CHECK(forth.fitness_source > 0.9);
      for (const Index threads : {1, 2, 8}) {
        const GlobalAlignResult parallel = registration.align(source, target, ThreadPool(threads));
        CHECK(parallel.T_target_source == forth.T_target_source);
        CHECK(parallel.inlier_rmse == forth.inlier_rmse);
        CHECK(parallel.consensus == forth.consensus);
      }
    });
  }

  TEST_CASE(
      "another place, a bare plane, NaN or nothing is not found, and a "
      "refused pose says why") {
    Rng rng(4);
    const VerifiedRegistration<> registration = yard_registration();
    const PointCloud<float> here = seen_yard(rng, any_stand(rng));
    const PointCloud<float> plane = seen_from(sample(rng, {yard().front()}, 5000), any_stand(rng));
    CHECK(!registration.align(plane, here).found());
    PointCloud<float> nan;
    nan.positions.assign(50, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
    for (const PointCloud<float>& nothing : {PointCloud<float>{}, nan}) {
      CHECK(registration.align(nothing, here).status == GlobalAlignStatus::too_few_points);
      CHECK(registration.align(here, nothing).status == GlobalAlignStatus::too_few_points);
    }
    VerifiedRegistration<> strict = registration;
    strict.check.max_plane_rmse = 1e-6;
    const DescribedCloud source = strict.describe(here), target = strict.describe(here);
    const GlobalAlignResult refused = strict.align(source, strict.describe(seen_yard(rng, any_stand(rng))));
    CHECK(refused.status == GlobalAlignStatus::refused);
    CHECK(refused.inliers > 0);
    const std::vector<VerifiedPose> same = strict.candidates(source, target);
    REQUIRE(!same.empty());
    CHECK(same.front().verification.accepted());  // the very same cloud: no
                                                  // residual at all
  }

  TEST_CASE("a deadline that has passed gives no pose, and says so") {
    Rng rng(5);
    const VerifiedRegistration<> registration = yard_registration();
    const DescribedCloud cloud = registration.describe(seen_yard(rng, any_stand(rng)));
    const GlobalAlignResult result =
        registration.align(cloud, cloud, Serial{}, Deadline::in(std::chrono::nanoseconds(0)));
    CHECK(result.status == GlobalAlignStatus::cancelled);
    CHECK(result.T_target_source == SE3d());
  }
}

}  // namespace chainslam::test
