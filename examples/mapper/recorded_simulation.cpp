#include "recorded_simulation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/files.hpp"
#include "drive_choice.hpp"
#include "recorded_input.hpp"
#include "simulator/recorded_drive.hpp"
#include "support/configuration.hpp"
#include "support/nearest_name.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

/// Where another drive through the same world is kept.
fs::path other_file(const fs::path& folder, std::size_t i) {
  return folder / "simulation" / ("other" + std::to_string(i + 1) + ".tum");
}

simulator::RecordedDriveOptions options_of(const DriveChoice& choice) {
  simulator::RecordedDriveOptions options;
  const auto kind = simulator::lidar_kind(choice.lidar);
  if (!kind)
    throw support::ConfigError(
        "--lidar", "there is no such LiDAR",
        choice.lidar + support::suggestion(choice.lidar, support::names_of_list(simulator::lidar_names())),
        "take one of: " + simulator::lidar_names());
  const Index in_packet = simulator::lidar_model(*kind).firings_per_packet;
  options.lidar.kind = *kind;
  options.lidar.firings_per_revolution = std::max(Index{1}, (choice.columns + in_packet / 2) / in_packet) * in_packet;
  options.lidar.T_body_lidar = choice.T_body_lidar;
  options.lidar_height = choice.lidar_height;
  options.seed = choice.seed;
  if (choice.gnss) {
    options.gnss.emplace().needs_sky = true;
    options.gnss->antenna_body.setZero();
  }
  return options;
}

std::string source_of(const SimulateArguments& arguments, const RecordedInput& input) {
  const auto kind = simulator::lidar_kind(arguments.lidar);
  const std::string lidar(kind ? simulator::lidar_model(*kind).name : arguments.lidar);
  return "simulated scans (" + lidar + ") on the recorded trajectory " + arguments.trajectory.filename().string() +
         ", " + (input.imu.empty() ? "simulated IMU data" : "real IMU data from " + arguments.imu.filename().string()) +
         (arguments.gnss ? ", simulated GNSS fixes" : "") +
         (input.others.empty() ? ""
                               : ", in a world that " + std::to_string(input.others.size()) + " more drives share");
}

/// What the IMU's rows and the spline say of each other.
std::string agreement_of(const simulator::RecordedDrive& drive, const RecordedInput& input) {
  const simulator::ImuAgreement fit = simulator::compare(drive.motion(), drive.imu(), drive.epoch());
  char line[400];
  std::snprintf(
      line, sizeof(line),
      "%sIMU against the trajectory: stamped %.0f ms late, rates within %.4f of %.4f rad/s, specific forces "
      "within %.2f of %.2f m/s^2 (rms); %zu rows kept, %zu left out\n",
      fit.gyro_rms > 0.5 * fit.gyro_signal ? "warning: the IMU does not seem to belong to the trajectory\n" : "",
      1e3 * fit.lag, fit.gyro_rms, fit.gyro_signal, fit.accel_rms, fit.accel_signal, input.imu.size(),
      input.imu_dropped);
  return line;
}

/// What of the path has no road of its own; empty if all has.
std::string ground_warning(const simulator::RecordedDrive& drive) {
  constexpr double limit = 0.8;  // metres: half of what the trajectory may be off itself where it comes back
  const double length = drive.off_ground(limit);
  if (length == 0.0) return "";
  char line[200];
  std::snprintf(line, sizeof(line),
                "warning: %.0f m of the path lie more than %.1f m off the ground: bridges, or heights that drift, are "
                "not modelled\n",
                length, limit);
  return line;
}

class RecordedDataset final : public datasets::Dataset {
 public:
  RecordedDataset(const fs::path& folder, std::unique_ptr<simulator::RecordedDrive> drive, std::string source,
                  std::string truth_frame)
      : drive_(std::move(drive)) {
    info_.truth_frame = std::move(truth_frame);
    info_.path = folder;
    info_.name = datasets::folder_name(folder);
    info_.start = drive_->epoch();
    info_.end = drive_->end();
    info_.T_body_lidar = drive_->options().lidar.T_body_lidar;
    info_.source = std::move(source);
    info_.sensors = {{std::string(drive_->lidar().model().name), SensorKind::lidar,
                      static_cast<std::size_t>(drive_->scan_count()), "simulated"},
                     {"IMU", SensorKind::imu, drive_->imu().size(), ""}};
    if (drive_->options().gnss) {
      info_.sensors.push_back({"GNSS receiver", SensorKind::gnss, drive_->gnss().size(), "simulated"});
      info_.p_body_antenna = drive_->options().gnss->antenna_body;
    }
    info_.notes = {info_.source};
  }

  [[nodiscard]] std::optional<Packet> next() override { return drive_->next(); }
  [[nodiscard]] std::optional<Trajectory> truth() const override { return drive_->truth_at_scan_ends(); }

 private:
  std::unique_ptr<simulator::RecordedDrive> drive_;
};

/// Drives through one world have their truths in one frame, that of the first of them; empty for a drive by itself.
std::string truth_frame_of(const RecordedInput& input, const DriveChoice& choice) {
  if (input.others.empty()) return "";
  Timestamp first = input.trajectory.times.front();
  std::size_t poses = input.trajectory.size();
  for (const Trajectory& other : input.others) {
    first = std::min(first, other.times.front());
    poses += other.size();
  }
  return "world along " + std::to_string(1 + input.others.size()) + " drives of " + std::to_string(poses) +
         " poses from " + std::to_string(first.nanoseconds()) + " on, seed " + std::to_string(choice.seed);
}

/// @throws ConfigError where trajectory, IMU and what is said of them do not go together.
std::unique_ptr<simulator::RecordedDrive> make_drive(const RecordedInput& input, const DriveChoice& choice) {
  try {
    return std::make_unique<simulator::RecordedDrive>(input.trajectory, input.imu, options_of(choice), input.others);
  } catch (const std::invalid_argument& error) {
    throw support::ConfigError(error.what());
  }
}

}  // namespace

RecordedSimulation make_recorded_simulation(const SimulateArguments& arguments) {
  RecordedInput input = read_recorded_input(arguments);
  const DriveChoice choice{.lidar = arguments.lidar,
                           .columns = arguments.columns,
                           .lidar_height = arguments.lidar_height,
                           .seed = arguments.seed,
                           .recorded_imu = !input.imu.empty(),
                           .others = input.others.size(),
                           .gnss = arguments.gnss,
                           .T_body_lidar = input.T_body_lidar};
  RecordedSimulation simulation;
  simulation.drive = make_drive(input, choice);
  if (!input.imu.empty()) simulation.agreement = agreement_of(*simulation.drive, input);
  simulation.agreement += ground_warning(*simulation.drive);
  simulation.texts = {.source = source_of(arguments, input),
                      .options = text_of(choice),
                      .imu_rows = std::move(input.imu_rows),
                      .trajectory = std::move(input.trajectory),
                      .others = std::move(input.others)};
  return simulation;
}

std::unique_ptr<datasets::Dataset> open_recorded_simulation(const fs::path& folder) {
  const fs::path choices = folder / "simulation/options.json";
  if (!fs::is_regular_file(choices)) return nullptr;
  const DriveChoice choice = read_choice(choices);
  RecordedInput input{.trajectory = read_tum(folder / "simulation/trajectory.tum"),
                      .T_body_lidar = choice.T_body_lidar,
                      .imu = {},
                      .imu_rows = {}};
  check_drive(input.trajectory, folder / "simulation/trajectory.tum");
  for (std::size_t i = 0; i < choice.others; ++i)
    check_drive(input.others.emplace_back(read_tum(other_file(folder, i))), other_file(folder, i));
  if (choice.recorded_imu) {
    SimulateArguments arguments;
    arguments.imu = folder / "imu.csv";
    read_recorded_imu(arguments, {}, {}, input);
  }
  InputFile source(folder / "simulation/source.txt");
  auto drive = make_drive(input, choice);
  return std::make_unique<RecordedDataset>(
      folder, std::move(drive), std::string(source.read_line().value_or("simulated")), truth_frame_of(input, choice));
}

}  // namespace chainslam::mapper
