#include "simulator/drive.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

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
  Rng stops = rng.fork(0);
  for (double at = options.between_stops * stops.uniform(0.5, 1.5); options.between_stops > 0.0 && at < path.length();
       at += options.between_stops * stops.uniform(0.5, 1.5)) {
    const auto stop = std::ranges::lower_bound(path.distances, at);
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
  const double phase = rng.fork(3).uniform(0.0, 2.0 * std::numbers::pi);
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
    const double shake = std::min(1.5, speed / options.vibration_speed);
    const double pitch = -std::atan(slope.dot(ahead)) - options.dive * push;
    const double roll = std::atan(slope.dot(left) * std::cos(pitch)) + options.lean * pull;
    Control control;
    control << position, terrain.height(position) + options.body_height, roll, pitch, heading;
    control[2] += heave.next(shake * options.vibration_height);
    control[3] += rolling.next(shake * options.vibration_angle);
    control[4] += pitching.next(shake * options.vibration_angle);
    control[4] += options.sway_angle * std::min(1.0, speed) *
                  std::sin(2.0 * std::numbers::pi * static_cast<double>(i) * step / options.sway_period + phase);
    controls.push_back(control);
  }
  // Two more at rest before the first, so that the spline begins where the first one has its weight.
  controls.insert(controls.begin(), 2, controls.front());
  return controls;
}

std::vector<double> plan_distances(const DriveOptions& options, const LanePath& path, const Rng& rng) {
  Rng moods = rng.fork(0);
  std::vector<double> driven = distances_over_time(options, path, plan_speeds(options, path, moods));
  for (int pass = 0; pass < 2; ++pass) driven = smoothed(driven, 5);
  return driven;
}

}  // namespace

Drive::Drive(const DriveOptions& options, const Route& route, const Town& town, const Rng& rng)
    : path_(follow_lane(town.streets, route, {.lane = options.lane, .radii = options.corners, .narrow = town.narrow})),
      driven_(plan_distances(options, path_, rng)),
      spline_(lay_controls(options, path_, town.terrain, driven_, rng.fork(1)), step) {}

double Drive::driven(double time) const {
  const double last = static_cast<double>(driven_.size() - 2);
  const double whole = std::clamp(std::floor(time / step), 0.0, last);
  const auto i = static_cast<std::size_t>(whole);
  return driven_[i] + std::clamp(time / step - whole, 0.0, 1.0) * (driven_[i + 1] - driven_[i]);
}

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
