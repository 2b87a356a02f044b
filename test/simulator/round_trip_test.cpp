#include <doctest/doctest.h>

#include <algorithm>
#include <string>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/dataset.hpp"
#include "simulator/hurry.hpp"
#include "simulator/rig.hpp"
#include "simulator/simulate.hpp"
#include "simulator/town_drive.hpp"
#include "support/files.hpp"

// What the simulator writes, read by the readers of the data sets whose layouts it writes.

namespace chainslam::simulator {
namespace {

using chainslam::test::TemporaryFolder;

struct Recorded {
  std::vector<ImuSample> imu;
  std::vector<LidarScan> scans;
  std::vector<GnssFix> fixes;
};

Recorded read_all(datasets::Dataset& dataset) {
  Recorded recorded;
  std::optional<Timestamp> last;
  while (auto packet = dataset.next()) {
    if (last) CHECK(*last <= available_at(*packet));
    last = available_at(*packet);
    if (auto* sample = std::get_if<ImuSample>(&*packet)) recorded.imu.push_back(*sample);
    if (auto* scan = std::get_if<LidarScan>(&*packet)) recorded.scans.push_back(std::move(*scan));
    if (auto* fix = std::get_if<GnssFix>(&*packet)) recorded.fixes.push_back(*fix);
  }
  return recorded;
}

/// The fixes as the vehicle's receiver streams them.
std::vector<GnssFix> fixes_of(const TownDrive& drive) {
  std::vector<GnssFix> fixes;
  for (const GnssReading& reading : drive.gnss())
    if (reading.fix.quality != GnssQuality::none) fixes.push_back(reading.fix);
  return fixes;
}

/// The largest difference of two samples' numbers; infinite if they are not of one time.
double difference(const ImuSample& a, const ImuSample& b) {
  if (a.time != b.time) return infinite_distance;
  return std::max((a.gyro - b.gyro).cwiseAbs().maxCoeff(), (a.accel - b.accel).cwiseAbs().maxCoeff());
}

/// Compares point by point: positions along each axis, times after the scans' starts are set side by side.
void check_scan(const LidarScan& read, const LidarScan& made, float position, double time) {
  REQUIRE(read.cloud.size() == made.cloud.size());
  REQUIRE(read.cloud.has_times());
  float farthest = 0.0F;
  double latest = 0.0;
  for (std::size_t i = 0; i < read.cloud.size(); ++i) {
    farthest = std::max(farthest, (read.cloud.positions[i] - made.cloud.positions[i]).cwiseAbs().maxCoeff());
    const double offset = to_seconds(read.time - made.time) + static_cast<double>(read.cloud.time_offsets[i]) -
                          static_cast<double>(made.cloud.time_offsets[i]);
    latest = std::max(latest, std::abs(offset));
  }
  CHECK(farthest <= position);
  CHECK(latest <= time);
  CHECK(read.cloud.intensities == made.cloud.intensities);
}

void check_truth(const std::optional<Trajectory>& truth, const TownDrive& drive) {
  REQUIRE(truth);
  REQUIRE(truth->size() > 20);
  for (std::size_t i = 0; i < truth->size(); i += 7)
    CHECK(truth->poses[i].local(drive.truth(truth->times[i])).norm() < 1e-5);
}

}  // namespace

TEST_SUITE("simulator/round_trip") {
  TEST_CASE("a session in NCLT's files is read as what was simulated") {
    Preset preset = *simulator::preset("nclt-like", PresetSize::small);
    preset.sessions = {{.route = {{0, 0}, {1, 0}, {1, 1}}, .day = 40}};
    chainslam::test::hurry(preset);
    preset.lidar.firings_per_revolution = 120;
    preset.gnss.latency = 0.0;
    const TemporaryFolder folder;
    static_cast<void>(simulate(preset, 9, folder / "s", ThreadPool(2)));
    const TownDrive drive(preset, 9);
    const auto dataset = datasets::open_dataset(folder / "s");
    CHECK(dataset->info().kind == datasets::DatasetKind::nclt);
    CHECK(dataset->info().T_body_lidar.local(preset.lidar.T_body_lidar).norm() < 1e-9);
    const Recorded read = read_all(*dataset);
    CHECK(dataset->info().warnings.empty());
    REQUIRE(drive.scan_count() > 50);

    REQUIRE(read.imu.size() == drive.imu().size());
    for (std::size_t i = 0; i < read.imu.size(); ++i) CHECK(difference(read.imu[i], drive.imu()[i]) < 1e-6);
    const std::vector<GnssFix> fixes = fixes_of(drive);
    REQUIRE(read.fixes.size() == fixes.size());
    for (std::size_t i = 0; i < fixes.size(); ++i) {
      CHECK(read.fixes[i].time == fixes[i].time);
      if (fixes[i].quality != GnssQuality::two_dimensional)  // else the reader keeps the last height
        CHECK((read.fixes[i].position_ecef - fixes[i].position_ecef).norm() < 2e-3);
    }
    // Turns are cut where they were made; a packet's hits, here of 12 firings in 10 ms, share the packet's time.
    REQUIRE(to_index(read.scans.size()) == drive.scan_count());
    for (Index i = 0; i < drive.scan_count(); i += 11)
      check_scan(read.scans[static_cast<std::size_t>(i)], drive.scan(i), 0.0026F, 0.0101);
    check_truth(dataset->truth(), drive);
  }

  TEST_CASE("sessions in MARS's tables are read as what was simulated, each as its scene") {
    Preset preset = *simulator::preset("mars-like", PresetSize::small);
    preset.lidar.firings_per_revolution = 30;
    preset.town.streets = {.columns = 2, .rows = 2, .block = 60.0};
    preset.town.passages.clear();
    preset.sessions = {{.route = {{0, 0}, {1, 0}, {1, 1}}, .day = 0}, {.route = {{1, 1}, {1, 0}, {0, 0}}, .day = 40}};
    chainslam::test::hurry(preset);
    const TemporaryFolder folder;
    static_cast<void>(simulate(preset, 3, folder / "MARS", ThreadPool(2)));
    std::string frame;
    for (const std::size_t session : {0U, 1U}) {
      const TownDrive drive(preset, 3, session);
      const auto dataset = datasets::open_dataset(folder / ("MARS/session" + std::to_string(session + 1)));
      CHECK(dataset->info().kind == datasets::DatasetKind::nuscenes);
      CHECK(dataset->info().T_body_lidar.local(preset.lidar.T_body_lidar).norm() < 1e-9);
      if (session == 1) CHECK(dataset->info().truth_frame == frame);
      frame = dataset->info().truth_frame;
      CHECK(!frame.empty());
      const Recorded read = read_all(*dataset);
      CHECK(dataset->info().warnings.empty());
      REQUIRE(drive.scan_count() > 50);
      REQUIRE(read.imu.size() == drive.imu().size());
      for (std::size_t i = 0; i < read.imu.size(); ++i) CHECK(difference(read.imu[i], drive.imu()[i]) == 0.0);
      CHECK(read.fixes.size() >= fixes_of(drive).size() / 2);  // a sample carries the nearest fix, if there is one
      REQUIRE(to_index(read.scans.size()) == drive.scan_count());
      for (Index i = 0; i < drive.scan_count(); i += 11) {
        const LidarScan &scan = read.scans[static_cast<std::size_t>(i)], made = drive.scan(i);
        CHECK(scan.end.nanoseconds() / 1000 == made.end.nanoseconds() / 1000);
        // The reader starts a turn its period before its end, which is a firing of 3.3 ms too early; lasers look up
        // to 6.4 degrees off their firing's azimuth, 1.8 ms of the turn, and so does the first.
        check_scan(scan, made, 0.0F, 0.008);
      }
      check_truth(dataset->truth(), drive);
    }
  }
}

}  // namespace chainslam::simulator
