#pragma once

#include <Eigen/Core>
#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::test {

/// A rectangle in space: corner + [0, 1] u + [0, 1] v.
struct Facade {
  Eigen::Vector3d corner, u, v;

  [[nodiscard]] double area() const { return u.cross(v).norm(); }
};

/// Streets around a block of 40 x 40 m: ground, houses that stand back by different amounts, square poles.
struct Street {
  std::vector<Facade> facades;

  explicit Street(std::uint64_t seed = 1) {
    Rng rng(seed);
    facades.push_back({{-15, -15, 0}, {70, 0, 0}, {0, 70, 0}});
    for (const double at : {-4.0, 6.0, 16.0, 26.0, 36.0}) {
      add_house(rng, {at, -10}, 8);
      add_house(rng, {at, 50}, 8);
      add_house(rng, {-10, at}, 8);
      add_house(rng, {50, at}, 8);
    }
    for (const double x : {12.0, 28.0})
      for (const double y : {12.0, 28.0}) add_house(rng, {x, y}, 12);
    for (int pole = 0; pole < 16; ++pole) add_pole(rng, pole);
  }

  /// What a scanner at `T_map_body` sees within 25 m, each scan its own points, with a centimetre of noise.
  [[nodiscard]] std::shared_ptr<const PointCloud<float>> scan(const SE3d& T_map_body, Rng rng,
                                                              Index draws = 6000) const {
    std::vector<double> areas;
    double total = 0;
    for (const Facade& facade : facades) areas.push_back(total += facade.area());
    const SE3d T_body_map = T_map_body.inverse();
    auto cloud = std::make_shared<PointCloud<float>>();
    for (Index i = 0; i < draws; ++i) {
      const double at = rng.uniform(0, total);
      std::size_t which = 0;
      while (which + 1 < facades.size() && areas[which] < at) ++which;
      const Facade& facade = facades[which];
      const Eigen::Vector3d p_map = facade.corner + rng.uniform() * facade.u + rng.uniform() * facade.v;
      const Eigen::Vector3d noise(rng.normal(0, 0.01), rng.normal(0, 0.01), rng.normal(0, 0.01));
      const Eigen::Vector3d p_body = T_body_map * p_map + noise;
      if (p_body.norm() < 25) cloud->positions.push_back(p_body.cast<float>());
    }
    return cloud;
  }

 private:
  /// Four walls around a center, each side up to 2 m shorter than `size`, up to 1 m off.
  void add_house(Rng& rng, const Eigen::Vector2d& center, double size) {
    const Eigen::Vector2d half(0.5 * (size - rng.uniform(0, 2)), 0.5 * (size - rng.uniform(0, 2)));
    const Eigen::Vector2d middle = center + Eigen::Vector2d(rng.uniform(-1, 1), rng.uniform(-1, 1));
    add_walls(middle - half, middle + half, rng.uniform(4, 9));
  }

  /// Along the pavements, somewhere on its stretch of the way round.
  void add_pole(Rng& rng, int number) {
    const double along = 10.0 * (number % 4) + rng.uniform(2, 8);
    const double aside = number % 2 == 0 ? -3.0 : 3.0;
    const Eigen::Vector2d sides[] = {{along, aside}, {40 + aside, along}, {along, 40 + aside}, {aside, along}};
    const Eigen::Vector2d& at = sides[number / 4];
    add_walls(at.array() - 0.2, at.array() + 0.2, 4);
  }

  void add_walls(const Eigen::Vector2d& low, const Eigen::Vector2d& high, double height) {
    const Eigen::Vector3d along_x(high.x() - low.x(), 0, 0), along_y(0, high.y() - low.y(), 0), up(0, 0, height);
    facades.push_back({{low.x(), low.y(), 0}, along_x, up});
    facades.push_back({{low.x(), high.y(), 0}, along_x, up});
    facades.push_back({{low.x(), low.y(), 0}, along_y, up});
    facades.push_back({{high.x(), low.y(), 0}, along_y, up});
  }
};

/// Once round the block at 1.8 m above the ground, a pose every `step` metres, and on by `beyond` metres. The scanner
/// looks along the way and a little down.
[[nodiscard]] inline std::vector<SE3d> way_round(double step = 2.0, double beyond = 6.0) {
  constexpr double side = 40;
  std::vector<SE3d> poses;
  for (double way = 0; way <= 4 * side + beyond; way += step) {
    const auto edge = static_cast<int>(way / side);
    const double along = way - edge * side;
    const double heading = edge * std::numbers::pi / 2;
    const Eigen::Vector3d corners[] = {{0, 0, 1.8}, {side, 0, 1.8}, {side, side, 1.8}, {0, side, 1.8}};
    const Eigen::Vector3d position =
        corners[edge % 4] + along * Eigen::Vector3d(std::cos(heading), std::sin(heading), 0);
    poses.emplace_back(SO3d::exp({0, 0, heading}) * SO3d::exp({0, 0.03, 0}), position);
  }
  return poses;
}

/// Odometry whose every step errs by the same small motion.
[[nodiscard]] inline std::vector<SE3d> drifting(const std::vector<SE3d>& truth, const Vector6d& error_per_step) {
  std::vector<SE3d> poses{truth.front()};
  for (std::size_t i = 1; i < truth.size(); ++i)
    poses.push_back(poses.back() * (truth[i - 1].inverse() * truth[i]).retract(error_per_step));
  return poses;
}

/// A keyframe as odometry hands it over, without a scan; numbered and placed by the caller.
[[nodiscard]] inline Keyframe keyframe_at(double time, const SE3d& T_odom_body) {
  Keyframe keyframe;
  keyframe.time = Timestamp::from_seconds(time);
  keyframe.T_odom_body = T_odom_body;
  keyframe.T_map_body = T_odom_body;
  return keyframe;
}

/// Keyframes of one session at these poses, a second apart, as the map keeps them.
[[nodiscard]] inline std::vector<Keyframe> keyframes_at(const std::vector<SE3d>& poses) {
  std::vector<Keyframe> keyframes;
  for (const SE3d& pose : poses) {
    keyframes.push_back(keyframe_at(static_cast<double>(keyframes.size()), pose));
    keyframes.back().id = KeyframeId{to_index(keyframes.size() - 1)};
    keyframes.back().session = SessionId{0};
  }
  return keyframes;
}

inline SE3d shift(double x, double y, double z) { return SE3d(SO3d(), {x, y, z}); }

inline double translation_error(const SE3d& truth, const SE3d& estimate) {
  return (truth.inverse() * estimate).translation().norm();
}
/// Radians.
inline double rotation_error(const SE3d& truth, const SE3d& estimate) {
  return (truth.inverse() * estimate).rotation().log().norm();
}

inline const LoopCloserOptions small_submaps{.submap = {.radius = 6}};

/// A motion by up to `metres` and `radians` along each axis.
inline SE3d random_motion(Rng& rng, double metres, double radians) {
  Vector6d xi;
  for (int i = 0; i < 3; ++i) xi[i] = rng.uniform(-metres, metres);
  for (int i = 3; i < 6; ++i) xi[i] = rng.uniform(-radians, radians);
  return SE3d::exp(xi);
}

}  // namespace chainslam::test
