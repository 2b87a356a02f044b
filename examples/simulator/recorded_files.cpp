#include "simulator/recorded_files.hpp"

#include <cstdio>
#include <string>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "simulator/new_folder.hpp"
#include "simulator/scan_batches.hpp"

namespace chainslam::simulator {

namespace {

namespace fs = std::filesystem;

void write_text(const fs::path& path, const std::string& text) {
  AtomicFile file(path);
  file.write(text);
  file.commit();
}

std::string scan_name(Index index) {
  const std::string digits = std::to_string(index);
  return std::string(digits.size() < 6 ? 6 - digits.size() : 0, '0') + digits + ".pcd";
}

std::string seconds_text(Timestamp time) {
  std::string text;
  chainslam::detail::append_seconds(text, time);
  return text;
}

/// Nanoseconds of the clock, so that the values are the simulator's to the last printed digit.
std::string row_of(const ImuSample& sample) {
  std::string row = seconds_text(sample.time);
  for (const Eigen::Vector3d* v : {&sample.gyro, &sample.accel})
    for (int axis = 0; axis < 3; ++axis) {
      char number[40];
      std::snprintf(number, sizeof(number), ",%.9g", (*v)[axis]);
      row += number;
    }
  return row;
}

void write_imu(const fs::path& path, const RecordedDrive& drive, const RecordedTexts& texts) {
  AtomicFile file(path);
  file.write(std::string("timestamp,gx,gy,gz,ax,ay,az\n"));
  for (const std::string& row : texts.imu_rows) file.write(row + "\n");
  if (texts.imu_rows.empty())
    for (const ImuSample& sample : drive.imu()) file.write(row_of(sample) + "\n");
  file.commit();
}

std::string matrix_text(const SE3d& T) {
  const Eigen::Matrix3d R = T.rotation().matrix();
  std::string text;
  for (int row = 0; row < 3; ++row) {
    char line[160];
    std::snprintf(line, sizeof(line), "%.12g %.12g %.12g %.12g\n", R(row, 0), R(row, 1), R(row, 2),
                  T.translation()[row]);
    text += line;
  }
  return text;
}

std::string readme(const RecordedDrive& drive, const RecordedTexts& texts, const SimulationReport& report) {
  return texts.source +
         ".\n\nEvery figure from these data has to say so.\n\nscans: " + std::to_string(drive.scan_count()) + " of a " +
         std::string(drive.lidar().model().name) + ", points: " + std::to_string(report.points) +
         "\nduration: " + std::to_string(report.duration) + " s\nlength: " + std::to_string(report.length) +
         " m\nseed: " + std::to_string(drive.options().seed) +
         "\n\nscans/*.pcd: x y z (m), intensity, time (s since the scan's start); not corrected for motion.\n"
         "times.txt: start of each scan, s.\n"
         "imu.csv: rad/s and m/s^2 in the body frame.\n"
         "truth.tum: t x y z qx qy qz qw, the body's pose at the end of each scan, map frame z up.\n"
         "T_body_lidar.txt: the nominal pose of the LiDAR in the body frame; the scans were taken from one " +
         std::to_string(drive.options().lidar.mount_angle_deg) + " deg and " +
         std::to_string(drive.options().lidar.mount_shift) +
         " m off it.\nsimulation/: what the scans can be made again from, with `chainslam map simulate:FOLDER`.\n";
}

std::uint64_t write_scans(NewFolder& folder, const RecordedDrive& drive, const ChunkRunner& run_chunks,
                          const SimulationProgress& progress) {
  std::filesystem::create_directory(folder.part("scans"));
  std::string times;
  const auto encode = [](const Revolution&) { return std::vector<std::byte>(); };
  const auto take = [&](Index index, const EncodedScan& scan) {
    times += seconds_text(drive.epoch() + scan.revolution.start) + "\n";
    write_pcd(folder.part(fs::path("scans") / scan_name(index)),
              drive.lidar().to_scan(scan.revolution, drive.epoch()).cloud);
  };
  Index done = 0;
  const std::uint64_t points = for_each_scan(drive, run_chunks, encode, take, [&](Index made) {
    done += made;
    if (progress) progress(done, drive.scan_count());
  });
  write_text(folder.part("times.txt"), times);
  return points;
}

}  // namespace

SimulationReport write_recorded_drive(const RecordedDrive& drive, const RecordedTexts& texts, const fs::path& directory,
                                      bool with_scans, const ChunkRunner& run_chunks,
                                      const SimulationProgress& progress) {
  NewFolder folder(directory);
  SimulationReport report{.scans = drive.scan_count(),
                          .points = 0,
                          .duration = drive.motion().duration(),
                          .length = drive.length(),
                          .bytes = 0};
  if (with_scans) report.points = write_scans(folder, drive, run_chunks, progress);
  write_imu(folder.part("imu.csv"), drive, texts);
  write_tum(folder.part("truth.tum"), drive.truth_at_scan_ends());
  write_text(folder.part("T_body_lidar.txt"), matrix_text(drive.options().lidar.T_body_lidar));
  fs::create_directory(folder.part("simulation"));
  write_text(folder.part("simulation/source.txt"), texts.source + "\n");
  write_text(folder.part("simulation/options.json"), texts.options);
  write_tum(folder.part("simulation/trajectory.tum"), texts.trajectory);
  for (std::size_t i = 0; i < texts.others.size(); ++i)
    write_tum(folder.part("simulation/other" + std::to_string(i + 1) + ".tum"), texts.others[i]);
  write_text(folder.part("README.txt"), readme(drive, texts, report));
  report.bytes = folder.keep();
  return report;
}

}  // namespace chainslam::simulator
