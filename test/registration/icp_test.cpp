#include "chainslam/registration/icp.hpp"

#include <doctest/doctest.h>

#include <limits>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/lie/jacobians.hpp"
#include "chainslam/registration/align.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "registration/scenes.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

/// A user's metric: height alone.
struct HeightOnly {
  template <NearestNeighborSearch Target>
  PairError<1> error(const Target& target, Index match, const Eigen::Vector3d& p_target) const {
    return {Eigen::Matrix<double, 1, 1>(p_target.z() - target.position(match)[2]), Eigen::RowVector3d::UnitZ()};
  }
};

static_assert(Registration<PointToPlaneIcp, PointCloud<float>, IndexedCloud<>>);
static_assert(Registration<PointToPointIcp, std::vector<Eigen::Vector3d>, KdTree<float>>);
static_assert(ErrorMetric<HeightOnly, KdTree<float>> && !ErrorMetric<PointToPlane, KdTree<float>>);
static_assert(!SurfaceMetric<HeightOnly> && !AlignTarget<std::vector<Eigen::Vector3f>>);

const IndexedCloud<>& yard_target() {
  static const IndexedCloud<> target = [] {
    Rng rng(1);
    return IndexedCloud<>(sample(rng, yard(), 8000));
  }();
  return target;
}

}  // namespace

TEST_SUITE("registration/icp") {
  TEST_CASE("finds T_target_source, which maps source to target, not its inverse") {
    Rng rng(2);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 3000, 0.01), truth);
    const SE3d guess = truth * random_motion(rng, 0.3, 0.03);
    const AlignResult result = PointToPlaneIcp{}.align(source, yard_target(), guess);
    CHECK(result.status == AlignStatus::converged);
    CHECK(result.degenerate_directions == 0);
    // 3000 points with 1 cm: 1 cm / sqrt(3000 * eigenvalue 0.05) = 0.8 mm.
    CHECK(translation_error(truth, result.T_target_source) < 0.004);
    CHECK(rotation_error(truth, result.T_target_source) < 0.001);
    CHECK(translation_error(truth.inverse(), result.T_target_source) > 1.0);
  }

  TEST_CASE("recovers random motions: to planes from 0.5 m and 5 degrees away") {
    for_all(20, [](Rng& rng, int) {
      const SE3d truth = random_motion(rng, 2.0, 1.0);
      const PointCloud<float> source = seen_from(sample(rng, yard(), 1500, 0.01), truth);
      const AlignResult result =
          PointToPlaneIcp{.max_distance = 1.5}.align(source, yard_target(), truth * random_motion(rng, 0.3, 0.05));
      CHECK(result.status == AlignStatus::converged);
      CHECK(translation_error(truth, result.T_target_source) < 0.008);
      CHECK(rotation_error(truth, result.T_target_source) < 0.002);
      CHECK(result.inlier_ratio > 0.99);
      CHECK(std::sqrt(result.mean_squared_residual) == doctest::Approx(0.01).epsilon(0.1));
    });
  }

  TEST_CASE("to points: the same cloud moved comes back to rounding, the mean squared error falls to zero") {
    for_all(10, [](Rng& rng, int) {
      const SE3d truth = random_motion(rng, 2.0, 1.0);
      const KdTree<float> target(yard_target().cloud());
      const PointCloud<float> source = seen_from(yard_target().cloud(), truth);
      const AlignResult result = PointToPointIcp{}.align(source, target, truth * random_motion(rng, 0.1, 0.01));
      CHECK(result.status == AlignStatus::converged);
      CHECK(translation_error(truth, result.T_target_source) < 1e-5);
      CHECK(rotation_error(truth, result.T_target_source) < 1e-6);
      CHECK(result.mean_squared_error < 1e-10);
      CHECK(result.inlier_ratio == 1.0);
    });
  }

  TEST_CASE("to points, too, the pose maps source to target, not target to source") {
    Rng rng(15);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(yard_target().cloud(), truth);
    const KdTree<float> target(yard_target().cloud());
    const AlignResult result = PointToPointIcp{}.align(source, target, truth * random_motion(rng, 0.1, 0.01));
    CHECK(result.status == AlignStatus::converged);
    for (std::size_t i = 0; i < source.size(); ++i)
      REQUIRE((result.T_target_source * position(source, i) - position(yard_target().cloud(), i)).norm() < 1e-4);
    CHECK(translation_error(truth.inverse(), result.T_target_source) > 1.0);
  }

  TEST_CASE("inliers and mean squared error are those that comparing all with all gives") {
    for_all(5, [](Rng& rng, int) {
      const SE3d truth = random_motion(rng, 2.0, 1.0);
      const PointCloud<float> target = sample(rng, yard(), 1500);
      PointCloud<float> seen = sample(rng, yard(), 700, 0.1);
      for (std::size_t i = 0; i < seen.size(); i += 4) seen.positions[i].z() += 3.0F;  // no partner for most of these
      const PointCloud<float> source = seen_from(seen, truth);
      for (const AlignResult& result :
           {PointToPlaneIcp{.max_distance = 0.5}.align(source, IndexedCloud<>(target), truth),
            PointToPointIcp{.max_distance = 0.5}.align(source, KdTree<float>(target), truth)}) {
        Index inliers = 0;
        double squared = 0;
        for (std::size_t i = 0; i < source.size(); ++i) {
          double nearest = std::numeric_limits<double>::infinity();
          for (std::size_t j = 0; j < target.size(); ++j)
            nearest =
                std::min(nearest, (result.T_target_source * position(source, i) - position(target, j)).squaredNorm());
          if (nearest > 0.25) continue;
          ++inliers;
          squared += nearest;
        }
        CHECK(inliers < 600);
        CHECK(result.inliers == inliers);
        CHECK(result.inlier_ratio == doctest::Approx(inliers / 700.0));
        CHECK(result.mean_squared_error == doctest::Approx(squared / inliers).epsilon(1e-5));
      }
    });
  }

  TEST_CASE("figures hold at the pose returned: aligning again from it without a step gives the same") {
    Rng rng(3);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 2000, 0.02), truth);
    const AlignResult result = PointToPlaneIcp{}.align(source, yard_target(), truth * random_motion(rng, 0.2, 0.02));
    const AlignResult again = PointToPlaneIcp{.max_iterations = 0}.align(source, yard_target(), result.T_target_source);
    CHECK(again.status == AlignStatus::iteration_limit);
    CHECK(again.iterations == 0);
    CHECK(again.inliers == result.inliers);
    CHECK(again.mean_squared_error == doctest::Approx(result.mean_squared_error).epsilon(1e-6));
    CHECK((again.hessian - result.hessian).norm() < 1e-6 * result.hessian.norm());
  }

  TEST_CASE("the hessian is J'J of the residuals for a right perturbation of the source's own frame") {
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> all = yard_target().cloud();
    PointCloud<float> few;  // far from their centre and from the origin: the centre must not show in the result
    for (std::size_t i = 0; i < 40; ++i) few.positions.push_back(all.positions[i * 100]);
    const PointCloud<float> source = seen_from(few, truth);
    const AlignResult result = PointToPointIcp{}.align(source, KdTree<float>(all), truth);
    REQUIRE(result.inliers == 40);
    Matrix6d expected = Matrix6d::Zero();
    for (std::size_t i = 0; i < source.size(); ++i) {
      const auto J = numeric_jacobian([&](const SE3d& T) { return Eigen::Vector3d(T * position(source, i)); }, truth);
      expected += J.transpose() * J;
    }
    CHECK((result.hessian - expected).norm() < 1e-6 * expected.norm());
  }

  TEST_CASE("a frame whose origin is a kilometre away does not disturb") {
    Rng rng(5);
    const SE3d T_source_far(SO3d(), Eigen::Vector3d(800, -600, 5));
    const PointCloud<float> local = sample(rng, yard(), 3000, 0.01);
    const PointCloud<float> source = seen_from(local, T_source_far);
    const SE3d guess = random_motion(rng, 0.2, 0.02) * T_source_far;
    const AlignResult result = PointToPlaneIcp{}.align(source, yard_target(), guess);
    CHECK(result.status == AlignStatus::converged);
    for (const Eigen::Vector3f& p : source.positions)
      REQUIRE((result.T_target_source * p.cast<double>().eval() - T_source_far * p.cast<double>().eval()).norm() <
              0.01);
  }

  THREADS_TEST_CASE("registration/icp", "the same bits on one thread, on two and on eight") {
    Rng rng(6);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 5000, 0.02), truth);
    const SE3d guess = truth * random_motion(rng, 0.3, 0.03);
    const AlignResult serial = PointToPlaneIcp{}.align(source, yard_target(), guess);
    for (const Index threads : {1, 2, 8}) {
      const AlignResult parallel = PointToPlaneIcp{}.align(source, yard_target(), guess, ThreadPool(threads));
      CHECK(serial.T_target_source == parallel.T_target_source);
      CHECK(serial.hessian == parallel.hessian);
      CHECK(serial.covariance == parallel.covariance);
      CHECK(serial.mean_squared_error == parallel.mean_squared_error);
      CHECK(serial.iterations == parallel.iterations);
    }
  }

  TEST_CASE("NaN and infinite points are skipped and count for nothing") {
    Rng rng(7);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 2000, 0.01), truth);
    PointCloud<float> holes;
    for (std::size_t i = 0; i < source.size(); ++i) {
      holes.positions.push_back(source.positions[i]);
      if (i % 3 == 0) holes.positions.push_back(Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
      if (i % 7 == 0) holes.positions.push_back(Eigen::Vector3f(0, std::numeric_limits<float>::infinity(), 0));
    }
    const SE3d guess = truth * random_motion(rng, 0.2, 0.02);
    const AlignResult clean = PointToPlaneIcp{}.align(source, yard_target(), guess);
    const AlignResult result = PointToPlaneIcp{}.align(holes, yard_target(), guess);
    CHECK(result.T_target_source == clean.T_target_source);
    CHECK(result.inlier_ratio == clean.inlier_ratio);
  }

  TEST_CASE("target points without a normal tell nothing and do no harm") {
    Rng rng(8);
    PointCloud<float> cloud = sample(rng, yard(), 8000);
    for (std::size_t i = 0; i < cloud.size(); i += 10) cloud.normals[i].setZero();
    for (std::size_t i = 5; i < cloud.size(); i += 10)
      cloud.normals[i].setConstant(std::numeric_limits<float>::quiet_NaN());
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 2000, 0.01), truth);
    const AlignResult result =
        PointToPlaneIcp{}.align(source, IndexedCloud<>(cloud), truth * random_motion(rng, 0.2, 0.02));
    CHECK(result.status == AlignStatus::converged);
    CHECK(translation_error(truth, result.T_target_source) < 0.005);
  }

  TEST_CASE("nothing, and too little, to align: the guess comes back with the reason") {
    const SE3d guess = asymmetric_pose();
    PointCloud<float> few;
    few.positions.assign(5, Eigen::Vector3f(1, 2, 3));
    PointCloud<float> nan;
    nan.positions.assign(50, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
    for (const PointCloud<float>& source : {PointCloud<float>{}, few, nan}) {
      const AlignResult result = PointToPlaneIcp{}.align(source, yard_target(), guess);
      CHECK(result.status == AlignStatus::too_few_points);
      CHECK(result.T_target_source == guess);
    }
    const AlignResult result = PointToPlaneIcp{}.align(yard_target().cloud(), IndexedCloud<>(), guess);
    CHECK(result.status == AlignStatus::too_few_points);
  }

  TEST_CASE("without overlap nothing converges, however small the step") {
    const SE3d guess(SO3d(), Eigen::Vector3d(100, 0, 0));
    for (const double max_distance : {0.1, 1.0, 5.0}) {
      const AlignResult result =
          PointToPlaneIcp{.max_distance = max_distance}.align(yard_target().cloud(), yard_target(), guess);
      CHECK(result.status == AlignStatus::no_overlap);
      CHECK(result.inliers == 0);
      CHECK(result.T_target_source == guess);
      CHECK(result.hessian == Matrix6d::Zero());
    }
    // A sliver of accidental partners is no overlap either.
    const SE3d sliver(SO3d(), Eigen::Vector3d(20.9, 0, 0));
    const AlignResult result = PointToPlaneIcp{}.align(yard_target().cloud(), yard_target(), sliver);
    CHECK_FALSE(result.converged());
  }

  TEST_CASE("points all in one place are degenerate, not converged") {
    PointCloud<float> one_place;
    one_place.positions.assign(100, Eigen::Vector3f(0, 0, 0.1f));
    const AlignResult result = PointToPointIcp{}.align(one_place, yard_target(), SE3d());
    CHECK(result.status == AlignStatus::degenerate);
  }

  TEST_CASE("on a single plane three directions are told, three are kept from the guess") {
    Rng rng(9);
    const std::vector<Patch> floor{{{-50, -50, 0}, {100, 0, 0}, {0, 100, 0}}};
    const IndexedCloud<> target(sample(rng, floor, 20000));
    const std::vector<Patch> inner{{{-10, -10, 0}, {20, 0, 0}, {0, 20, 0}}};
    const PointCloud<float> source = sample(rng, inner, 2000, 0.01);
    Vector6d off;
    off << 0.5, -0.4, 0.3, 0.02, -0.03, 0.2;
    const AlignResult result = PointToPlaneIcp{}.align(source, target, SE3d::exp(off));
    CHECK(result.status == AlignStatus::degenerate);
    CHECK(result.degenerate_directions == 3);
    const SE3d T = result.T_target_source;
    CHECK(std::abs(T.translation().z()) < 0.003);
    CHECK((T.rotation() * Eigen::Vector3d(0, 0, 1) - Eigen::Vector3d::UnitZ()).norm() < 0.001);
    CHECK(T.translation().head<2>().isApprox(Eigen::Vector2d(0.5, -0.4), 0.15));
    CHECK(T.rotation().log().z() == doctest::Approx(0.2).epsilon(0.05));
    CHECK(jacobi_eigen(result.hessian).values[2] <
          1e-6 * result.hessian.trace());  // no information claimed for the three
    CHECK(jacobi_eigen(result.hessian).values[3] > 0.1);
  }

  TEST_CASE("along a corridor the guess is kept, also when normals are noisy; across, the walls decide") {
    Rng rng(10);
    PointCloud<float> cloud = sample(rng, corridor(), 20000);
    for (Eigen::Vector3f& n : cloud.normals)
      n = (SO3d::exp(0.03 * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal())) * n.cast<double>().eval())
              .cast<float>();
    const IndexedCloud<> target(cloud);
    const PointCloud<float> source = middle_of_corridor(rng, 4000);
    Vector6d off;
    off << 0.7, 0.2, -0.2, 0.02, 0.02, -0.02;
    const AlignResult result = PointToPlaneIcp{}.align(source, target, SE3d::exp(off));
    CHECK(result.status == AlignStatus::degenerate);
    CHECK(result.degenerate_directions == 1);
    CHECK(result.T_target_source.translation().x() == doctest::Approx(0.7).epsilon(0.05));
    CHECK(result.T_target_source.translation().tail<2>().norm() < 0.01);
    CHECK(result.T_target_source.rotation().log().norm() < 0.002);
  }

  TEST_CASE("a robust kernel keeps moved furniture from pulling") {
    Rng rng(11);
    const SE3d truth = asymmetric_pose();
    PointCloud<float> seen = sample(rng, yard(), 3000, 0.01);
    for (std::size_t i = 0; i < seen.size(); i += 5) seen.positions[i].z() += 0.5f;
    const PointCloud<float> source = seen_from(seen, truth);
    const SE3d guess = truth * random_motion(rng, 0.1, 0.01);
    const AlignResult plain = PointToPlaneIcp{}.align(source, yard_target(), guess);
    const AlignResult robust =
        Icp<PointToPlane, GemanMcClure>{.kernel = {.width = 0.05}}.align(source, yard_target(), guess);
    CHECK(translation_error(truth, plain.T_target_source) > 0.03);
    CHECK(translation_error(truth, robust.T_target_source) < 0.005);
  }

  TEST_CASE("a metric of one's own") {
    Rng rng(12);
    const PointCloud<float> source = sample(rng, {yard().front()}, 500);
    const KdTree<float> floor(sample(rng, {yard().front()}, 2000));
    const AlignResult result = Icp<HeightOnly>{}.align(source, floor, SE3d(SO3d(), Eigen::Vector3d(0, 0, 0.4)));
    CHECK(result.status == AlignStatus::degenerate);
    CHECK(std::abs(result.T_target_source.translation().z()) < 1e-6);
  }

  TEST_CASE("the free function takes planes where there are normals, else points") {
    Rng rng(13);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 2000, 0.01), truth);
    const SE3d guess = truth * random_motion(rng, 0.2, 0.02);
    CHECK(translation_error(truth, align(source, yard_target(), guess).T_target_source) < 0.005);
    PointCloud<float> bare = yard_target().cloud();
    bare.normals.clear();
    CHECK(translation_error(truth, align(source, IndexedCloud<>(bare), guess).T_target_source) < 0.05);
    CHECK(translation_error(truth, align(source, KdTree<float>(bare), guess).T_target_source) < 0.05);
  }

  TEST_CASE("two clouds in one go") {
    Rng rng(14);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 2000, 0.01), truth);
    const SE3d guess = truth * random_motion(rng, 0.2, 0.02);
    const AlignResult result = align(source, yard_target().cloud().positions, guess);
    CHECK(result.status == AlignStatus::converged);
    CHECK(translation_error(truth, result.T_target_source) < 0.01);
    // Normals made where they are needed are the same as all at once.
    PointCloud<float> target = yard_target().cloud();
    estimate_normals(target, {.neighbors = 10});
    CHECK(result.hessian == align(source, IndexedCloud<>(target), guess).hessian);
    CHECK(align(source, std::vector<Eigen::Vector3f>{}).status == AlignStatus::too_few_points);
  }

  TEST_CASE("a caller's mistakes are thrown at the door") {
    PointCloud<float> bare = yard_target().cloud();
    bare.normals.clear();
    const SE3d nan(SO3d(), Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()));
    CHECK_THROWS_AS((void)PointToPlaneIcp{}.align(bare, IndexedCloud<>(bare), SE3d()), std::invalid_argument);
    CHECK_THROWS_AS((void)PointToPointIcp{}.align(bare, yard_target(), nan), std::invalid_argument);
    CHECK_THROWS_AS((void)PointToPointIcp{.max_distance = 0}.align(bare, yard_target(), SE3d()), std::invalid_argument);
    CHECK_THROWS_AS((void)PointToPointIcp{.max_iterations = -1}.align(bare, yard_target(), SE3d()),
                    std::invalid_argument);
  }
}

}  // namespace chainslam::test
