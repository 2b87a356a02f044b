#include "chainslam/odometry/deskew.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <string>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "support/property.hpp"
#include "support/real_data.hpp"
#include "support/threads_cases.hpp"

using namespace chainslam;
using chainslam::test::for_all;

namespace {

Vector6d twist_of(double vx, double vy, double vz, double wx, double wy, double wz) {
  Vector6d twist;
  twist << vx, vy, vz, wx, wy, wz;
  return twist;
}

PointCloud<float> random_sweep(Rng& rng, int size, double duration) {
  PointCloud<float> sweep;
  for (int i = 0; i < size; ++i) {
    sweep.positions.emplace_back(rng.uniform(-80, 80), rng.uniform(-80, 80), rng.uniform(-5, 20));
    sweep.time_offsets.push_back(static_cast<float>(rng.uniform(0, duration)));
  }
  return sweep;
}

std::vector<float> read_floats(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  const std::vector<char> bytes((std::istreambuf_iterator<char>(file)), {});
  std::vector<float> values(bytes.size() / sizeof(float));
  std::memcpy(values.data(), bytes.data(), values.size() * sizeof(float));
  return values;
}

std::vector<Eigen::Vector3f> read_points(const std::filesystem::path& path) {
  const std::vector<float> values = read_floats(path);
  std::vector<Eigen::Vector3f> points;
  for (std::size_t i = 0; i + 3 <= values.size(); i += 3) points.emplace_back(values[i], values[i + 1], values[i + 2]);
  return points;
}

}  // namespace

TEST_SUITE("odometry/deskew") {
  TEST_CASE("a constant twist carries every point by exp((t - end) twist)") {
    for_all(20, [](Rng& rng, int size) {
      const double duration = 0.1;
      PointCloud<float> sweep = random_sweep(rng, size, duration);
      for (int i = 0; i < size; ++i) sweep.intensities.push_back(static_cast<float>(rng.uniform_index(256)));
      const Vector6d twist = twist_of(rng.uniform(-30, 30), rng.uniform(-3, 3), rng.uniform(-1, 1), rng.uniform(-2, 2),
                                      rng.uniform(-2, 2), rng.uniform(-4, 4));
      const SE3d T_body_lidar = SE3d::exp(twist_of(0.5, -0.2, 1.1, 0.1, -0.3, 1.4));
      const PointCloud<float> corrected = deskew(sweep, SweepMotion::constant_twist(duration, twist), T_body_lidar);
      REQUIRE(corrected.size() == sweep.size());
      CHECK(corrected.time_offsets == sweep.time_offsets);
      CHECK(corrected.intensities == sweep.intensities);
      for (std::size_t i = 0; i < sweep.size(); ++i) {
        const SE3d T_end_body = SE3d::exp((sweep.time_offsets[i] - duration) * twist);
        const Eigen::Vector3d expected = T_end_body * (T_body_lidar * sweep.positions[i].cast<double>());
        // 115 m * 0.003^2 / 8 between knots, and float's rounding.
        CHECK((corrected.positions[i].cast<double>() - expected).norm() < 2e-4);
      }
    });
  }

  TEST_CASE("a snapshot is moved by the mounting alone") {
    Rng rng(1);
    PointCloud<float> sweep = random_sweep(rng, 50, 0.1);
    sweep.time_offsets.clear();
    const SE3d T_body_lidar = SE3d::exp(twist_of(1, 2, 3, 0, 0, 0.5));
    const auto corrected = deskew(sweep, SweepMotion::constant_twist(0.1, twist_of(10, 0, 0, 0, 0, 1)), T_body_lidar);
    for (std::size_t i = 0; i < sweep.size(); ++i)
      CHECK((corrected.positions[i].cast<double>() - T_body_lidar * sweep.positions[i].cast<double>()).norm() < 1e-5);
    CHECK_FALSE(corrected.has_times());
  }

  TEST_CASE("times beyond the sweep are held at its ends, NaN at its begin") {
    PointCloud<float> sweep;
    sweep.positions.assign(4, Eigen::Vector3f(10, 0, 0));
    sweep.time_offsets = {-1, 0, 7, std::numeric_limits<float>::quiet_NaN()};
    const auto corrected = deskew(sweep, SweepMotion::constant_twist(0.1, twist_of(10, 0, 0, 0, 0, 0)));
    CHECK(corrected.positions[0].x() == doctest::Approx(9));
    CHECK(corrected.positions[1].x() == doctest::Approx(9));
    CHECK(corrected.positions[2].x() == doctest::Approx(10));
    CHECK(corrected.positions[3].x() == doctest::Approx(9));
  }

  THREADS_TEST_CASE("odometry/deskew", "threads change no bit, and an empty sweep stays empty") {
    Rng rng(2);
    const PointCloud<float> sweep = random_sweep(rng, 20000, 0.1);
    const SweepMotion motion = SweepMotion::constant_twist(0.1, twist_of(12, 1, 0, 0.1, 0.2, 1));
    const ThreadPool threads(3);
    CHECK(deskew(sweep, motion).positions == deskew(sweep, motion, {}, threads).positions);
    CHECK(deskew(PointCloud<float>{}, motion).empty());
  }

  TEST_CASE("real sweeps of a hand-held LiDAR come out as its publisher corrected them") {
    // gtsam_points' data set newer_06: sweeps, point times, and the same sweeps corrected to their begin.
    const auto folder = test::real_data("registration_pairs/gtsam_points/newer_06");
    if (!folder) return;
    for (const std::string number : {"00", "01", "02"}) {
      PointCloud<float> sweep;
      sweep.positions = read_points(*folder / ("raw_" + number + ".bin"));
      sweep.time_offsets = read_floats(*folder / ("times_" + number + ".bin"));
      const std::vector<Eigen::Vector3f> reference = read_points(*folder / ("deskewed_" + number + ".bin"));
      REQUIRE(reference.size() == sweep.size());
      const double duration = *std::ranges::max_element(sweep.time_offsets);

      // Mounting and motion are not given: the sweep's first points tell the one, its last the other.
      const auto T_begin_lidar = [&](float from, float to) {
        std::vector<Eigen::Vector3d> raw, moved;
        for (std::size_t i = 0; i < sweep.size(); ++i) {
          if (sweep.time_offsets[i] < from || sweep.time_offsets[i] > to) continue;
          raw.push_back(sweep.positions[i].cast<double>());
          moved.push_back(reference[i].cast<double>());
        }
        const auto T = umeyama(raw, moved, false);
        REQUIRE(T.has_value());
        return SE3d(T->rotation(), T->translation());
      };
      const auto end = static_cast<float>(duration);
      const SE3d T_body_lidar = T_begin_lidar(0, 0.001F);
      const SE3d T_begin_end = T_begin_lidar(end - 0.001F, end) * T_body_lidar.inverse();
      const SweepMotion motion = SweepMotion::constant_twist(duration, T_begin_end.log() / duration);
      const auto corrected = deskew(sweep, motion, T_body_lidar);
      std::vector<double> before, after;
      for (std::size_t i = 0; i < sweep.size(); ++i) {
        before.push_back((T_body_lidar * sweep.positions[i].cast<double>() - reference[i].cast<double>()).norm());
        after.push_back((T_begin_end * corrected.positions[i].cast<double>() - reference[i].cast<double>()).norm());
      }
      std::ranges::sort(before);
      std::ranges::sort(after);
      // The publisher followed the IMU; a constant twist takes away most of the skew, not all.
      CHECK(after[after.size() / 2] < 0.15);
      CHECK(after[after.size() / 2] < 0.16 * before[before.size() / 2]);
    }
  }
}
