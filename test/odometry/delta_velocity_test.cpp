#include "chainslam/odometry/detail/delta_velocity.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/gravity_measurement.hpp"
#include "odometry/imu_samples.hpp"
#include "support/kitti_drive.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {
namespace delta {

/// A record of a body that turns at `rate` and on which a force acts that is constant in the world, from 0 s on.
detail::ImuRecord turning(const Eigen::Vector3d& rate, const Eigen::Vector3d& force, double duration) {
  detail::ImuRecord record;
  for (double t = 0; t <= duration + 0.005; t += 0.01)
    record.add(test::sample_at(t, rate, SO3d::exp(t * rate).inverse() * force));
  return record;
}

/// Frames of a drive whose poses are the truth and whose accelerometer is real.
std::vector<FrameRecord> recorded_frames(const test::KittiDrive& drive) {
  constexpr double lag = 0.066;  // seconds, as the data's description measured it
  detail::ImuRecord record;
  for (ImuSample sample : drive.imu) {
    sample.time = sample.time - seconds(lag);
    record.add(sample);
  }
  std::vector<FrameRecord> frames;
  for (std::size_t i = 0; i < drive.trajectory.size(); ++i) {
    FrameRecord frame{.time = drive.trajectory.times[i], .T_odom_body = drive.trajectory.poses[i]};
    if (i > 0) {
      const FrameRecord& before = frames.back();
      const Eigen::Vector3d turn = before.T_odom_body.rotation().local(frame.T_odom_body.rotation());
      if (const auto gained = detail::delta_velocity(record, before.time, frame.time, turn))
        frame.delta_velocity = gained->cast<float>();
    }
    frames.push_back(frame);
  }
  return frames;
}

/// Angles in rad between directions against gravity and their mean in the world, squared and over what they state.
struct Errors {
  double squares = 0, over_stated = 0;
  int count = 0;

  void add(const Errors& other) {
    squares += other.squares;
    over_stated += other.over_stated;
    count += other.count;
  }
  [[nodiscard]] double rms() const { return std::sqrt(squares / count); }
};

Errors errors_of(const std::vector<FrameRecord>& frames, const GravityFactorOptions& options) {
  std::vector<Eigen::Vector3d> up;
  std::vector<double> sigmas;
  const auto length = static_cast<std::size_t>(options.window / to_seconds(frames[1].time - frames[0].time));
  for (std::size_t begin = 0; begin + length < frames.size(); begin += length) {
    const auto window = std::span(frames).subspan(begin, length + 1);
    const auto measured = measure_gravity(window, options);
    if (!measured) continue;
    up.push_back(measured->up);
    sigmas.push_back(measured->sigma);
  }
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& one : up) mean += one;
  Errors errors;
  for (std::size_t i = 0; i < up.size(); ++i) {
    const double off = up[i].cross(mean.normalized()).norm();
    errors.squares += off * off / 2;  // of each of two angles
    errors.over_stated += off * off / (2 * sigmas[i] * sigmas[i]);
    ++errors.count;
  }
  return errors;
}

}  // namespace delta
}  // namespace

TEST_SUITE("odometry/delta_velocity") {
  using namespace delta;

  TEST_CASE("a constant force on a turning body: its integral, seen from where the body ends") {
    test::for_all(20, [](Rng& rng, int) {
      const Eigen::Vector3d rate(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-1, 1));
      const Eigen::Vector3d force(rng.uniform(-3, 3), rng.uniform(-3, 3), 9.8);
      const detail::ImuRecord record = turning(rate, force, 1.0);
      const double begin = rng.uniform(0, 0.4), end = rng.uniform(0.5, 1.0);
      const auto gained = detail::delta_velocity(record, test::at(begin), test::at(end), (end - begin) * rate);
      REQUIRE(gained);
      const Eigen::Vector3d expected = (end - begin) * (SO3d::exp(end * rate).inverse() * force);
      CHECK((*gained - expected).norm() < 2e-4 * expected.norm());
    });
  }

  TEST_CASE("what was not measured all the time is not stated") {
    const Eigen::Vector3d none = Eigen::Vector3d::Zero(), force(0, 0, 9.8);
    const detail::ImuRecord record = turning(none, force, 1.0);
    CHECK(detail::delta_velocity(record, test::at(0.5), test::at(1.1), none));  // held a little beyond the last one
    CHECK_FALSE(detail::delta_velocity(record, test::at(0.5), test::at(2.0), none));
    CHECK_FALSE(detail::delta_velocity(record, test::at(-2.0), test::at(0.5), none));
    CHECK_FALSE(detail::delta_velocity(record, test::at(0.5), test::at(0.5), none));
    CHECK_FALSE(detail::delta_velocity(detail::ImuRecord(), test::at(0.5), test::at(0.6), none));
  }

  TEST_CASE("gravity on five real drives of a car: as exact as stated, and less so by shorter windows") {
    constexpr std::array<std::pair<const char*, double>, 5> drives{
        {{"00", 0.10365}, {"05", 0.1044}, {"06", 0.1042}, {"07", 0.1040}, {"09", 0.1039}}};
    Errors all, shorter;
    for (const auto& [name, period] : drives) {
      const auto drive = test::kitti_drive(name, period);
      if (!drive) return;
      const std::vector<FrameRecord> frames = recorded_frames(*drive);
      all.add(errors_of(frames, {}));
      shorter.add(errors_of(frames, {.window = 2.5, .deviation = 0}));
    }
    MESSAGE("rms ", all.rms(), " rad over ", all.count, " windows, by windows of a quarter ", shorter.rms());
    CHECK(all.count > 90);
    CHECK(all.rms() < 0.0015);
    CHECK(shorter.rms() > 2 * all.rms());
    // Of a unit whose bias is known, only odometry's velocity at the ends is in doubt.
    CHECK(shorter.over_stated / shorter.count > 0.1);
    CHECK(shorter.over_stated / shorter.count < 2);
  }
}
}  // namespace chainslam
