#include <doctest/doctest.h>

#include <cmath>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "chainslam/slam/back_end.hpp"
#include "chainslam/slam/proximity_or_places.hpp"
#include "support/real_data.hpp"

using namespace chainslam;

namespace {

/// A walk round a courtyard with a hand-held scanner: keyframes with odometry, and the recorder's own optimized poses.
struct Walk {
  std::vector<Keyframe> keyframes;
  std::vector<SE3d> recorder;
};

Walk read_walk(const std::filesystem::path& folder) {
  Walk walk;
  walk.recorder = read_kitti_poses(folder / "optimized_poses.txt").poses;
  const std::vector<SE3d> odometry = read_kitti_poses(folder / "odom_poses.txt").poses;
  std::ifstream times(folder / "times.txt");
  for (std::size_t i = 0; i < odometry.size(); ++i) {
    const std::string number = std::to_string(i);
    const PointCloud<float> scan = read_pcd(folder / "Scans" / (std::string(6 - number.size(), '0') + number + ".pcd"));
    double time = 0;
    times >> time;
    Keyframe keyframe;
    keyframe.time = Timestamp::from_seconds(time);
    keyframe.T_odom_body = odometry[i];
    keyframe.cloud = std::make_shared<const PointCloud<float>>(voxel_downsample(scan, 0.4));
    walk.keyframes.push_back(std::move(keyframe));
  }
  return walk;
}

/// Odometry whose lengths are 2 % too long and that turns 0.06 degrees too far with every keyframe.
std::vector<Keyframe> spoiled(std::vector<Keyframe> keyframes) {
  const SO3d turn = SO3d::exp({0, 0, 0.001});
  SE3d before = keyframes.front().T_odom_body;
  for (std::size_t i = 1; i < keyframes.size(); ++i) {
    const SE3d step = before.inverse() * keyframes[i].T_odom_body;
    before = keyframes[i].T_odom_body;
    keyframes[i].T_odom_body = keyframes[i - 1].T_odom_body * SE3d(step.rotation() * turn, 1.02 * step.translation());
  }
  return keyframes;
}

std::shared_ptr<const SlamMap> mapped(const std::vector<Keyframe>& keyframes) {
  BackEnd<LoopCloser<>, NoChaining, NoMerging> back_end;
  for (const Keyframe& keyframe : keyframes) back_end.add(keyframe);
  return back_end.finish();
}

/// Odometry that slips by 20 m and a radian in one step, after a third of the way.
std::vector<Keyframe> broken(std::vector<Keyframe> keyframes) {
  const SE3d T_first = keyframes[keyframes.size() / 3].T_odom_body;
  const SE3d slip = T_first * SE3d(SO3d::exp({0, 0, 1}), {20, 0, 0}) * T_first.inverse();
  for (std::size_t i = keyframes.size() / 3; i < keyframes.size(); ++i)
    keyframes[i].T_odom_body = slip * keyframes[i].T_odom_body;
  return keyframes;
}

/// Mean distance, metres, of the last 30 scans from the planes of the first 30, where the walk has come back to its
/// start: how blurred the poses leave that place. Measured without anything that closed the loop.
template <class Pose>
double blur(const std::vector<Keyframe>& keyframes, Pose&& pose) {
  constexpr std::size_t some = 30;
  PointCloud<float> start;
  for (std::size_t i = 0; i < some; ++i) {
    const PointCloud<float> seen = transformed(*keyframes[i].cloud.load(), pose(i));
    start.positions.insert(start.positions.end(), seen.positions.begin(), seen.positions.end());
  }
  start = voxel_downsample(start, 0.15);
  estimate_normals(start, NormalOptions{.neighbors = 12, .radius = 1.0});
  const IndexedCloud<> map(std::move(start));
  double sum = 0;
  double count = 0;
  for (std::size_t i = keyframes.size() - some; i < keyframes.size(); ++i) {
    for (const Eigen::Vector3f& p : transformed(*keyframes[i].cloud.load(), pose(i)).positions) {
      Neighbor<float> nearest;
      if (map.knn(p, std::span(&nearest, 1), 0.5F) == 0) continue;
      sum += static_cast<double>(std::abs(map.normal(nearest.index).dot(p - map.position(nearest.index))));
      ++count;
    }
  }
  return sum / count;
}

/// The pose of the last keyframe seen from the first.
template <class Pose>
SE3d start_to_end(std::size_t count, Pose&& pose) {
  return pose(0).inverse() * pose(count - 1);
}

}  // namespace

TEST_SUITE("slam on real walks") {
  TEST_CASE("each walk closes its loop and leaves its start as sharp as odometry did") {
    for (const std::string name : {"session1", "session2"}) {
      const auto folder = test::real_data("hku_square_two_sessions/" + name);
      if (!folder) return;
      const Walk walk = read_walk(*folder);
      const std::size_t n = walk.keyframes.size();
      const auto map = mapped(walk.keyframes);
      const auto optimized = [&](std::size_t i) { return map->keyframes[i].T_map_body; };
      const auto odometry = [&](std::size_t i) { return map->keyframes[i].T_odom_body; };
      const auto recorder = [&](std::size_t i) { return walk.recorder[i]; };
      const SE3d difference = start_to_end(n, recorder).inverse() * start_to_end(n, optimized);
      const double ours = blur(map->keyframes, optimized);
      MESSAGE(name, ": ", map->closures.size(), " closures, ", map->refusals.size(), " refusals; end ",
              difference.translation().norm(), " m from the recorder's; blur ", ours, " m, odometry's ",
              blur(map->keyframes, odometry), " m, recorder's ", blur(map->keyframes, recorder), " m");
      CHECK(map->closures.size() >= 1);
      CHECK(difference.translation().norm() < 0.5);
      // The odometry of these walks hardly drifts (the recorder's closures did harm): there is nothing to win.
      CHECK(ours < 1.1 * blur(map->keyframes, odometry));
      CHECK(ours < blur(map->keyframes, recorder));
    }
  }

  TEST_CASE("odometry that was spoiled on purpose is mended") {
    for (const std::string name : {"session1", "session2"}) {
      const auto folder = test::real_data("hku_square_two_sessions/" + name);
      if (!folder) return;
      const Walk walk = read_walk(*folder);
      const std::size_t n = walk.keyframes.size();
      const auto map = mapped(spoiled(walk.keyframes));
      const SE3d truth = start_to_end(n, [&](std::size_t i) { return walk.keyframes[i].T_odom_body; });
      const SE3d before = start_to_end(n, [&](std::size_t i) { return map->keyframes[i].T_odom_body; });
      const SE3d after = start_to_end(n, [&](std::size_t i) { return map->keyframes[i].T_map_body; });
      const double drift = (truth.inverse() * before).translation().norm();
      const double left = (truth.inverse() * after).translation().norm();
      MESSAGE(name, ": end ", drift, " m off, ", left, " m after ", map->closures.size(), " closures");
      CHECK(drift > 1.0);
      CHECK(left < 0.2 * drift);
    }
  }

  TEST_CASE("where odometry slipped by 20 m, what the end looks like leads back to the start") {
    PlaceCandidateOptions places;  // finer than outdoors
    places.submap_length = 10;
    places.spacing = 2;
    places.max_drawn = 0;
    places.image = {.cell_size = 0.25, .max_range = 50};
    places.index.consensus.max_distance = 0.75;
    const auto folder = test::real_data("hku_square_two_sessions/session1");
    if (!folder) return;
    const Walk walk = read_walk(*folder);
    const std::size_t n = walk.keyframes.size();
    const SE3d truth = start_to_end(n, [&](std::size_t i) { return walk.keyframes[i].T_odom_body; });
    for (const Index count : {0, 2}) {
      places.max_count = count;
      using Closer = LoopCloser<ProximityOrPlaces>;
      BackEnd<Closer, NoChaining, NoMerging> back_end({}, Closer({}, ProximityOrPlaces({}, PlaceCandidates(places))));
      for (const Keyframe& keyframe : broken(walk.keyframes)) back_end.add(keyframe);
      const auto map = back_end.finish();
      const SE3d end = start_to_end(n, [&](std::size_t i) { return map->keyframes[i].T_map_body; });
      const double off = (truth.inverse() * end).translation().norm();
      MESSAGE(count, " places: end ", off, " m off, ", map->closures.size(), " closures, ", map->refusals.size(),
              " refusals");
      CHECK((count == 0 ? off > 10 : off < 0.5));
    }
  }
}
