#include "keyframe_sets.hpp"

#include <cstdint>
#include <memory>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/odometry/odometry_source.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "datasets/dataset.hpp"

namespace chainslam::lamm {

namespace {

void add_frame(const Frame& frame, KeyframeSelector& select, KeyframeSet& set) {
  set.drive.odometry.times.push_back(frame.time);
  set.drive.odometry.poses.push_back(frame.T_odom_body);
  set.frames.push_back(record_of(frame));
  std::optional<Keyframe> keyframe = select(frame);
  if (!keyframe) return;
  keyframe->T_map_body = keyframe->T_odom_body;
  set.drive.scans.push_back({.frame = set.drive.frames() - 1, .cloud = keyframe->cloud.load()});
  set.keyframes.push_back(std::move(*keyframe));
}

void note(std::int64_t count, const char* what, std::vector<std::string>& notes) {
  if (count > 0) notes.push_back(std::to_string(count) + " frames left out: " + what);
}

}  // namespace

KeyframeSet read_keyframe_set(const std::filesystem::path& folder) {
  const std::unique_ptr<datasets::Dataset> dataset = datasets::open_dataset(folder);
  if (!dataset->info().has_odometry)
    throw_input_error(folder.string(), "", "a data set without odometry",
                      "record it first: chainslam odometry DATA --out SET");
  KeyframeSet set;
  set.drive.name = dataset->info().name;
  set.truth = dataset->truth();
  set.truth_frame = dataset->info().truth_frame;
  set.title = set.drive.name + (dataset->info().source.empty() ? "" : " (" + dataset->info().source + ")");
  KeyframeSelector select({.distance = 0, .scan_voxel = 0, .scan_step = 0});  // all that were kept, as they were
  RecordedOdometry odometry([&] {
    std::optional<Frame> frame = dataset->next_frame();
    static_cast<void>(dataset->take_fixes());
    return frame;
  });
  while (const std::optional<Frame> frame = odometry.next()) add_frame(*frame, select, set);
  note(odometry.not_finite(), "their poses are not finite", set.notes);
  note(odometry.too_far(), "their poses are more than 1e9 m from the origin", set.notes);
  note(odometry.out_of_order(), "not later than the one before", set.notes);
  for (const std::string& warning : dataset->info().warnings) set.notes.push_back(warning);
  if (set.keyframes.empty())
    throw_input_error(folder.string(), "",
                      std::to_string(set.frames.size()) + " frames, none of which has a scan of use",
                      "run `chainslam inspect` on it");
  return set;
}

}  // namespace chainslam::lamm
