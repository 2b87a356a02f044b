#include "simulator/drive.hpp"

#include <algorithm>
#include <cmath>

#include "simulator/rig.hpp"

namespace chainslam::simulator {

namespace {

constexpr double step = 0.05;  // seconds between control points

using Control = Spline<6>::Vector;

/// The highest speed at every sample of the path that keeps to the limits of corners, streets, engine and brakes.
std::vector<double> plan_speeds(const DriveOptions& options, const LanePath& path, Rng& rng) {
  const std::size_t count = path.positions.size();
  std::vector<double> speeds(count);
  constexpr double stretch = 60.0;  // metres with one mood of the driver
  double mood = 1.0;
  double until = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    if (path.distances[i] >= until) {
      mood = rng.uniform(0.85, 1.15);
      until += stretch;
    }
    const double bend = std::max(std::abs(path.curvatures[i]), 1e-6);
    speeds[i] = std::min(options.cruise * mood, std::sqrt(options.lateral_acceleration / bend));
  }
  speeds.front() = speeds.back() = 0.0;
  if (options.stop_at >= 0.0) {
    const auto stop = std::ranges::lower_bound(path.distances, options.stop_at * path.length());
    speeds[static_cast<std::size_t>(stop - path.distances.begin())] = 0.0;
  }
  for (std::size_t i = 1; i < count; ++i) {
    const double run = path.distances[i] - path.distances[i - 1];
    speeds[i] = std::min(speeds[i], std::sqrt(speeds[i - 1] * speeds[i - 1] + 2.0 * options.acceleration * run));
  }
  for (std::size_t i = count - 1; i > 0; --i) {
    const double run = path.distances[i] - path.distances[i - 1];
    speeds[i - 1] = std::min(speeds[i - 1], std::sqrt(speeds[i] * speeds[i] + 2.0 * options.braking * run));
  }
  return speeds;
}

/// Distance driven at times 0, `step`, 2 `step`, ...
std::vector<double> distances_over_time(const DriveOptions& options, const LanePath& path,
                                        const std::vector<double>& speeds) {
  std::vector<double> driven;
  double start = options.rest_at_start;  // when the vehicle leaves sample i
  for (std::size_t i = 0; i + 1 < speeds.size(); ++i) {
    if (i > 0 && speeds[i] == 0.0) start += options.stop_duration;
    const double run = path.distances[i + 1] - path.distances[i];
    const double duration = 2.0 * run / (speeds[i] + speeds[i + 1]);
    const double acceleration = (speeds[i + 1] - speeds[i]) / duration;
    for (double time = static_cast<double>(driven.size()) * step; time < start + duration;
         time = static_cast<double>(driven.size()) * step) {
      const double since = std::max(0.0, time - start);
      driven.push_back(path.distances[i] + since * (speeds[i] + 0.5 * acceleration * since));
    }
    start += duration;
  }
  const auto rest = static_cast<std::size_t>(std::ceil(options.rest_at_end / step)) + 12;
  driven.insert(driven.end(), rest, path.length());
  return driven;
}

/// Means over `2 * half + 1` samples; the ends are taken to go on for ever.
std::vector<double> smoothed(const std::vector<double>& values, int half) {
  std::vector<double> result;
  const auto last = static_cast<int>(values.size()) - 1;
  for (int i = 0; i <= last; ++i) {
    double sum = 0.0;
    for (int k = -half; k <= half; ++k) sum += values[static_cast<std::size_t>(std::clamp(i + k, 0, last))];
    result.push_back(sum / (2 * half + 1));
  }
  return result;
}

/// Where on the path a distance lies: a sample and the way to the next, 0 to 1.
struct PathPoint {
  std::size_t index;
  double part;

  PathPoint(const LanePath& path, double distance) {
    const auto above = std::ranges::upper_bound(path.distances, distance);
    const auto position = static_cast<std::size_t>(above - path.distances.begin());
    index = std::clamp<std::size_t>(position, 1, path.distances.size() - 1) - 1;
    part =
        std::clamp((distance - path.distances[index]) / (path.distances[index + 1] - path.distances[index]), 0.0, 1.0);
  }

  template <class T>
  [[nodiscard]] T of(const std::vector<T>& values) const {
    return values[index] + part * (values[index + 1] - values[index]);
  }
};

/// Small random motions that last a few control points.
class Vibration {
 public:
  explicit Vibration(Rng rng) : rng_(rng) {}

  /// The next of a sequence with mean 0 and standard deviation `scale`.
  double next(double scale) {
    constexpr double keep = 0.5;
    state_ = keep * state_ + std::sqrt(1.0 - keep * keep) * rng_.normal();
    return scale * state_;
  }

 private:
  Rng rng_;
  double state_ = 0.0;
};

std::vector<Control> lay_controls(const DriveOptions& options, const LanePath& path, const Terrain& terrain,
                                  const std::vector<double>& driven, const Rng& rng) {
  Vibration heave(rng.fork(0));
  Vibration pitching(rng.fork(1));
  Vibration rolling(rng.fork(2));
  std::vector<Control> controls;
  const std::size_t last = driven.size() - 1;
  for (std::size_t i = 0; i <= last; ++i) {
    const double before = driven[i == 0 ? 0 : i - 1];
    const double after = driven[std::min(i + 1, last)];
    const double speed = (after - before) / (2.0 * step);
    const double push = (after - 2.0 * driven[i] + before) / (step * step);
    const PathPoint at(path, driven[i]);
    const Eigen::Vector2d position = at.of(path.positions);
    const double heading = at.of(path.headings);
    const double pull = speed * speed * at.of(path.curvatures);

    const Eigen::Vector2d ahead(std::cos(heading), std::sin(heading));
    const Eigen::Vector2d left(-ahead.y(), ahead.x());
    const Eigen::Vector2d slope = terrain.slope(position);
    constexpr double dive = 0.006;  // radians per m/s^2 of braking
    constexpr double lean = 0.008;  // radians per m/s^2 of cornering
    const double shake = std::min(1.5, speed / 8.0);
    const double pitch = -std::atan(slope.dot(ahead)) - dive * push;
    const double roll = std::atan(slope.dot(left) * std::cos(pitch)) + lean * pull;
    Control control;
    control << position, terrain.height(position) + options.body_height, roll, pitch, heading;
    control[2] += heave.next(shake * options.vibration_height);
    control[3] += rolling.next(shake * options.vibration_angle);
    control[4] += pitching.next(shake * options.vibration_angle);
    controls.push_back(control);
  }
  // Two more at rest before the first, so that the spline begins where the first one has its weight.
  controls.insert(controls.begin(), 2, controls.front());
  return controls;
}

Spline<6> plan(const DriveOptions& options, const LanePath& path, const Terrain& terrain, const Rng& rng) {
  Rng moods = rng.fork(0);
  std::vector<double> driven = distances_over_time(options, path, plan_speeds(options, path, moods));
  for (int pass = 0; pass < 2; ++pass) driven = smoothed(driven, 5);
  return {lay_controls(options, path, terrain, driven, rng.fork(1)), step};
}

}  // namespace

Drive::Drive(const DriveOptions& options, const Route& route, const Town& town, const Rng& rng)
    : spline_([&] {
        const LanePath path = follow_lane(town.streets, route, options.lane);
        length_ = path.length();
        return plan(options, path, town.terrain, rng);
      }()) {}

Motion Drive::motion(double time) const {
  const Spline<6>::Point point = spline_.at(time);
  const double roll = point.value[3];
  const double pitch = point.value[4];
  // Body rates of R = Rz(yaw) Ry(pitch) Rx(roll).
  const double roll_rate = point.rate[3];
  const double pitch_rate = point.rate[4];
  const double yaw_rate = point.rate[5];
  const Eigen::Vector3d rate(roll_rate - std::sin(pitch) * yaw_rate,
                             std::cos(roll) * pitch_rate + std::sin(roll) * std::cos(pitch) * yaw_rate,
                             -std::sin(roll) * pitch_rate + std::cos(roll) * std::cos(pitch) * yaw_rate);
  return {.T_map_body = SE3d(from_roll_pitch_yaw(roll, pitch, point.value[5]), point.value.head<3>()),
          .velocity_map = point.rate.head<3>(),
          .acceleration_map = point.acceleration.head<3>(),
          .rate_body = rate};
}

}  // namespace chainslam::simulator
