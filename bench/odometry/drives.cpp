// Accuracy of the odometries on real drives and on data sets given as folders, as Markdown: see bench/results.md.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "datasets/dataset.hpp"
#include "odometry/drive_table.hpp"
#include "odometry/random_starts.hpp"
#include "support/imu_faults.hpp"
#include "support/real_data.hpp"
#include "support/real_drives.hpp"
#include "support/semi_real_drives.hpp"
#include "table_file.hpp"

namespace chainslam::bench {
namespace {

using test::Drive;

struct Options {
  std::filesystem::path out;
  std::string only;  ///< drives whose name contains this
  int starts = 0;    ///< at random times of the semi-real drives
  std::uint64_t seed = 1;
  std::vector<std::filesystem::path> datasets;
};

/// One after the other, so that each has the caches to itself.
void add_drive(DriveTable& table, const std::string& name, const std::string& variant, const Drive& drive) {
  const auto outcome = [&]<class Source>(Source) {
    auto options = Source::options();
    options.T_body_lidar = drive.T_body_lidar;
    return outcome_of(drive, test::run_drive<typename Source::Odometry>(drive, options));
  };
  table.add(name, variant, {outcome(LidarSource{}), outcome(FastLio2Source{}), outcome(LidarInertialSource{})});
}

template <class NextPacket>
void add_packets(DriveTable& table, const std::string& name, const std::string& variant, const Drive& drive,
                 NextPacket&& next_packet) {
  table.add(name, variant, outcomes_of<LidarSource, FastLio2Source, LidarInertialSource>(drive, next_packet));
}

/// The drive as it is, without its IMU, and with an IMU that is at fault.
void add_imu_variants(DriveTable& table, const std::string& name, const Drive& drive) {
  const auto add = [&](const std::string& variant, test::ImuSamples imu) {
    Drive changed = drive;
    changed.imu = std::move(imu);
    add_drive(table, name, variant, changed);
  };
  constexpr double pi = std::numbers::pi;
  add_drive(table, name, "IMU in the corrected clock", drive);
  add("no IMU", {});
  add("IMU 70 ms late, as recorded", test::stamped_late(drive.imu, 0.070));
  add("IMU 200 ms late", test::stamped_late(drive.imu, 0.200));
  add("IMU turned by 90 deg about z, not told", test::turned(drive.imu, SO3d::exp({0, 0, pi / 2})));
  add("IMU turned by 180 deg about z, not told", test::turned(drive.imu, SO3d::exp({0, 0, pi})));
  add("IMU upside down (180 deg about x), not told", test::turned(drive.imu, SO3d::exp({pi, 0, 0})));
  add("1 % spikes of 1e3 to 1e30", test::with_spikes(drive.imu, 0.01, Rng(1)));
  add("IMU in g and deg/s, not told", test::in_g_and_degrees(drive.imu));
  add("gyroscope's z axis stuck", test::with_stuck_axis(drive.imu, &ImuSample::gyro, 2));
  add("accelerometer's x axis stuck", test::with_stuck_axis(drive.imu, &ImuSample::accel, 0));
  add("tenfold accelerometer noise", test::with_tenfold_accelerometer_noise(drive.imu, Rng(1)));
}

void add_first101(DriveTable& table) {
  const auto drive = test::kitti00_first101();
  if (!drive) return;
  const std::string name = "KITTI 00, first 101 scans";
  add_imu_variants(table, name, *drive);
  add_drive(table, name, "with the IMU rows that were interpolated over the first 1.4 s",
            *test::kitti00_first101(test::ImuRows::with_filled_gaps));
  for (std::size_t n = 2; n <= 5; ++n)
    add_drive(table, name, "one scan of " + std::to_string(n), test::every_nth_scan(*drive, n));
}

void add_keyframes(DriveTable& table) {
  const auto drive = test::kitti00_keyframes();
  if (!drive) return;
  const std::string name = "KITTI 00, 228 raw sweeps";
  add_imu_variants(table, name, *drive);
  add_drive(table, name, "with the IMU rows that were interpolated over its gaps",
            *test::kitti00_keyframes(test::PointTimes::from_azimuth, test::ImuRows::with_filled_gaps));
  add_drive(table, name, "as snapshots, without point times", *test::kitti00_keyframes(test::PointTimes::none));
}

void add_nuscenes(DriveTable& table) {
  if (const auto drive = test::nuscenes_scene()) add_drive(table, "nuScenes at 2 Hz", "no IMU", *drive);
}

/// A data set that a reader knows, with the truth that it brings along, if any.
void add_dataset(DriveTable& table, const std::string& name, const std::string& variant,
                 const std::filesystem::path& path) {
  Drive drive;  // its scans are read one by one
  const auto dataset = datasets::open_dataset(path);
  drive.T_body_lidar = dataset->info().T_body_lidar;
  if (const auto truth = dataset->truth()) drive.reference = *truth;
  for (SE3d& pose : drive.reference.poses) pose = pose * drive.T_body_lidar;
  add_packets(table, name, variant, drive, [&] { return dataset->next(); });
}

void add_muehlburger_tor(DriveTable& table) {
  if (const auto path = test::real_data("muehlburger_tor/muehlburger_tor"))
    add_dataset(table, "Muehlburger Tor", "no IMU, no truth: the path is 292 m long", *path);
}

/// The first line of a folder's README.txt, which says what is simulated of it and what is real.
std::string said_of(const std::filesystem::path& folder) {
  std::ifstream file(folder / "README.txt");
  std::string line;
  std::getline(file, line);
  std::ranges::replace(line, '|', '/');  // which would end the cell
  return line;
}

bool chosen(const Options& options, const std::string& name) { return name.find(options.only) != std::string::npos; }

std::string semi_real_name(const test::KittiSequence& sequence) { return std::string("semi_real_") + sequence.name; }

void add_semi_real(DriveTable& table, const Options& options) {
  for (const test::KittiSequence& sequence : test::kitti_imu_sequences) {
    if (!chosen(options, semi_real_name(sequence))) continue;
    if (const auto drive = test::semi_real_drive(sequence))
      add_packets(table, std::string("KITTI ") + sequence.name, "simulated scans, real IMU",
                  test::without_scans(*drive), [&] { return drive->next(); });
  }
}

std::string random_starts(const Options& options) {
  if (options.starts == 0) return {};
  RandomStarts starts(options.starts, options.seed);
  std::vector<std::unique_ptr<simulator::RecordedDrive>> drives;
  std::vector<Index> scans;
  for (const test::KittiSequence& sequence : test::kitti_imu_sequences)
    if (auto drive = test::semi_real_drive(sequence)) {
      scans.push_back(drive->scan_count());
      drives.push_back(std::move(drive));
    }
  for (std::size_t i = 0; i < drives.size(); ++i)
    for (const Index first : starts.of_drive(i, scans))
      starts.run(std::string("KITTI ") + test::kitti_imu_sequences[i].name, *drives[i], first);
  return starts.markdown();
}

std::string tables(const Options& options) {
  DriveTable real("Real drives"), semi_real("Semi-real drives: simulated scans, real IMU");
  const std::pair<const char*, void (*)(DriveTable&)> drives[] = {{"kitti00_first101", add_first101},
                                                                  {"kitti00_keyframes_imu", add_keyframes},
                                                                  {"nuscenes_scene", add_nuscenes},
                                                                  {"muehlburger_tor", add_muehlburger_tor}};
  for (const auto& [name, add] : drives)
    if (chosen(options, name)) add(real);
  add_semi_real(semi_real, options);
  DriveTable given("Data sets given as folders");
  for (const std::filesystem::path& path : options.datasets)
    add_dataset(given, (path / ".").parent_path().filename().string(), said_of(path), path);
  return "APE of the LiDAR's positions (rms, aligned by a rotation and a translation), KITTI's relative translation "
         "error where the path is longer than 100 m, scans lost, processor time per scan.\n\n" +
         real.markdown() + semi_real.markdown(true) + random_starts(options) + given.markdown(true);
}

}  // namespace
}  // namespace chainslam::bench

int main(int count, char** words) {
  using namespace chainslam;
  bench::Options options;
  CLI::App app("Accuracy of the odometries on drives, as Markdown");
  app.add_option("--out", options.out, "where the tables go")->required();
  app.add_option("--only", options.only, "only drives whose name contains this");
  app.add_option("--starts", options.starts, "starts at random times of the semi-real drives")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--seed", options.seed, "of these times");
  app.add_option("datasets", options.datasets, "data sets with their truth");
  CLI11_PARSE(app, count, words);
  return bench::write_table("bench_drives", options.out, [&] { return bench::tables(options); });
}
