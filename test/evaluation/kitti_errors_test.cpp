#include "chainslam/trajectory/kitti_errors.hpp"

#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "evaluation/paths.hpp"
#include "support/property.hpp"
#include "support/real_data.hpp"

using namespace chainslam;

namespace {

constexpr double degrees_per_100_m = 100 * 180 / std::numbers::pi;

/// `n` poses along x, `spacing` metres apart.
Trajectory straight(int n, double spacing) {
  Trajectory path;
  for (int i = 0; i < n; ++i) path.poses.push_back(SE3d(SO3d(), {i * spacing, 0, 0}));
  return path;
}

/// A random walk that turns, of steps up to 4 m, with a stop in it.
Trajectory random_path(Rng& rng, int n) {
  Trajectory path;
  SE3d pose;
  for (int i = 0; i < n; ++i) {
    path.poses.push_back(pose);
    if (i > n / 3 && i < n / 2) continue;
    const Eigen::Vector3d bend(rng.normal(0, 0.01), rng.normal(0, 0.01), rng.normal(0, 0.05));
    pose = pose * SE3d(SO3d::exp(bend), {rng.uniform(0, 4), rng.normal(0, 0.05), rng.normal(0, 0.05)});
  }
  return path;
}

Trajectory perturbed(Rng& rng, Trajectory path) {
  SE3d drift;
  for (SE3d& pose : path.poses) {
    drift = drift * SE3d(SO3d::exp({rng.normal(0, 0.002), rng.normal(0, 0.002), rng.normal(0, 0.002)}),
                         {rng.normal(0, 0.02), rng.normal(0, 0.02), rng.normal(0, 0.02)});
    pose = pose * drift;
  }
  return path;
}

/// The published definition on 4x4 matrices, by walking along the path from every start.
std::vector<KittiSegment> by_walking(const Trajectory& reference, const Trajectory& estimate, int step) {
  std::vector<KittiSegment> segments;
  const int n = static_cast<int>(reference.size());
  const auto matrix = [](const Trajectory& path, int i) { return path.poses[static_cast<std::size_t>(i)].matrix(); };
  for (int i = 0; i < n; i += step)
    for (int length = 100; length <= 800; length += 100) {
      double travelled = 0;
      int j = i;
      while (j + 1 < n && travelled <= length) {
        const Eigen::Matrix4d here = matrix(reference, j), next = matrix(reference, j + 1);
        travelled += (next.block<3, 1>(0, 3) - here.block<3, 1>(0, 3)).norm();
        ++j;
      }
      if (travelled <= length) continue;
      const Eigen::Matrix4d true_motion = matrix(reference, i).inverse() * matrix(reference, j);
      const Eigen::Matrix4d motion = matrix(estimate, i).inverse() * matrix(estimate, j);
      const Eigen::Matrix4d error = motion.inverse() * true_motion;
      const Eigen::Vector3d moved = error.block<3, 1>(0, 3);
      const double angle = std::acos(std::clamp((error.block<3, 3>(0, 0).trace() - 1) / 2, -1.0, 1.0));
      segments.push_back({0, i, j, double(length), moved.norm() / length, angle / length});
    }
  return segments;
}

}  // namespace

TEST_SUITE("evaluation/kitti_errors") {
  TEST_CASE("segments and their errors are those of the definition, followed step by step") {
    test::for_all(60, [](Rng& rng, int size) {
      const Trajectory reference = random_path(rng, 8 * size), estimate = perturbed(rng, reference);
      const int step = 1 + static_cast<int>(rng.uniform_index(20));
      const KittiErrors found = kitti_errors(reference, estimate, {.step = step});
      const std::vector<KittiSegment> expected = by_walking(reference, estimate, step);
      REQUIRE(found.segments.size() == expected.size());
      double translation = 0, rotation = 0;
      for (std::size_t k = 0; k < expected.size(); ++k) {
        CHECK(found.segments[k].first == expected[k].first);
        CHECK(found.segments[k].last == expected[k].last);
        CHECK(found.segments[k].length == expected[k].length);
        CHECK(found.segments[k].translation == doctest::Approx(expected[k].translation));
        CHECK(std::abs(found.segments[k].rotation - expected[k].rotation) < 1e-8);  // the arc cosine's rounding
        translation += expected[k].translation;
        rotation += expected[k].rotation;
      }
      CHECK((found.status == EvaluationStatus::evaluated) == !expected.empty());
      if (expected.empty()) return;
      CHECK(found.translation == doctest::Approx(translation / static_cast<double>(expected.size())));
      CHECK(std::abs(found.rotation - rotation / static_cast<double>(expected.size())) < 1e-8);
    });
  }

  TEST_CASE("a straight line too long by one percent errs by one percent, whatever the length") {
    const Trajectory reference = straight(9001, 0.1000001);  // a thousand steps are just more than 100 m
    const KittiErrors found =
        kitti_errors(reference, test::seen_from(SO3d::exp({1, 2, 3}), {5, 6, 7}, 1.01, reference));
    REQUIRE(found.status == EvaluationStatus::evaluated);
    CHECK(found.translation == doctest::Approx(0.01).epsilon(2e-6));
    CHECK(found.rotation < 1e-12);
    for (std::size_t k = 0; k < 8; ++k) {
      CHECK(found.lengths[k].length == 100.0 * static_cast<double>(k + 1));
      CHECK(found.lengths[k].segments == 801 - 100 * static_cast<Index>(k));
      CHECK(found.lengths[k].translation == doctest::Approx(0.01).epsilon(2e-6));
    }
  }

  TEST_CASE("a segment ends with the first pose that lies beyond its length, which what it errs by shows") {
    const Trajectory reference = straight(102, 1);  // 100 m are reached after 100 steps and exceeded after 101
    const KittiErrors found = kitti_errors(reference, test::seen_from(SO3d(), {0, 0, 0}, 1.5, reference));
    REQUIRE(found.segments.size() == 1);
    CHECK(found.segments[0].last == 101);
    CHECK(found.translation == doctest::Approx(0.5 * 101 / 100));
  }

  TEST_CASE("a heading that drifts with the way bends a straight line into an arc") {
    constexpr double bend = 0.002;  // radians per metre
    const Trajectory reference = straight(9001, 0.1000001);
    Trajectory estimate;
    for (const SE3d& pose : reference.poses) {
      const double s = pose.translation().x(), heading = bend * s;
      estimate.poses.push_back(
          SE3d(SO3d::exp({0, 0, heading}), {std::sin(heading) / bend, (1 - std::cos(heading)) / bend, 0}));
    }
    const KittiErrors found = kitti_errors(reference, estimate);
    CHECK(found.rotation == doctest::Approx(bend).epsilon(2e-6));
    for (const KittiLengthErrors& of_length : found.lengths) {
      const double turned = bend * of_length.length;
      const double off = std::hypot(of_length.length - std::sin(turned) / bend, (1 - std::cos(turned)) / bend);
      CHECK(of_length.translation == doctest::Approx(off / of_length.length).epsilon(2e-6));
      CHECK(of_length.rotation == doctest::Approx(bend).epsilon(2e-6));
    }
  }

  TEST_CASE("the mean weighs every segment alike, over all sessions") {
    const Trajectory longer = straight(2200, 0.1000001), shorter = straight(1100, 0.1000001);
    const MatchedTrajectories sessions[] = {{longer, longer},
                                            {shorter, test::seen_from(SO3d(), {0, 0, 0}, 1.01, shorter)}};
    const KittiErrors found = kitti_errors(align_sessions(sessions, {.align = Alignment::none}));
    CHECK(found.lengths[0].segments == 120 + 10);  // 100 m
    CHECK(found.lengths[1].segments == 20);        // 200 m, of the longer alone
    CHECK(found.segments.front().session == 0);
    CHECK(found.segments.back().session == 1);
    CHECK(found.lengths[0].translation == doctest::Approx(0.01 * 10 / 130).epsilon(1e-5));
    CHECK(found.translation == doctest::Approx(0.01 * 10 / 150).epsilon(1e-5));
  }

  TEST_CASE("starts are ten poses apart unless told otherwise") {
    const Trajectory path = straight(1500, 0.1);
    const auto starts = [](const KittiErrors& errors) {
      std::vector<Index> result;
      for (const KittiSegment& segment : errors.segments) result.push_back(segment.first);
      return result;
    };
    const auto usual = starts(kitti_errors(path, path)), sparse = starts(kitti_errors(path, path, {.step = 250}));
    REQUIRE(usual.size() == 50);
    for (std::size_t i = 0; i < usual.size(); ++i) CHECK(usual[i] == 10 * static_cast<Index>(i));
    CHECK(sparse == std::vector<Index>{0, 250});
    CHECK_THROWS_AS((void)kitti_errors(path, path, {.step = 0}), std::invalid_argument);
  }

  TEST_CASE("a path of no more than 100 m says that it is too short") {
    for (const int poses : {1, 2, 101}) {
      const KittiErrors found = kitti_errors(straight(poses, 1), straight(poses, 1));
      CHECK(found.status == EvaluationStatus::path_too_short);
      CHECK(found.segments.empty());
      CHECK(found.translation == 0);
    }
    CHECK(kitti_errors(straight(102, 1), straight(102, 1)).status == EvaluationStatus::evaluated);
    CHECK(kitti_errors(Trajectory{}, Trajectory{}).status == EvaluationStatus::no_poses);
    CHECK_THROWS_AS((void)kitti_errors(straight(5, 1), test::with_nan(straight(5, 1))), std::invalid_argument);
    CHECK_THROWS_AS((void)kitti_errors(straight(5, 1), straight(6, 1)), std::invalid_argument);
  }

  // Two estimates of KITTI 00 that evo ships (ORB-SLAM2 as run by its author, and S-PTAM).
  // The table is what the benchmark's own development kit makes of them (evaluate_odometry.cpp and matrix.cpp as in
  // github xiongxoy/xiong-viso, commit 6558c908, compiled by g++ 12 -O2). It takes distances and angles in single
  // precision: an angle's cosine is then good to 3e-4 rad.
  TEST_CASE("KITTI 00: two estimates have the errors that KITTI's development kit finds in them") {
    struct Row {
      Index segments;
      double translation, rotation;
    };
    struct Case {
      const char* file;
      Row all;
      std::array<Row, 8> lengths;
    };
    const Case cases[] = {{"KITTI_00_ORB.txt",
                           {3283, 0.0069973, 0.000044218},
                           {{{445, 0.0100908, 0.000107212},
                             {431, 0.0087438, 0.000061548},
                             {424, 0.0078086, 0.000044128},
                             {416, 0.0071887, 0.000036167},
                             {408, 0.0065532, 0.000029876},
                             {399, 0.0057199, 0.000025932},
                             {385, 0.0049259, 0.000021023},
                             {375, 0.0041586, 0.000017456}}}},
                          {"KITTI_00_SPTAM.txt",
                           {3283, 0.0148697, 0.000097342},
                           {{{445, 0.0217877, 0.000256260},
                             {431, 0.0175093, 0.000131973},
                             {424, 0.0158439, 0.000092247},
                             {416, 0.0150642, 0.000072931},
                             {408, 0.0139384, 0.000061697},
                             {399, 0.0125791, 0.000053640},
                             {385, 0.0109459, 0.000045721},
                             {375, 0.0097878, 0.000040075}}}}};
    const auto folder = test::real_data("trajectories/evo");
    if (!folder) return;
    const Trajectory reference = read_kitti_poses(*folder / "KITTI_00_gt.txt");
    for (const Case& expected : cases) {
      CAPTURE(expected.file);
      const Trajectory estimate = read_kitti_poses(*folder / expected.file);
      const KittiErrors found = kitti_errors(reference, estimate);
      REQUIRE(found.status == EvaluationStatus::evaluated);
      CHECK(found.segments.size() == static_cast<std::size_t>(expected.all.segments));
      CHECK(found.translation == doctest::Approx(expected.all.translation).epsilon(1e-4));
      CHECK(found.rotation == doctest::Approx(expected.all.rotation).epsilon(1e-3));
      for (std::size_t k = 0; k < 8; ++k) {
        CAPTURE(found.lengths[k].length);
        CHECK(found.lengths[k].segments == expected.lengths[k].segments);
        CHECK(found.lengths[k].translation == doctest::Approx(expected.lengths[k].translation).epsilon(1e-4));
        CHECK(found.lengths[k].rotation == doctest::Approx(expected.lengths[k].rotation).epsilon(1e-3));
      }
      std::printf("FIGURE %s, KITTI's metric: %.4f %%, %.4f deg/100 m\n", expected.file, 100 * found.translation,
                  degrees_per_100_m * found.rotation);
    }
  }
}
