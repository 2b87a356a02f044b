#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam::test {

using ImuSamples = std::vector<ImuSample>;

/// The measurements with a clock that stamps them `delay` seconds late.
inline ImuSamples stamped_late(ImuSamples samples, double delay) {
  for (ImuSample& sample : samples) sample.time = sample.time + seconds(delay);
  return samples;
}

/// What an IMU mounted with other axes would have measured: v_turned = R_turned_body v_body.
inline ImuSamples turned(ImuSamples samples, const SO3d& R_turned_body) {
  for (ImuSample& sample : samples) {
    sample.gyro = R_turned_body * sample.gyro;
    sample.accel = R_turned_body * sample.accel;
  }
  return samples;
}

/// The measurements in g and degrees per second, as many drivers give them.
inline ImuSamples in_g_and_degrees(ImuSamples samples) {
  for (ImuSample& sample : samples) {
    sample.gyro *= 180 / std::numbers::pi;
    sample.accel /= 9.80665;
  }
  return samples;
}

/// A share of the measurements gets one out_of_range number of 1e3 to 1e30 (uniform in the logarithm), of either sign.
inline ImuSamples with_spikes(ImuSamples samples, double share, Rng rng) {
  for (ImuSample& sample : samples) {
    if (rng.uniform() >= share) continue;
    const double spike = std::pow(10.0, rng.uniform(3, 30)) * (rng.uniform() < 0.5 ? -1 : 1);
    const Index axis = rng.uniform_index(6);
    (axis < 3 ? sample.gyro : sample.accel)[axis % 3] = spike;
  }
  return samples;
}

/// One axis of the gyroscope or the accelerometer repeats one value for ever.
/// @param axis  0 to 2.
/// @param begin  seconds from the first measurement, from which on.
inline ImuSamples with_stuck_axis(ImuSamples samples, Eigen::Vector3d ImuSample::*sensor, int axis, double begin = 0) {
  const Timestamp from = samples.front().time + seconds(begin);
  const ImuSample* stuck = nullptr;
  for (ImuSample& sample : samples) {
    if (sample.time < from) continue;
    if (stuck == nullptr) stuck = &sample;
    (sample.*sensor)[axis] = (stuck->*sensor)[axis];
  }
  return samples;
}

/// The accelerometer's noise, vibration included, by axis: rms of what a measurement differs from the mean of its
/// neighbours, for white noise of variance 1 brought to 1.
inline Eigen::Vector3d accelerometer_noise(const ImuSamples& samples) {
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  for (std::size_t i = 1; i + 1 < samples.size(); ++i) {
    const Eigen::Vector3d bend = samples[i - 1].accel - 2 * samples[i].accel + samples[i + 1].accel;
    squares += bend.cwiseProduct(bend);
  }
  return (squares / (6.0 * static_cast<double>(samples.size() - 2))).cwiseSqrt();
}

/// White noise is added, so that in all the accelerometer's noise is tenfold.
inline ImuSamples with_tenfold_accelerometer_noise(ImuSamples samples, Rng rng) {
  const Eigen::Vector3d added = std::sqrt(99.0) * accelerometer_noise(samples);
  for (ImuSample& sample : samples)
    for (int axis = 0; axis < 3; ++axis) sample.accel[axis] += rng.normal(0, added[axis]);
  return samples;
}

}  // namespace chainslam::test
