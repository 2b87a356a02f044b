// Recordings of odometry of many long simulated sessions, for maps of tens of thousands of keyframes: scans are
// simulated at keyframes alone and corrected by the true motion, and odometry's drift is drawn. See README.md
// in this folder.

#include <CLI/CLI.hpp>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "chainslam/cloud/quantize.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "corrected_sweep.hpp"
#include "datasets/odometry_recording.hpp"
#include "graph/drawn_session.hpp"
#include "graph/drifting_odometry.hpp"
#include "simulator/large_presets.hpp"
#include "simulator/wander.hpp"

namespace chainslam::experiments {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  fs::path out;
  std::string preset = "nclt-hard", size = "full";
  std::size_t first = 1, last = 27;  ///< sessions, counted from 1
  std::uint64_t seed = 1;
  double distance = 3;           ///< metres between keyframes
  std::size_t keyframes = 1850;  ///< at which a session ends: as long as NCLT's are in the mean
  bool keyframes_only = false;
};

/// The preset's sessions, then more walks through all of its streets, as long, 18 days apart.
simulator::Preset with_sessions(simulator::Preset preset, std::size_t count) {
  const auto& grid = preset.town.streets;
  const Index streets = to_index(preset.sessions.front().route.size()) - 1;
  while (preset.sessions.size() < count) {
    const std::uint64_t number = preset.sessions.size();
    preset.sessions.push_back(
        {.route = simulator::wander({{0, 0}, {grid.columns - 1, grid.rows - 1}}, streets, Rng(2013).fork(number)),
         .day = preset.sessions.back().day + 18});
  }
  return preset;
}

/// @returns the number of keyframes.
std::size_t record(const Arguments& arguments, const simulator::Preset& preset, std::size_t session) {
  const simulator::TownDrive drive(preset, arguments.seed, session);
  const std::string name = "session" + std::to_string(session + 1);
  fs::create_directories(arguments.out / name);
  datasets::OdometryRecording recording(arguments.out / name);
  const KeyframeOptions options{.distance = arguments.distance};
  KeyframeSelector select(options);
  DriftingOdometry odometry(Rng(arguments.seed).fork(1000 + session));
  ForceIntegral force(drive);
  auto fix = drive.gnss().begin();
  Trajectory truth;
  std::size_t keyframes = 0;
  Index scans = 0;
  for (Index i = 0; i < drive.scan_count() && keyframes < arguments.keyframes; ++i) {
    if (!drive.lidar().arrives(i)) continue;
    ++scans;
    Frame frame;
    frame.time = drive.scan_end(i);
    truth.times.push_back(frame.time);
    truth.poses.push_back(drive.truth(frame.time));
    frame.T_odom_body = odometry.follow(truth.poses.back());
    frame.health.imu_use = ImuUse::all;
    frame.cloud.positions.emplace_back(1.0F, 0.0F, 0.0F);  // in place of the scan, until it is one of a keyframe
    std::optional<Keyframe> keyframe = select(frame);
    if (!keyframe && arguments.keyframes_only) continue;
    for (; fix != drive.gnss().end() && fix->time <= frame.time; ++fix)
      if (fix->mode != 0) recording.add(fix->fix);
    FrameRecord row = record_of(frame);
    row.covariance = hardly_any_covariance();
    row.delta_velocity = force.until(frame.time);
    if (keyframe) {
      const PointCloud<float> sweep = bench::corrected_sweep(drive, i, preset.lidar.T_body_lidar);
      keyframe->cloud = std::make_shared<const PointCloud<float>>(
          quantized(voxel_downsample(sweep, options.scan_voxel), options.scan_step));
      ++keyframes;
    }
    recording.add(row, keyframe);
  }
  recording.finish(
      {.session = name, .odometry = "drawn", .truth_frame = preset.name, .scans = scans, .keyframes = options}, truth);
  std::printf("%s: %zu keyframes, %d scans\n", name.c_str(), keyframes, static_cast<int>(scans));
  return keyframes;
}

void run(const Arguments& arguments) {
  const auto size = simulator::preset_size(arguments.size);
  const auto preset = size ? simulator::preset(arguments.preset, *size) : std::nullopt;
  if (!preset) throw std::invalid_argument("no preset " + arguments.preset + " of size " + arguments.size);
  const simulator::Preset all = with_sessions(*preset, arguments.last);
  std::size_t keyframes = 0;
  for (std::size_t i = arguments.first; i <= arguments.last; ++i) keyframes += record(arguments, all, i - 1);
  std::printf("%zu keyframes\n", keyframes);
}

}  // namespace
}  // namespace chainslam::experiments

int main(int count, char** words) {
  chainslam::experiments::Arguments arguments;
  CLI::App app("Recordings of odometry of long simulated sessions, whose drift is drawn");
  app.add_option("OUT", arguments.out, "folder of the recordings")->required();
  app.add_option("--preset", arguments.preset, "of the simulator")->capture_default_str();
  app.add_option("--size", arguments.size, "of the preset")->capture_default_str();
  app.add_option("--first", arguments.first, "session, from 1")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--last", arguments.last, "session")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--seed", arguments.seed)->capture_default_str();
  app.add_option("--distance", arguments.distance, "between keyframes, metres")->capture_default_str();
  app.add_option("--keyframes", arguments.keyframes, "after which a session ends")->capture_default_str();
  app.add_flag("--keyframes-only", arguments.keyframes_only, "frames of keyframes alone, not of every scan");
  CLI11_PARSE(app, count, words);
  try {
    std::setvbuf(stdout, nullptr, _IOLBF, 0);
    chainslam::experiments::run(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "keyframe_drives: %s\n", error.what());
    return 3;
  }
  return 0;
}
