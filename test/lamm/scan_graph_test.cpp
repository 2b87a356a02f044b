#include "scan_graph.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "lamm/circle_drives.hpp"
#include "support/property.hpp"

namespace chainslam::lamm {
namespace {

using test::loops_between;
using test::round_trip;
using test::true_loop;
using test::two_drives;
using test::TwoDrives;

/// The largest distance of a scan from where it was, once the first drive's first is where it was.
double worst_error(const TwoDrives& two, const OptimizedDrives& optimized) {
  const SE3d T_truth_map = two.truths[0][0] * optimized.poses[0][0].inverse();
  double worst = 0;
  for (std::size_t drive = 0; drive < 2; ++drive)
    for (std::size_t i = 0; i < optimized.poses[drive].size(); ++i) {
      const auto frame = static_cast<std::size_t>(two.drives[drive].scans[i].frame);
      const SE3d placed = T_truth_map * optimized.poses[drive][i];
      worst = std::max(worst, (placed.translation() - two.truths[drive][frame].translation()).norm());
    }
  return worst;
}

}  // namespace

TEST_SUITE("lamm/scan_graph") {
  TEST_CASE("two drives are put together by their loops, from any frames of their own") {
    test::for_all(5, [](Rng& rng, int /*size*/) {
      const TwoDrives two = two_drives(rng, 1e-3);
      const std::vector<Loop> loops = loops_between(two, 30);
      const auto optimized = optimize_drives(two.drives, loops, {});
      CHECK(optimized.report.ok());
      CHECK(optimized.frame_of == std::vector<Index>{0, 0});
      double sum = 0;
      for (const Loop& loop : loops) {
        const auto scan = static_cast<std::size_t>(loop.source_frame) / 10;  // of both drives
        const SE3d T = optimized.poses[0][scan].inverse() * optimized.poses[1][scan];
        sum += (T.translation() - loop.T_target_source.translation()).squaredNorm();
      }
      const double variance = ScanGraphOptions{}.loop_variance;  // of each coordinate
      CHECK(sum / static_cast<double>(loops.size()) < 3 * variance);
    });
  }

  TEST_CASE("a false loop is outvoted, one that was dropped is not looked at") {
    test::for_all(5, [](Rng& rng, int /*size*/) {
      const TwoDrives two = two_drives(rng, 1e-4);
      std::vector<Loop> loops = loops_between(two, 30);
      Loop wrong = loops[7];
      wrong.T_target_source = wrong.T_target_source * SE3d(SO3d::exp({0, 0, 1}), {25, 10, 0});
      wrong.overlap = 0.4;
      loops.push_back(wrong);
      CHECK(worst_error(two, optimize_drives(two.drives, loops, {})) < 0.5);
      loops.back().kept = false;
      const double without = worst_error(two, optimize_drives(two.drives, loops, {}));
      loops.pop_back();
      CHECK(without == worst_error(two, optimize_drives(two.drives, loops, {})));
    });
  }

  TEST_CASE("drives without a loop between them stay in their own frames, as odometry left them") {
    Rng rng(1);
    const TwoDrives two = two_drives(rng, 1e-3);
    const std::vector<Loop> loops{true_loop(0, 950, 0, 0, two.truths)};
    const auto optimized = optimize_drives(two.drives, loops, {});
    CHECK(optimized.frame_of == std::vector<Index>{0, 1});
    for (std::size_t i = 0; i < optimized.poses[1].size(); ++i) {
      const SE3d& odometry = two.drives[1].pose(two.drives[1].scans[i].frame);
      CHECK((optimized.poses[1][i].translation() - odometry.translation()).norm() < 1e-6);
    }
  }

  TEST_CASE("as released a loop is ten factors after its ends, which is wrong unless both went the same way") {
    Rng rng(2);
    const TwoDrives two = two_drives(rng, 1e-5);
    const std::vector<Loop> loops = loops_between(two, 30);
    const ScanGraphOptions released{.frames_a_loop = 10};
    const auto designed = optimize_drives(two.drives, loops, {}), wrong = optimize_drives(two.drives, loops, released);
    CHECK(wrong.factors - wrong.variables == designed.factors - designed.variables + 9 * 30);
    CHECK(worst_error(two, wrong) < 1.0);  // both went the same way at the same speed
    TwoDrives against = two;               // the second drive backwards
    std::ranges::reverse(against.drives[1].odometry.poses);
    std::ranges::reverse(against.truths[1]);
    std::vector<Loop> meeting;
    for (const Loop& loop : loops)
      meeting.push_back(
          true_loop(1, std::max<Index>(990 - loop.source_frame, 0), 0, loop.target_frame, against.truths));
    CHECK(worst_error(against, optimize_drives(against.drives, meeting, {})) < 0.5);
    CHECK(worst_error(against, optimize_drives(against.drives, meeting, released)) > 1.0);
  }

  TEST_CASE("the covariance of many steps is that of what they add up to") {
    Rng rng(3);
    std::vector<SE3d> truth;
    const Drive drive = round_trip(rng, 0, 0, SE3d(), truth);
    constexpr double variance = 1e-6;
    const Matrix6d covariance = compounded_covariance(drive, 5, 65, variance);
    Matrix6d sampled = Matrix6d::Zero();
    constexpr int samples = 4000;
    for (int k = 0; k < samples; ++k) {
      SE3d pose;
      for (Index i = 5; i < 65; ++i) {
        Vector6d error;
        for (double& entry : error) entry = rng.normal(0, std::sqrt(variance));
        pose = pose * (drive.pose(i).inverse() * drive.pose(i + 1)) * SE3d::exp(error);
      }
      const Vector6d off = ((drive.pose(5).inverse() * drive.pose(65)).inverse() * pose).log();
      sampled += off * off.transpose() / samples;
    }
    for (int i = 0; i < 6; ++i) CHECK(sampled(i, i) == doctest::Approx(covariance(i, i)).epsilon(0.1));
    CHECK(sampled(1, 5) == doctest::Approx(covariance(1, 5)).epsilon(0.15));
    CHECK(compounded_covariance(drive, 5, 6, variance).isApprox(variance * Matrix6d::Identity()));
  }
}

}  // namespace chainslam::lamm
