#include <doctest/doctest.h>

#include <cstddef>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/registration/verified_registration.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "chainslam/slam/map_merger.hpp"
#include "chainslam/slam/submap.hpp"
#include "simulator/hard_presets.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::simulator {
namespace {

constexpr double degree = 0.017453292519943295;

/// Keyframes of a drive where it truly was, eight metres apart; scans are made when they are asked for.
class TrueKeyframes {
 public:
  explicit TrueKeyframes(std::size_t session) : drive_(mars_hard(PresetSize::small), 1, session) {
    for (Index scan = 0; scan < drive_.scan_count(); ++scan) {
      const SE3d T_map_body = drive_.truth(drive_.scan_end(scan));
      if (!keyframes_.empty() &&
          (T_map_body.translation() - keyframes_.back().T_map_body.translation()).norm() < spacing)
        continue;
      Keyframe keyframe{.id = KeyframeId{to_index(keyframes_.size())}, .session = SessionId{0}};
      keyframe.time = drive_.scan_end(scan);
      keyframe.T_map_body = keyframe.T_odom_body = T_map_body;
      keyframes_.push_back(keyframe);
      scans_.push_back(scan);
    }
  }

  [[nodiscard]] const std::vector<Keyframe>& all() const { return keyframes_; }

  void make_scans(SubmapRange range) {
    for (Index i = range.begin; i < range.end; ++i) {
      Keyframe& keyframe = keyframes_[static_cast<std::size_t>(i)];
      if (!keyframe.cloud) keyframe.cloud = cloud_of(scans_[static_cast<std::size_t>(i)], keyframe.T_map_body);
    }
  }

 private:
  static constexpr double spacing = 8;  // metres

  /// Each point from where the car was at its time.
  [[nodiscard]] std::shared_ptr<const PointCloud<float>> cloud_of(Index number, const SE3d& T_map_body) const {
    const LidarScan scan = drive_.scan(number);
    PointCloud<float> cloud;
    for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
      const Timestamp then = scan.time + seconds(static_cast<double>(time_offset(scan.cloud, i)));
      const SE3d T_body_lidar = T_map_body.inverse() * drive_.truth(then) * drive_.lidar().true_T_body_lidar();
      cloud.positions.push_back((T_body_lidar * position(scan.cloud, i)).cast<float>());
    }
    return std::make_shared<const PointCloud<float>>(voxel_downsample(cloud, 0.5));
  }

  TownDrive drive_;
  std::vector<Keyframe> keyframes_;
  std::vector<Index> scans_;
};

/// Keyframes of two drives, within `most` metres of each other.
using Meeting = std::pair<KeyframeId, KeyframeId>;

/// Where the second drive comes upon the first one's way, a hundred metres or more apart.
std::vector<Meeting> meetings(const TrueKeyframes& first, const TrueKeyframes& second, double most) {
  std::vector<Meeting> found;
  for (const Keyframe& i : second.all()) {
    if (i.id.value < 8 || (!found.empty() && i.id.value - found.back().second.value < 14)) continue;
    for (const Keyframe& j : first.all())
      if ((i.T_map_body.translation() - j.T_map_body.translation()).norm() < most) {
        found.emplace_back(j.id, i.id);
        break;
      }
  }
  return found;
}

/// What the default gate says of keyframe `scan` of another drive in the submap around `j`.
LoopClosure close(const TrueKeyframes& drive, KeyframeId j, Keyframe scan, const SE3d& guess) {
  std::vector<Keyframe> keyframes = drive.all();
  scan.id = KeyframeId{to_index(keyframes.size())};
  scan.session = SessionId{1};
  keyframes.push_back(scan);
  return LoopCloser<>().align(keyframes, j, scan.id, guess);
}

bool right(const SE3d& T, const SE3d& truth) {
  const SE3d off = truth.inverse() * T;
  return off.translation().norm() < 1.5 && off.rotation().log().norm() < 3 * degree;
}

}  // namespace

TEST_SUITE("simulator: merging among traffic") {
  TEST_CASE("submaps are found by verified poses where features alone find few; scans close there and nowhere else") {
    TrueKeyframes first(0), second(1);
    const MergeOptions options;
    int places = 0, verified = 0, by_features = 0, closed = 0;
    std::optional<Keyframe> elsewhere;
    for (const Meeting& meeting : meetings(first, second, 12)) {
      if (++places > 4) break;
      const auto [j, i] = meeting;
      const SubmapRange there = submap_range(first.all(), j, options.submap_radius, options.submap_length);
      SubmapRange here = submap_range(second.all(), i, options.submap_radius, options.submap_length);
      here.end = i.value + 1;
      first.make_scans(there);
      second.make_scans(here);
      const PointCloud<float> target = assemble_submap(first.all(), j, there, options.voxel_size);
      const PointCloud<float> source = assemble_submap(second.all(), i, here, options.voxel_size);
      const auto at = [](const TrueKeyframes& keyframes, KeyframeId id) -> const Keyframe& {
        return keyframes.all()[static_cast<std::size_t>(id.value)];
      };
      const SE3d truth = at(first, j).T_map_body.inverse() * at(second, i).T_map_body;
      const GlobalAlignResult found = VerifiedRegistration<>::for_submaps().align(source, target);
      CHECK((!found.found() || right(found.T_target_source, truth)));
      verified += found.found() ? 1 : 0;
      const GlobalAlignResult ransac = FeatureRegistration<>{}.align(source, target);
      by_features += ransac.found() && ransac.fitness_target >= options.min_fitness &&
                             ransac.putative_ratio >= options.min_putative && right(ransac.T_target_source, truth)
                         ? 1
                         : 0;
      const SE3d guess = truth * SE3d(SO3d::exp({0, 0, 2 * degree}), {1.2, -0.6, 0});
      const LoopClosure closure = close(first, j, at(second, i), guess);
      CHECK((closure.verdict != ClosureVerdict::accepted || right(closure.T_from_to, truth)));
      closed += closure.verdict == ClosureVerdict::accepted ? 1 : 0;
      if (elsewhere) CHECK(close(first, j, *elsewhere, guess).verdict != ClosureVerdict::accepted);
      elsewhere = at(second, i);
    }
    CAPTURE(by_features);
    CHECK(places >= 4);
    CHECK(verified >= 3);
    CHECK(by_features < verified);
    CHECK(closed >= 3);
  }
}

}  // namespace chainslam::simulator
