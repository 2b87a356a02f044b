#include "simulator/recorded_drive.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

namespace chainslam::simulator {

namespace {

double since(Timestamp epoch, const ImuSample& sample) { return to_seconds(sample.time - epoch); }

/// Where up is in the trajectory's frame, about 1 long: by the specific forces, or by how the body stands.
Eigen::Vector3d mean_up(const Trajectory& trajectory, const std::vector<ImuSample>& imu) {
  const PoseSpline motion(trajectory);
  Eigen::Vector3d up = Eigen::Vector3d::Zero();
  double count = 0.0;
  for (const ImuSample& sample : imu) {
    const double time = since(trajectory.times.front(), sample);
    if (time < 0.0 || time > motion.duration()) continue;
    const Motion at = motion.motion(time);
    up += (at.T_map_body.rotation() * sample.accel - at.acceleration_map) / gravity;
    count += 1.0;
  }
  for (std::size_t i = 0; imu.empty() && i < trajectory.size(); ++i) {
    up += trajectory.poses[i].rotation() * Eigen::Vector3d::UnitZ();
    count += 1.0;
  }
  return up / std::max(1.0, count);
}

/// T_map_trajectory: from the trajectory's first position, in a frame that is level.
SE3d levelling(const Trajectory& trajectory, const std::vector<ImuSample>& imu) {
  const Eigen::Vector3d up = mean_up(trajectory, imu);
  if (!(up.norm() > 0.8 && up.norm() < 1.2))
    throw std::invalid_argument(imu.empty()
                                    ? "the trajectory's body does not stay upright\n  found: z axes with a mean "
                                      "of length " +
                                          std::to_string(up.norm()) + "\n  do: say whose poses they are (--frame)"
                                    : "the IMU does not suit the trajectory\n  found: specific forces that, "
                                      "turned into its frame, have a mean of " +
                                          std::to_string(gravity * up.norm()) +
                                          " m/s^2\n  do: check units, times, and whose poses they are (--frame)");
  const Eigen::Quaterniond level = Eigen::Quaterniond::FromTwoVectors(up, Eigen::Vector3d::UnitZ());
  const SE3d from_start(SO3d(), -trajectory.poses.front().translation());
  return SE3d(SO3d::from_quaternion(level), Eigen::Vector3d::Zero()) * from_start;
}

/// All drives through the world, the one that began first first.
std::vector<const Trajectory*> in_order(const Trajectory& trajectory, std::span<const Trajectory> others) {
  std::vector<const Trajectory*> all{&trajectory};
  for (const Trajectory& other : others) all.push_back(&other);
  if (!others.empty()) std::ranges::sort(all, {}, [](const Trajectory* one) { return one->times.front(); });
  return all;
}

/// T_map_trajectory of all drives; a recorded IMU decides what is level only where a drive has the world to itself.
SE3d common_frame(const Trajectory& trajectory, const std::vector<ImuSample>& imu, std::span<const Trajectory> others) {
  return others.empty() ? levelling(trajectory, imu) : levelling(*in_order(trajectory, others).front(), {});
}

double body_height(const RecordedDriveOptions& options) {
  return options.lidar_height - options.lidar.T_body_lidar.translation().z();
}

DrivenPath path_of(const std::vector<const Trajectory*>& drives, const SE3d& T_map_trajectory, double height) {
  std::vector<PoseSpline> motions;
  for (const Trajectory* one : drives) motions.emplace_back(transformed(T_map_trajectory, *one));
  std::vector<const VehicleMotion*> all;
  for (const PoseSpline& motion : motions) all.push_back(&motion);
  return {all, height};
}

World world_along(const DrivenPath& path, const RecordedDriveOptions& options) {
  const Rng rng = Rng(options.seed).fork(0);
  return make_roadside(path, PathTerrain(path, options.ground, rng.fork(0)), options.roadside, rng.fork(1));
}

/// Mean squared difference of the rates, the samples taken to be late by `lag`.
double rate_cost(const VehicleMotion& motion, std::span<const ImuSample> imu, Timestamp epoch, double lag) {
  double sum = 0.0;
  double count = 0.0;
  const std::size_t stride = 1 + imu.size() / 4000;
  for (std::size_t i = 0; i < imu.size(); i += stride) {
    const double time = since(epoch, imu[i]) - lag;
    if (time < 0.0 || time > motion.duration()) continue;
    sum += (imu[i].gyro - motion.motion(time).rate_body).squaredNorm();
    count += 1.0;
  }
  return sum / std::max(1.0, count);
}

/// Where the cost is least, to a part of the sampling by the parabola through the least and its neighbours.
double best_lag(const VehicleMotion& motion, std::span<const ImuSample> imu, Timestamp epoch) {
  constexpr double sampling = 0.01;
  constexpr int most = 25;
  std::vector<double> costs;
  for (int i = -most; i <= most; ++i) costs.push_back(rate_cost(motion, imu, epoch, i * sampling));
  const auto least = std::ranges::min_element(costs);
  const double middle = sampling * static_cast<double>(least - costs.begin() - most);
  if (least == costs.begin() || least + 1 == costs.end()) return middle;
  const double bend = least[-1] - 2.0 * least[0] + least[1];
  return bend > 0.0 ? middle + 0.5 * sampling * (least[-1] - least[1]) / bend : middle;
}

}  // namespace

ImuAgreement compare(const VehicleMotion& motion, std::span<const ImuSample> imu, Timestamp epoch) {
  ImuAgreement result;
  result.lag = best_lag(motion, imu, epoch);
  const Eigen::Vector3d up = gravity * Eigen::Vector3d::UnitZ();
  double count = 0.0;
  for (const ImuSample& sample : imu) {
    const double time = since(epoch, sample) - result.lag;
    if (time < 0.0 || time > motion.duration()) continue;
    const Motion at = motion.motion(time);
    const Eigen::Vector3d force = at.T_map_body.rotation().inverse() * (at.acceleration_map + up);
    result.gyro_rms += (sample.gyro - at.rate_body).squaredNorm();
    result.gyro_signal += sample.gyro.squaredNorm();
    result.accel_rms += (sample.accel - force).squaredNorm();
    result.accel_signal += (sample.accel - up).squaredNorm();
    count += 1.0;
  }
  for (double* sum : {&result.gyro_rms, &result.gyro_signal, &result.accel_rms, &result.accel_signal})
    *sum = std::sqrt(*sum / std::max(1.0, count));
  return result;
}

RecordedDrive::RecordedDrive(const Trajectory& trajectory, std::vector<ImuSample> imu,
                             const RecordedDriveOptions& options, std::span<const Trajectory> others)
    : RecordedDrive(trajectory, imu, options, others, common_frame(trajectory, imu, others)) {}

RecordedDrive::RecordedDrive(const Trajectory& trajectory, std::vector<ImuSample> imu,
                             const RecordedDriveOptions& options, std::span<const Trajectory> others,
                             const SE3d& T_map_trajectory)
    : options_(options),
      epoch_(trajectory.has_times() ? trajectory.times.front() : Timestamp()),
      motion_(transformed(T_map_trajectory, trajectory)),
      path_(others.empty() ? DrivenPath(motion_, body_height(options))
                           : path_of(in_order(trajectory, others), T_map_trajectory, body_height(options))),
      length_(others.empty() ? path_.length() : DrivenPath(motion_, body_height(options)).length()),
      caster_(world_along(path_, options)),
      lidar_(options.lidar, Rng(options.seed).fork(1)),
      imu_(imu.empty() ? record_imu(motion_, options.imu, epoch_, Rng(options.seed).fork(2)) : std::move(imu)),
      scan_count_(static_cast<Index>(motion_.duration() / options.lidar.period)) {
  if (options.gnss) gnss_ = record_gnss(motion_, caster_, *options.gnss, epoch_, Rng(options.seed).fork(3));
}

std::optional<Packet> RecordedDrive::next() {
  while (next_gnss_ < gnss_.size() && gnss_[next_gnss_].fix.quality == GnssQuality::none) ++next_gnss_;
  while (next_scan_ < scan_count_ && !lidar_.arrives(next_scan_)) ++next_scan_;
  const bool imu = next_imu_ < imu_.size();
  const bool gnss = next_gnss_ < gnss_.size();
  const bool scan = next_scan_ < scan_count_;
  const auto comes_before = [](Timestamp time, bool other, Timestamp other_time) {
    return !other || time <= other_time;
  };
  const Timestamp scan_time = scan ? scan_end(next_scan_) : Timestamp();
  const Timestamp gnss_time = gnss ? gnss_[next_gnss_].time : Timestamp();
  if (imu && comes_before(imu_[next_imu_].time, gnss, gnss_time) && comes_before(imu_[next_imu_].time, scan, scan_time))
    return imu_[next_imu_++];
  if (gnss && comes_before(gnss_time, scan, scan_time)) return gnss_[next_gnss_++].fix;
  if (scan) return this->scan(next_scan_++);
  return std::nullopt;
}

double RecordedDrive::off_ground(double limit) const {
  double length = 0.0;
  for (const PathSample& sample : path_.samples()) {
    const double ground = caster_.world().ground.height_at(sample.position());
    if (std::abs(ground - sample.ground.z()) > limit) length += DrivenPath::spacing;
  }
  return length;
}

Trajectory RecordedDrive::truth_at_scan_ends() const {
  Trajectory trajectory;
  for (Index i = 0; i < scan_count_; ++i) {
    trajectory.times.push_back(scan_end(i));
    trajectory.poses.push_back(motion_.pose(to_seconds(scan_end(i) - epoch_)));
  }
  return trajectory;
}

}  // namespace chainslam::simulator
