// A multi-session back end made from its parts, with a rule of one's own for which keyframes to close loops with.

#include <chainslam/chainslam.hpp>
#include <cstdio>
#include <numbers>

using namespace chainslam;
/// Tries the nearest keyframe of each earlier session, and none of this one.
struct NearestOfEachSession {
  double radius = 20.0;  // metres

  bool eligible(const Keyframe& candidate, const Keyframe& query) const { return candidate.session < query.session; }
  std::vector<KeyframeId> find(std::span<const Keyframe> keyframes, const PositionIndex& index,
                               KeyframeId query) const {
    const Keyframe& here = keyframes[static_cast<std::size_t>(query.value)];
    std::vector<KeyframeId> chosen;
    std::vector<SessionId> seen;
    for (const auto& [id, distance] : index.within(here.T_map_body.translation(), radius)) {
      const Keyframe& there = keyframes[static_cast<std::size_t>(id.value)];
      if (!eligible(there, here) || std::ranges::find(seen, there.session) != seen.end()) continue;
      seen.push_back(there.session);
      chosen.push_back(id);
    }
    return chosen;
  }
};

/// What a scanner sees of a hall with a wavy wall, pillars and a floor, from x metres off its centre.
PointCloud<float> scan(double x) {
  PointCloud<float> cloud;
  for (int i = 0; i < 3600; ++i) {
    const double angle = i * std::numbers::pi / 1800, wall = 18 + 3 * std::sin(3 * angle) + 2 * std::cos(7 * angle);
    const double range = i % 360 < 20 + i / 90 ? 6 + i / 360 : wall;
    for (int k = 0; k < 10; ++k) {  // half of them on the floor
      const double way = k < 5 ? 0.18 * (k + 1) * range : range, height = k < 5 ? -1.5 : k - 6;
      cloud.positions.push_back(
          Eigen::Vector3d(way * std::cos(angle) - x, way * std::sin(angle), height).cast<float>());
    }
  }
  return cloud;
}

int main() {
  using Closer = LoopCloser<NearestOfEachSession, Icp<PointToPlane>, HessianCovariance>;
  BackEnd<Closer, ChainedCloser, MapMerger<>> back_end({}, Closer({.min_travel = 1.0}), ChainedCloser());
  for (const char* name : {"morning", "noon", "evening"}) {
    back_end.begin_session(name);
    for (int i = 0; i < 24; ++i) {
      const double x = i - 11.5;  // metres; each session's odometry starts at an origin of its own
      const GnssFix fix{.position_ecef = {6378137, x, 0}, .quality = GnssQuality::three_dimensional};
      back_end.add(Keyframe{.time = Timestamp::from_seconds(i),
                            .T_odom_body = SE3d({}, {1.0 * i, 0, 0}),
                            .cloud = std::make_shared<const PointCloud<float>>(scan(x)),
                            .gnss = fix});
    }
  }
  const auto map = back_end.finish();
  const auto chained = std::ranges::count(map->closures, ClosureKind::chained, &LoopClosure::kind);
  std::printf("%zu closures, %d of them chained\n", map->closures.size(), static_cast<int>(chained));
}
