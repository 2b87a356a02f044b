#include "simulator/town_drive.hpp"

#include <chrono>
#include <utility>

#include "simulator/day.hpp"

namespace chainslam::simulator {

namespace {

constexpr std::chrono::sys_days first_day = std::chrono::year(2013) / std::chrono::June / 1;
constexpr Duration noon = std::chrono::hours(12);

}  // namespace

TownDrive::TownDrive(const Preset& preset, std::uint64_t seed, std::size_t session)
    : TownDrive(preset, preset.sessions.at(session), Rng(seed),
                make_town(preset.town, Rng(seed).fork(0), preset.sessions.at(session).day)) {}

TownDrive::TownDrive(const Preset& preset, const SessionPlan& session, const Rng& rng, Town town)
    : epoch_((first_day + std::chrono::days(session.day)).time_since_epoch() + noon),
      drive_(preset.drive, session.route, town, on_day(rng.fork(1), session.day)),
      terrain_(town.terrain),
      caster_(std::move(town.world)),
      traffic_(preset.traffic, drive_, on_day(rng.fork(5), session.day)),
      lidar_(preset.lidar, rng.fork(2), session.day),
      imu_(record_imu(drive_, preset.imu, epoch_, rng.fork(3), session.day)),
      gnss_(record_gnss(drive_, caster_, preset.gnss, epoch_, on_day(rng.fork(4), session.day))),
      scan_count_(static_cast<Index>(drive_.duration() / preset.lidar.period)) {}

Revolution TownDrive::revolution(Index index) const {
  const double start = to_seconds(index * lidar_.period());
  const double stop = start + to_seconds(lidar_.period());
  return lidar_.turn(caster_, drive_, index, traffic_.during(drive_, terrain_, start, stop));
}

std::optional<Packet> TownDrive::next() {
  while (next_scan_ < scan_count_ && !lidar_.arrives(next_scan_)) ++next_scan_;
  while (next_gnss_ < gnss_.size() && gnss_[next_gnss_].fix.quality == GnssQuality::none) ++next_gnss_;
  const bool imu = next_imu_ < imu_.size();
  const bool gnss = next_gnss_ < gnss_.size();
  const bool scan = next_scan_ < scan_count_;
  const Timestamp never = end() + seconds(1.0);
  const Timestamp imu_time = imu ? imu_[next_imu_].time : never;
  const Timestamp gnss_time = gnss ? gnss_[next_gnss_].time : never;
  const Timestamp scan_time = scan ? scan_end(next_scan_) : never;
  if (imu && imu_time <= gnss_time && imu_time <= scan_time) return imu_[next_imu_++];
  if (gnss && gnss_time <= scan_time) return gnss_[next_gnss_++].fix;
  if (scan) return this->scan(next_scan_++);
  return std::nullopt;
}

Trajectory TownDrive::truth_at_scan_ends() const {
  Trajectory trajectory;
  for (Index i = 0; i < scan_count_; ++i) {
    trajectory.times.push_back(scan_end(i));
    trajectory.poses.push_back(truth(trajectory.times.back()));
  }
  return trajectory;
}

Trajectory TownDrive::truth_at_imu_rate() const {
  Trajectory trajectory;
  for (const ImuSample& sample : imu_) {
    trajectory.times.push_back(sample.time);
    trajectory.poses.push_back(truth(sample.time));
  }
  return trajectory;
}

}  // namespace chainslam::simulator
