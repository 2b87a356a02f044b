#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "corrected_sweep.hpp"
#include "datasets/dataset.hpp"
#include "simulator/town_drive.hpp"
#include "slam/closure_gates/known_drive.hpp"
#include "support/drive_run.hpp"
#include "support/real_data.hpp"
#include "support/real_drives.hpp"
#include "support/real_matrix.hpp"

namespace chainslam::bench {

/// A map and the drive whose scans are sought in it; both of one place.
struct Meeting {
  KnownDrive map;
  KnownDrive query;
};

/// Keyframes of a drive that is split into halves are picked twice as densely.
[[nodiscard]] inline Picking half_distance(Picking picking) {
  picking.distance /= 2;
  return picking;
}

[[nodiscard]] inline Meeting halves_of(const KnownDrive& drive) { return {half_of(drive, 0), half_of(drive, 1)}; }

/// T_place_body from a reference for the LiDAR, by interpolation.
[[nodiscard]] inline TruthAt truth_of(Trajectory reference, const SE3d& T_body_lidar) {
  return [reference = std::move(reference), T_lidar_body = T_body_lidar.inverse()](Timestamp time) {
    std::optional<SE3d> pose = pose_at(reference, time, seconds(1));
    if (pose) pose = *pose * T_lidar_body;
    return pose;
  };
}

/// A drive that the tests read, split into halves.
[[nodiscard]] inline Meeting follow_drive(KnownDrive known, const test::Drive& drive, const Picking& picking) {
  return halves_of(follow(std::move(known), drive.T_body_lidar, half_distance(picking),
                          truth_of(drive.reference, drive.T_body_lidar), test::packets_of(drive)));
}

/// A data set without a reference, split into halves.
[[nodiscard]] inline Meeting follow_dataset(KnownDrive known, const std::filesystem::path& path,
                                            const Picking& picking) {
  const auto dataset = datasets::open_dataset(path);
  return halves_of(follow(std::move(known), dataset->info().T_body_lidar, half_distance(picking), nullptr,
                          [&] { return dataset->next(); }));
}

/// Recorded keyframes with odometry.
/// @param T_place_odom  of the recorder's optimized poses, which are the reference.
[[nodiscard]] inline KnownDrive read_recorded(KnownDrive known, const std::filesystem::path& folder,
                                              const Picking& picking, const SE3d& T_place_odom) {
  const std::vector<SE3d> optimized = read_kitti_poses(folder / "optimized_poses.txt").poses;
  const auto dataset = datasets::open_dataset(folder);
  std::size_t row = 0;
  DriveRecorder recorder(std::move(known), picking, [&](Timestamp) { return T_place_odom * optimized.at(row); });
  for (; const std::optional<Frame> frame = dataset->next_frame(); ++row) recorder.add(*frame);
  return recorder.finish();
}

/// All real places that are at hand.
[[nodiscard]] inline std::vector<Meeting> real_meetings(const Picking& picking) {
  std::vector<Meeting> meetings;
  if (const auto folder = test::real_data("hku_square_two_sessions")) {
    const KnownDrive hku{.sensor = "Livox Avia", .place = "HKU"};
    const SE3d T_first_second = test::read_matrix(*folder / "T_session1_session2.txt");
    KnownDrive first = hku, second = hku;
    first.name = "HKU 1";
    second.name = "HKU 2";
    first = read_recorded(first, *folder / "session1", picking, SE3d());
    second = read_recorded(second, *folder / "session2", picking, T_first_second);
    meetings.push_back({first, second});
    meetings.push_back({std::move(second), std::move(first)});
  }
  if (const auto drive = test::nuscenes_scene())
    meetings.push_back(follow_drive({.name = "nuScenes", .sensor = "HDL-32E", .place = "nuScenes"}, *drive, picking));
  if (const auto folder = test::real_data("mulran_kaist03_keyframes/kaist03"))
    meetings.push_back(halves_of(read_recorded({.name = "MulRan", .sensor = "OS1-64", .place = "MulRan"}, *folder,
                                               Picking{.distance = 0, .full_every = 2}, SE3d())));  // 1 m apart: all
  if (auto drive = test::kitti00_keyframes()) {
    drive->reference = *test::internal::kitti00_truth(100);
    meetings.push_back(
        follow_drive({.name = "KITTI 00 sweeps", .sensor = "HDL-64E", .place = "KITTI 00"}, *drive, picking));
  }
  if (auto drive = test::kitti00_first101()) {
    drive->reference = *test::internal::kitti00_truth(1317600000.0);
    meetings.push_back(
        follow_drive({.name = "KITTI 00 first 101", .sensor = "HDL-64E", .place = "KITTI 00"}, *drive, picking));
  }
  for (const std::string name : {"muehlburger_tor", "durlacher_tor"})
    if (const auto folder = test::real_data(name + "/" + name))
      meetings.push_back(follow_dataset({.name = name, .sensor = "HDL-64E", .place = name}, *folder, picking));
  return meetings;
}

/// Keyframes of a simulated session. Scans are corrected by the true motion and odometry's drift is drawn, since
/// running it over all scans takes hours of which closures show nothing.
[[nodiscard]] inline KnownDrive simulate_keyframes(KnownDrive known, const simulator::Preset& preset,
                                                   std::uint64_t seed, std::size_t session, Picking picking) {
  constexpr double metres = 0.01, metres_a_metre = 0.003, radians = 3e-4, radians_a_metre = 1e-4;  // deviations
  const simulator::TownDrive drive(preset, seed, session);
  const KeyframeOptions keyframes{.distance = picking.distance};
  picking.distance = 0;  // chosen here, before they are simulated
  DriveRecorder recorder(std::move(known), picking, [&](Timestamp time) { return drive.truth(time); });
  Rng rng = Rng(seed).fork(session + 1);
  std::optional<SE3d> last;
  SE3d odometry;
  for (Index i = 0; i < drive.scan_count(); ++i) {
    const SE3d here = drive.truth(drive.scan_end(i));
    const SE3d motion = last ? last->inverse() * here : SE3d();
    const double length = motion.translation().norm();
    if (last && length < keyframes.distance && motion.rotation().log().norm() < keyframes.angle) continue;
    Vector6d drift;
    for (Eigen::Index k = 0; k < 3; ++k) {
      drift[k] = rng.normal(0, metres + metres_a_metre * length);
      drift[k + 3] = rng.normal(0, radians + radians_a_metre * length);
    }
    odometry = odometry * motion.retract(drift);
    last = here;
    Frame frame;
    frame.time = drive.scan_end(i);
    frame.T_odom_body = odometry;
    frame.cloud = corrected_sweep(drive, i, preset.lidar.T_body_lidar);
    recorder.add(frame);
  }
  return recorder.finish();
}

/// Two sessions in one simulated world, each sought in the other.
[[nodiscard]] inline std::vector<Meeting> simulated_meetings(const std::string& preset_name, const std::string& lidar,
                                                             Index firings, std::uint64_t seed,
                                                             const Picking& picking) {
  auto preset = simulator::preset(preset_name, simulator::PresetSize::small);
  const auto kind = simulator::lidar_kind(lidar);
  if (!preset || !kind) throw std::invalid_argument("no such preset or LiDAR: " + preset_name + ", " + lidar);
  preset->lidar.kind = *kind;
  preset->lidar.firings_per_revolution = firings;
  std::vector<KnownDrive> drives;
  for (const std::size_t session : {std::size_t{0}, std::size_t{1}})
    drives.push_back(simulate_keyframes({.name = preset_name + " " + std::to_string(session + 1),
                                         .sensor = lidar,
                                         .place = preset_name + " " + lidar,
                                         .real = false},
                                        *preset, seed, session, picking));
  return {{drives[0], drives[1]}, {drives[1], drives[0]}};
}

}  // namespace chainslam::bench
