#include "datasets/odometry_recording.hpp"

#include <cstdio>
#include <nlohmann/json.hpp>
#include <utility>

#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/files.hpp"
#include "datasets/recorded_rows.hpp"

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

fs::path scan_file(const fs::path& folder, std::size_t number) {
  char name[32];
  std::snprintf(name, sizeof name, "%06zu.pcd", number);
  return folder / "Scans" / name;
}

fs::path with_scans(fs::path folder) {
  std::error_code error;
  if (!fs::create_directory(folder / "Scans", error))
    throw_output_error((folder / "Scans").string(), "", error ? error.message() : "there already",
                       "give an empty folder that you may write to");
  return folder;
}

void write_times(const fs::path& path, const std::vector<Timestamp>& times) {
  AtomicFile file(path);
  std::string line;
  for (const Timestamp time : times) {
    line.clear();
    detail::append_seconds(line, time);
    file.write(line += '\n');
  }
  file.commit();
}

std::string description_of(const RecordingInfo& info) {
  const nlohmann::ordered_json json = {{"format", recording_format},
                                       {"version", recording_version},
                                       {"session", info.session},
                                       {"odometry", info.odometry},
                                       {"source", info.source},
                                       {"truth_frame", info.truth_frame},
                                       {"scans", info.scans},
                                       {"frames", info.frames},
                                       {"lost_frames", info.lost_frames},
                                       {"keyframes",
                                        {{"distance", info.keyframes.distance},
                                         {"angle", info.keyframes.angle},
                                         {"scan_voxel", info.keyframes.scan_voxel},
                                         {"scan_step", info.keyframes.scan_step}}},
                                       {"notes", info.notes}};
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + '\n';
}

}  // namespace

OdometryRecording::OdometryRecording(fs::path folder)
    : folder_(with_scans(std::move(folder))), frames_(folder_ / "frames.csv"), fixes_(folder_ / "fixes.csv") {
  frames_.write(frame_table_head());
  fixes_.write(fix_table_head());
}

void OdometryRecording::add(const FrameRecord& frame, const std::optional<Keyframe>& keyframe) {
  FrameRow row{.frame = frame};
  if (keyframe) {
    row.keyframe = static_cast<std::int64_t>(keyframes_.size());
    write_pcd(scan_file(folder_, keyframes_.size()), *keyframe->cloud.load());
    keyframes_.times.push_back(keyframe->time);
    keyframes_.poses.push_back(keyframe->T_odom_body);
  }
  frames_.write(text_of(row));
  ++frame_count_;
  lost_ += frame.health.status == FrameStatus::lost ? 1 : 0;
}

void OdometryRecording::add(const GnssFix& fix) {
  fixes_.write(text_of(FixRow{.fix = fix, .frames_before = frame_count_}));
  ++fix_count_;
}

void OdometryRecording::finish(RecordingInfo info, const std::optional<Trajectory>& truth) {
  info.frames = frame_count_;
  info.lost_frames = lost_;
  write_times(folder_ / "times.txt", keyframes_.times);
  write_kitti_poses(folder_ / "odom_poses.txt", keyframes_);
  frames_.commit();
  if (fix_count_ > 0) fixes_.commit();
  if (truth) write_tum(folder_ / "truth.tum", *truth);
  AtomicFile description(folder_ / recording_description);
  description.write(description_of(info));
  description.commit();
}

}  // namespace chainslam::datasets
