// Localization in a map: a drive is found in it from nothing, and followed. Usage:
// example_localize_in_map [MAP.cslam DRIVE.cslam]: the second file's keyframes, as they were recorded, are the drive.
// Link chainslam::archive.
#include <chainslam/io/map_archive.hpp>
#include <chainslam/slam/back_end.hpp>
#include <chainslam/slam/keyframe_selector.hpp>
#include <chainslam/slam/localizer.hpp>
#include <cstdio>

#include "generated/yard_drive.hpp"

using namespace chainslam;

SlamMap made_up_map() {
  BackEnd<> back_end;
  KeyframeSelector select({.distance = 0.5});
  for (const Frame& frame : generated::yard_drive(2.0, SE3d(), 1)) back_end.add(*select(frame));
  return *back_end.finish();
}

std::vector<Frame> keyframes_of(const SlamMap& map) {
  std::vector<Frame> frames;
  for (const Keyframe& one : map.keyframes)
    if (one.session == SessionId{0})
      frames.push_back({one.time, one.T_odom_body, Matrix6d::Zero(), *one.cloud.load(), {}});
  return frames;
}

int main(int count, char** arguments) try {
  const bool made_up = count < 3;
  PlaceCandidateOptions places = localizer_places();
  if (made_up) {  // a small place, seen more finely
    places.submap_length = 10, places.spacing = 2;
    places.image = {.cell_size = 0.25, .max_range = 40};
  }
  const SlamMap map = made_up ? made_up_map() : load_map(arguments[1]).map;
  const SE3d anywhere(SO3d::exp({0, 0, 2}), {100, 50, 0});
  const std::vector<Frame> drive =
      made_up ? generated::yard_drive(-4.0, anywhere, 2) : keyframes_of(load_map(arguments[2]).map);

  Localizer<> localizer(map, {}, LoopCloser<>(), PlaceCandidates(places));
  Localization last;
  for (std::size_t i = 0; i < drive.size(); ++i) {
    const Localization now = localizer.process(drive[i]);
    if (now.T_map_body && !last.T_map_body) {
      const Eigen::Vector3d& p = now.T_map_body->translation();
      std::printf("found      at scan %zu: %.2f %.2f %.2f m in the map\n", i, p.x(), p.y(), p.z());
    }
    last = now;
  }
  const LocalizerCounts& counts = localizer.counts();
  std::printf("scans      %d, %d tracked, lost %d times\n", counts.frames, counts.tracked, counts.losses);
  if (!last.T_map_body) return std::printf("not found  in this map\n"), 1;
  std::printf("deviation  %.3f m along x\n", std::sqrt(last.covariance(0, 0)));
  if (!made_up) return 0;
  const SE3d truth = generated::yard_pose(0, 2.0).inverse() * generated::yard_pose(43, -4.0);  // the map's start is 0
  std::printf("error      %.3f m at the end\n", (truth.translation() - last.T_map_body->translation()).norm());
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
