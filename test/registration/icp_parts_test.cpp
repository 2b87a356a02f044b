#include <doctest/doctest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cstddef>
#include <limits>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/registration/align.hpp"
#include "chainslam/registration/icp.hpp"
#include "registration/scenes.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

const IndexedCloud<>& parts_target() {
  static const IndexedCloud<> target = [] {
    Rng rng(31);
    return IndexedCloud<>(sample(rng, yard(), 8000));
  }();
  return target;
}

/// Notes how many points it is given; all have normals.
struct Looking {
  std::size_t* points = nullptr;

  template <Cloud Source, class Target, Executor Exec>
  [[nodiscard]] AlignResult align(const Source& source, const Target& /*target*/, const SE3d& guess,
                                  const Exec& /*executor*/, const Deadline& /*deadline*/) const {
    *points = cloud_size(source);
    CHECK(carries_normals(source));
    AlignResult result;
    result.T_target_source = guess;
    result.status = AlignStatus::converged;
    return result;
  }
};

/// Parts of the yard's faces so far from the others that no point finds its match on another face.
std::vector<Patch> inside_the_yard() {
  return {
      {{-9, -5, 0}, {9, 0, 0}, {0, 9, 0}}, {{-9, -6, 1}, {18, 0, 0}, {0, 0, 3}}, {{10, -5, 1}, {0, 10, 0}, {0, 0, 3}}};
}

/// Seen from the source's frame, normals turned, too.
PointCloud<float> oriented_from(const PointCloud<float>& cloud, const SE3d& T_target_source) {
  PointCloud<float> result = seen_from(cloud, T_target_source);
  for (const Eigen::Vector3f& n : cloud.normals)
    result.normals.push_back((T_target_source.rotation().inverse() * n.cast<double>().eval()).cast<float>());
  return result;
}

/// Asks to stop after so many loops.
struct StoppingExecutor {
  std::stop_source& source;
  mutable int loops = 0;
  int last = 3;

  template <class Body>
  void for_chunks(Index count, Index grain, Body&& body) const {
    Serial{}.for_chunks(count, grain, body);
    if (++loops == last) source.request_stop();
  }
};

/// Mean normalized estimation error squared over `trials`: e' covariance^-1 e with truth = estimate * exp(e), 6 for a
/// covariance that is right.
template <class Align>
double mean_squared_normalised_error(int trials, Align&& align_noisy) {
  double sum = 0;
  for (int trial = 0; trial < trials; ++trial) {
    Rng rng(static_cast<std::uint64_t>(1000 + trial));
    const SE3d truth = asymmetric_pose() * random_motion(rng, 1.0, 0.5);
    const AlignResult result = align_noisy(rng, truth, truth * random_motion(rng, 0.02, 0.002));
    REQUIRE(result.status == AlignStatus::converged);
    const Vector6d error = result.T_target_source.local(truth);
    sum += error.dot(result.covariance.inverse() * error);
  }
  return sum / trials;
}

}  // namespace

TEST_SUITE("registration/icp parts") {
  TEST_CASE("plane to plane finds T_target_source, and swapping the clouds finds its inverse") {
    for_all(10, [](Rng& rng, int) {
      const SE3d truth = asymmetric_pose() * random_motion(rng, 1.0, 0.5);
      const PointCloud<float> other = sample(rng, yard(), 7000, 0.01);
      const PointCloud<float> source = oriented_from(other, truth);
      const SE3d guess = truth * random_motion(rng, 0.3, 0.03);
      const AlignResult forth = Gicp{}.align(source, parts_target(), guess);
      CHECK(forth.status == AlignStatus::converged);
      CHECK(translation_error(truth, forth.T_target_source) < 0.004);
      CHECK(rotation_error(truth, forth.T_target_source) < 0.001);
      const AlignResult back = Gicp{}.align(parts_target().cloud(), IndexedCloud<>(source), guess.inverse());
      CHECK(translation_error(SE3d(), forth.T_target_source * back.T_target_source) < 0.005);
      CHECK(rotation_error(SE3d(), forth.T_target_source * back.T_target_source) < 0.001);
    });
  }

  TEST_CASE("the first steps on some of the points lead to the pose that all lead to") {
    Rng rng(32);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 8000, 0.01), truth);
    const SE3d guess = truth * random_motion(rng, 0.3, 0.03);
    const AlignResult all = PointToPlaneIcp{.coarse_stride = 1}.align(source, parts_target(), guess);
    const AlignResult has_coarse_stage = PointToPlaneIcp{.coarse_stride = 8}.align(source, parts_target(), guess);
    CHECK(all.status == AlignStatus::converged);
    CHECK(has_coarse_stage.status == AlignStatus::converged);
    CHECK(translation_error(all.T_target_source, has_coarse_stage.T_target_source) < 5e-4);
    CHECK(has_coarse_stage.inliers == all.inliers);
  }

  TEST_CASE("the covariance is the one that the errors of many trials have") {
    // The mean of 150 draws of chi-square(6) lies within 6 +- 3.3 sqrt(12 / 150) = 6 +- 0.93 in 999 of 1000 cases.
    const double planes = mean_squared_normalised_error(150, [](Rng& rng, const SE3d& truth, const SE3d& guess) {
      const PointCloud<float> source = seen_from(sample(rng, inside_the_yard(), 600, 0.02), truth);
      return PointToPlaneIcp{.translation_tolerance = 1e-6, .rotation_tolerance = 1e-7}.align(source, parts_target(),
                                                                                              guess);
    });
    CHECK(planes == doctest::Approx(6).epsilon(0.93 / 6));
    const double points = mean_squared_normalised_error(150, [](Rng& rng, const SE3d& truth, const SE3d&) {
      PointCloud<float> seen;  // so near their partners that none is mistaken
      for (std::size_t i = 0; i < parts_target().cloud().size(); i += 16) {
        const Eigen::Vector3f noise(static_cast<float>(rng.normal(0, 0.005)), static_cast<float>(rng.normal(0, 0.005)),
                                    static_cast<float>(rng.normal(0, 0.005)));
        seen.positions.push_back(parts_target().cloud().positions[i] + noise);
      }
      return PointToPointIcp{.translation_tolerance = 1e-6, .rotation_tolerance = 1e-7}.align(
          seen_from(seen, truth), parts_target(), truth * random_motion(rng, 0.002, 0.0002));
    });
    CHECK(points == doctest::Approx(6).epsilon(0.93 / 6));
  }

  TEST_CASE("localizability names the axis along which a corridor tells nothing, and its covariance is wide there") {
    Rng rng(33);
    const IndexedCloud<> target(sample(rng, corridor(), 20000));
    const PointCloud<float> source = middle_of_corridor(rng, 2000);
    const AlignResult result = PointToPlaneIcp{}.align(source, target, SE3d());
    CHECK(result.status == AlignStatus::degenerate);
    CHECK(result.localizability[0] == doctest::Approx(0.0005).epsilon(0.01));
    for (int axis = 1; axis < 6; ++axis) CHECK(result.localizability[axis] > 0.02);
    CHECK(std::abs(result.eigenvectors(0, 0)) == doctest::Approx(1.0).epsilon(1e-4));
    CHECK(result.covariance(0, 0) == doctest::Approx(1.0).epsilon(1e-3));  // the largest distance of a pair, squared
    CHECK(result.covariance(1, 1) < 1e-5);
  }

  TEST_CASE("Levenberg and Marquardt end where Gauss and Newton do, and never raise the cost") {
    for_all(5, [](Rng& rng, int) {
      const SE3d truth = asymmetric_pose() * random_motion(rng, 1.0, 0.5);
      const PointCloud<float> source = seen_from(sample(rng, yard(), 2000, 0.01), truth);
      const SE3d guess = truth * random_motion(rng, 0.3, 0.03);
      const Icp<PointToPlane, Cauchy, KeepPairs, LevenbergMarquardtStep> damped{.kernel = {.width = 0.2}};
      const Icp<PointToPlane, Cauchy> plain{.kernel = {.width = 0.2}};
      const AlignResult a = damped.align(source, parts_target(), guess), b = plain.align(source, parts_target(), guess);
      CHECK(a.converged());
      CHECK(translation_error(b.T_target_source, a.T_target_source) < 1e-3);
      CHECK(rotation_error(b.T_target_source, a.T_target_source) < 2e-4);
    });
    struct Uphill {  // whose steps never pay
      [[nodiscard]] Vector6d solve(double) const { return Vector6d::Ones(); }
      [[nodiscard]] double cost() const { return 1; }
      [[nodiscard]] double cost_after(const Vector6d&) const { return 2; }
    };
    double damping = 0.1;
    CHECK_FALSE(LevenbergMarquardtStep{.max_trials = 3}.step(Uphill{}, damping).has_value());
    CHECK(damping == doctest::Approx(100));
  }

  TEST_CASE("a prior decides where the points are silent, and gives way where they speak") {
    Rng rng(34);
    const IndexedCloud<> target(sample(rng, corridor(), 20000));
    const PointCloud<float> source = middle_of_corridor(rng, 2000);
    Vector6d off;
    off << 0.5, 0.1, 0, 0, 0, 0.01;
    using WithPrior = Icp<PointToPlane, Trivial, KeepPairs, GaussNewtonStep, PosePrior>;
    const SE3d said(SO3d(), Eigen::Vector3d(0.2, 0.05, 0));
    const WithPrior icp{
        .translation_tolerance = 1e-6,
        .prior = {.T_target_source = said, .information = 1e4 * Matrix6d::Identity(), .pair_deviation = 0.1}};
    const AlignResult result = icp.align(source, target, SE3d::exp(off));
    CHECK(result.status == AlignStatus::converged);
    CHECK(result.T_target_source.translation().x() == doctest::Approx(0.2).epsilon(0.01));
    CHECK(std::abs(result.T_target_source.translation().y()) < 0.02);

    // Its derivatives are those of differences.
    const SE3d T = random_motion(rng, 1.0, 1.0);
    PosePrior prior{.T_target_source = random_motion(rng, 1.0, 1.0), .information = Matrix6d::Identity()};
    prior.information(0, 3) = prior.information(3, 0) = 0.4;
    const PriorTerms terms = prior.evaluate(T);
    for (int k = 0; k < 6; ++k) {
      const Vector6d step = 1e-6 * Vector6d::Unit(k);
      const double slope = (prior.evaluate(T.retract(step)).cost - prior.evaluate(T.retract(-step)).cost) / 2e-6;
      CHECK(terms.gradient[k] == doctest::Approx(0.5 * slope).epsilon(1e-5));
    }
  }

  TEST_CASE("directions that are not free stay exactly where the guess has them") {
    Rng rng(35);
    const SE3d truth(SO3d::exp(Eigen::Vector3d(0, 0, 0.7)), Eigen::Vector3d(3, -1.5, 0.4));
    const PointCloud<float> source = seen_from(sample(rng, yard(), 6000, 0.01), truth);
    const SE3d guess(SO3d::exp(Eigen::Vector3d(0, 0, 0.75)), Eigen::Vector3d(3.2, -1.6, 0.4));
    const AlignResult result =
        PointToPlaneIcp{.free = {.z = false, .roll = false, .pitch = false}}.align(source, parts_target(), guess);
    CHECK(result.status == AlignStatus::converged);
    CHECK(result.degenerate_directions == 0);
    CHECK(translation_error(truth, result.T_target_source) < 0.005);
    CHECK(result.T_target_source.translation().z() == doctest::Approx(0.4).epsilon(1e-12));
    CHECK((result.T_target_source.rotation() * Eigen::Vector3d(0, 0, 1) - Eigen::Vector3d::UnitZ()).norm() < 1e-12);
    CHECK(result.covariance(2, 2) < 1e-18);
    // Only yaw: the source's origin, not its centroid, stays.
    const SE3d turned(guess.rotation(), truth.translation());
    const AlignResult yaw =
        PointToPlaneIcp{.free = {false, false, false, false, false, true}}.align(source, parts_target(), turned);
    CHECK((yaw.T_target_source.translation() - truth.translation()).norm() < 1e-12);
    CHECK(rotation_error(truth, yaw.T_target_source) < 0.001);
  }

  TEST_CASE("the reason that it stopped is named") {
    Rng rng(36);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 3000, 0.01), truth);
    const SE3d guess = truth * random_motion(rng, 0.3, 0.03);
    CHECK(PointToPlaneIcp{}.align(source, parts_target(), guess).stop == StopReason::small_step);
    CHECK(PointToPlaneIcp{.max_iterations = 1}.align(source, parts_target(), guess).stop ==
          StopReason::iteration_limit);
    CHECK(PointToPlaneIcp{.max_iterations = 0}.align(source, parts_target(), guess).stop == StopReason::not_started);
    const AlignResult settled =
        PointToPlaneIcp{.translation_tolerance = 0, .cost_tolerance = 1e-3}.align(source, parts_target(), guess);
    CHECK(settled.stop == StopReason::small_improvement);
    CHECK(settled.status == AlignStatus::converged);
    const AlignResult lost = PointToPlaneIcp{}.align(source, parts_target(), SE3d(SO3d(), {500, 0, 0}));
    CHECK(lost.stop == StopReason::lost_overlap);
    CHECK(lost.status == AlignStatus::no_overlap);
  }

  TEST_CASE("a deadline stops it with the best pose so far") {
    Rng rng(37);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> source = seen_from(sample(rng, yard(), 3000, 0.01), truth);
    const SE3d guess = truth * random_motion(rng, 0.3, 0.03);
    const AlignResult at_once =
        PointToPlaneIcp{}.align(source, parts_target(), guess, Serial{}, Deadline::in(std::chrono::seconds(0)));
    CHECK(at_once.status == AlignStatus::cancelled);
    CHECK(at_once.stop == StopReason::deadline);
    CHECK(at_once.iterations == 0);
    CHECK(translation_error(guess, at_once.T_target_source) < 1e-12);
    CHECK(at_once.inliers > 0);

    std::stop_source source_of_stop;
    const StoppingExecutor executor{source_of_stop};
    const AlignResult part =
        PointToPlaneIcp{}.align(source, parts_target(), guess, executor, Deadline(source_of_stop.get_token()));
    CHECK(part.status == AlignStatus::cancelled);
    CHECK(part.iterations == 2);
    CHECK(part.T_target_source ==
          PointToPlaneIcp{.max_iterations = 2}.align(source, parts_target(), guess).T_target_source);
  }

  TEST_CASE("500 km from the origin, in double, nothing is lost") {
    Rng rng(38);
    const Eigen::Vector3d far(350e3, -360e3, 200);
    const PointCloud<float> local = sample(rng, yard(), 8000);
    PointCloud<double> target;
    for (std::size_t i = 0; i < local.size(); ++i) {
      target.positions.push_back(position(local, i) + far);
      target.normals.push_back(local.normals[i].cast<double>());
    }
    std::vector<Eigen::Vector3d> source;
    for (const Eigen::Vector3f& p : sample(rng, yard(), 3000, 0.01).positions) source.push_back(p.cast<double>() + far);
    const SE3d center(SO3d(), far);
    const SE3d guess = center * random_motion(rng, 0.3, 0.03) * center.inverse();
    const AlignResult result = PointToPlaneIcp{}.align(source, IndexedCloud<KdTree<double>>(target), guess);
    CHECK(result.status == AlignStatus::converged);
    CHECK((result.T_target_source * far - far).norm() < 0.003);
    CHECK(rotation_error(SE3d(), result.T_target_source) < 0.001);
  }

  TEST_CASE("a mirrored source gets a rotation, never a reflection, and its residual tells") {
    Rng rng(39);
    PointCloud<float> mirrored = sample(rng, yard(), 3000, 0.01);
    for (Eigen::Vector3f& p : mirrored.positions) p.x() = -p.x();
    const AlignResult result = PointToPlaneIcp{}.align(mirrored, parts_target(), SE3d());
    CHECK(result.T_target_source.rotation().matrix().determinant() == doctest::Approx(1.0));
    CHECK(
        (result.status == AlignStatus::no_overlap || result.inlier_ratio < 0.9 || result.mean_squared_residual > 0.01));
  }

  TEST_CASE("points that come many times weigh as often and do no other harm") {
    Rng rng(40);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> once = seen_from(sample(rng, yard(), 1000, 0.01), truth);
    PointCloud<float> thrice = once, doubled = parts_target().cloud();
    for (int i = 0; i < 2; ++i)
      thrice.positions.insert(thrice.positions.end(), once.positions.begin(), once.positions.end());
    const auto positions = doubled.positions, normals = doubled.normals;
    doubled.positions.insert(doubled.positions.end(), positions.begin(), positions.end());
    doubled.normals.insert(doubled.normals.end(), normals.begin(), normals.end());
    const SE3d guess = truth * random_motion(rng, 0.2, 0.02);
    const AlignResult plain = PointToPlaneIcp{}.align(once, parts_target(), guess);
    const AlignResult repeated = PointToPlaneIcp{}.align(thrice, IndexedCloud<>(doubled), guess);
    CHECK(repeated.status == AlignStatus::converged);
    CHECK(repeated.inliers == 3 * plain.inliers);
    CHECK(translation_error(plain.T_target_source, repeated.T_target_source) < 1e-5);
    CHECK((repeated.hessian - 3 * plain.hessian).norm() < 1e-4 * repeated.hessian.norm());
  }

  TEST_CASE("a schedule of distances reaches farther than its last one") {
    int missed_alone = 0;
    for (std::uint64_t seed = 0; seed < 6; ++seed) {
      CAPTURE(seed);
      Rng rng(seed);
      const SE3d truth = asymmetric_pose() * random_motion(rng, 1.0, 0.5);
      const PointCloud<float> source = seen_from(sample(rng, yard(), 3000, 0.01), truth);
      const SE3d guess = truth * SE3d(SO3d::exp(Eigen::Vector3d(0, 0, 0.1)), Eigen::Vector3d(1.2, -0.8, 0.3));
      const DistanceSchedule<PointToPlaneIcp> schedule{.registration = {.max_distance = 0.3}};
      const AlignResult result = schedule.align(source, parts_target(), guess);
      CHECK(result.status == AlignStatus::converged);
      CHECK(translation_error(truth, result.T_target_source) < 0.005);
      const AlignResult alone = schedule.registration.align(source, parts_target(), guess);
      missed_alone += translation_error(truth, alone.T_target_source) > 0.1 ? 1 : 0;
    }
    CHECK(missed_alone > 0);
    const AlignResult lost =
        DistanceSchedule<>{}.align(parts_target().cloud(), parts_target(), SE3d(SO3d(), {500, 0, 0}));
    CHECK(lost.status == AlignStatus::no_overlap);
  }

  TEST_CASE("the coarse of two registrations sees 2048 points or more, evenly and with normals, the fine one all") {
    for (const std::size_t count : {1000U, 4095U, 4096U, 5000U, 8000U}) {
      CAPTURE(count);
      PointCloud<float> source = parts_target().cloud();
      source.positions.resize(count);
      source.normals.assign(count, Eigen::Vector3f(0, 0, 1));
      std::size_t coarse_points = 0, fine_points = 0;
      CoarseToFine<Looking> both{.coarse = {&coarse_points}, .fine = {&fine_points}};
      static_cast<void>(both.align(source, parts_target(), SE3d()));
      CHECK(fine_points == count);
      CHECK(coarse_points >= std::min<std::size_t>(count, 2048));
      CHECK(coarse_points < 2 * 2048);
      both.coarse_points = 0;
      static_cast<void>(both.align(source, parts_target(), SE3d()));
      CHECK(coarse_points == count);
      coarse_points = fine_points = 0;
      static_cast<void>(both.refine(source, parts_target(), SE3d()));
      CHECK(coarse_points == 0);
      CHECK(fine_points == count);
    }
  }
}

}  // namespace chainslam::test
