#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "clouds.hpp"
#include "search/structure.hpp"

namespace chainslam::bench {

/// Whether only to see that the benches run: CHAINSLAM_BENCH_BRIEF=1, as `bench/run.sh --smoke` sets it.
inline bool brief() {
  const char* value = std::getenv("CHAINSLAM_BENCH_BRIEF");
  return value != nullptr && *value == '1';
}

/// One scan of the walk.
struct Step {
  Points scan;
  /// The scan as an iterated filter asks for it again: moved by less each time. Every tenth scan has them.
  std::vector<Points> again;
  /// What the map leaves behind after this scan, if it moves.
  std::vector<Move> moves;
};

/// Points moved about a center by some centimetres and tenths of a degree times `size`.
inline Points moved_a_little(const Points& points, const Eigen::Vector3f& center, float size) {
  const Eigen::AngleAxisf turn(0.003f * size, Eigen::Vector3f(0.3f, -0.2f, 0.93f).normalized());
  const Eigen::Vector3f shift = size * Eigen::Vector3f(0.04f, -0.03f, 0.01f);
  Points moved;
  for (const Eigen::Vector3f& p : points) moved.emplace_back(center + turn * (p - center) + shift);
  return moved;
}

/// What LiDAR odometry asks of its map (Xu et al. 2022, FAST-LIO2): a walk along the streets of the made city, at each
/// crossing in a random direction but back, 1 m a scan; scans thinned to the means of 0.5 m voxels, about 8 000 points;
/// whenever the sensor has moved 20 m, the map keeps the square of +-100 m around it.
class Walk {
 public:
  explicit Walk(int scans) {
    const City city;
    Rng rng(7);
    Eigen::Vector2i crossing(0, 0), heading(1, 0);
    Eigen::Vector2d center(0, 0);
    for (int i = 0; i < scans; ++i) {
      if (i > 0 && i % block == 0) {
        crossing += heading;
        heading = next_heading(rng, crossing, heading);
      }
      const Eigen::Vector2d eye = block * crossing.cast<double>() + (i % block) * heading.cast<double>();
      Step& step = steps_.emplace_back();
      step.scan =
          voxel_downsample(city.scan({eye.x(), eye.y(), 1.8}, static_cast<std::uint64_t>(i)), map_voxel).positions;
      // Each time a fifth of the last: a filter that converges.
      if (i % again_every == 0)
        for (const float size : {1.0f, 0.2f, 0.04f})
          step.again.push_back(moved_a_little(step.scan, Eigen::Vector3d(eye.x(), eye.y(), 1.8).cast<float>(), size));
      if ((eye - center).norm() >= move_every) {
        step.moves.push_back(move(center, eye));
        center = eye;
      }
    }
  }

  [[nodiscard]] const std::vector<Step>& steps() const { return steps_; }

 private:
  static constexpr int block = 40, again_every = 10;
  static constexpr double move_every = 20, half_side = 100, everywhere = 1e4;

  /// Straight on, left or right, but not out of the city.
  static Eigen::Vector2i next_heading(Rng& rng, const Eigen::Vector2i& crossing, const Eigen::Vector2i& heading) {
    constexpr int last_crossing = 4;
    for (;;) {
      const Index turn = rng.uniform_index(3);
      const Eigen::Vector2i left(-heading.y(), heading.x());
      const Eigen::Vector2i next = turn == 0 ? heading : turn == 1 ? left : Eigen::Vector2i(-left);
      if ((crossing + next).cwiseAbs().maxCoeff() <= last_crossing) return next;
    }
  }

  static Box square(const Eigen::Vector2d& center) {
    const Eigen::Vector2f low = (center.array() - half_side).cast<float>();
    const Eigen::Vector2f high = (center.array() + half_side).cast<float>();
    constexpr auto far = static_cast<float>(everywhere);
    return {{low.x(), low.y(), -far}, {high.x(), high.y(), far}};
  }

  static Move move(const Eigen::Vector2d& from, const Eigen::Vector2d& to) {
    const Box old = square(from);
    Move move{square(to), {}};
    for (const Eigen::Index axis : {0, 1}) {
      Box left = old;
      if (move.keep.low[axis] > old.low[axis]) {
        left.high[axis] = move.keep.low[axis];
      } else if (move.keep.high[axis] < old.high[axis]) {
        left.low[axis] = move.keep.high[axis];
      } else {
        continue;
      }
      move.left.push_back(left);
    }
    return move;
  }

  std::vector<Step> steps_;
};

/// 300 scans.
inline const Walk& walk() {
  static const Walk made(brief() ? 30 : 300);
  return made;
}

}  // namespace chainslam::bench
