#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/io/trajectory_file.hpp"

namespace chainslam::bench {

/// A made city: a street grid of 40 m blocks on 560 m x 560 m, one building of 5 to 25 m a block, poles along the
/// streets, seen by a 32-beam LiDAR with 1024 columns, 80 m range and 2 cm noise that walks at 1 m a scan.
class City {
 public:
  explicit City(std::uint64_t seed = 1) : rng_(seed) {
    for (int bx = 0; bx < blocks; ++bx)
      for (int by = 0; by < blocks; ++by) {
        const Eigen::Vector2d corner(block * (bx - blocks / 2), block * (by - blocks / 2));
        const Eigen::Vector2d low = corner + Eigen::Vector2d(rng_.uniform(7, 11), rng_.uniform(7, 11));
        const Eigen::Vector2d high = corner + Eigen::Vector2d(rng_.uniform(29, 33), rng_.uniform(29, 33));
        buildings_.push_back({low, high, rng_.uniform(5, 25)});
        for (const double along : {5.0, 15.0, 25.0, 35.0}) poles_.emplace_back(corner + Eigen::Vector2d(along, 4.5));
      }
  }

  /// Scan number `step`, in the city's frame, metres.
  [[nodiscard]] PointCloud<float> scan(int step) const {
    return scan(position(step), static_cast<std::uint64_t>(step));
  }

  /// A scan from anywhere; `stream` chooses its noise.
  [[nodiscard]] PointCloud<float> scan(const Eigen::Vector3d& eye, std::uint64_t stream) const {
    const City around = within_range(eye);
    Rng rng = rng_.fork(stream);
    PointCloud<float> cloud;
    for (int beam = 0; beam < 32; ++beam) {
      const double elevation = (-25.0 + 40.0 * beam / 31.0) * std::numbers::pi / 180.0;
      for (int column = 0; column < 1024; ++column) {
        const double azimuth = 2 * std::numbers::pi * column / 1024;
        const Eigen::Vector3d direction(std::cos(elevation) * std::cos(azimuth),
                                        std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
        const double range = around.cast(eye, direction);
        if (range > max_range) continue;
        cloud.positions.push_back((eye + (range + rng.normal(0, 0.02)) * direction).cast<float>());
      }
    }
    return cloud;
  }

  /// Where scan `step` was taken: to and fro along one street, 1 m a step.
  [[nodiscard]] static Eigen::Vector3d position(int step) {
    const int along = step % 400;
    return {along < 200 ? along - 100.0 : 300.0 - along, 1.0 + 0.001 * step, 1.8};
  }

 private:
  struct Building {
    Eigen::Vector2d low, high;
    double height;
  };
  static constexpr int blocks = 14;
  static constexpr double block = 40, max_range = 80, pole_radius = 0.15, pole_height = 6;

  struct Nothing {};
  explicit City(Nothing) {}

  /// The part of the city that a scan can reach.
  [[nodiscard]] City within_range(const Eigen::Vector3d& eye) const {
    City part{Nothing{}};
    for (const Building& building : buildings_) {
      const Eigen::Vector2d nearest = eye.head<2>().cwiseMax(building.low).cwiseMin(building.high);
      if ((nearest - eye.head<2>()).norm() < max_range) part.buildings_.push_back(building);
    }
    for (const Eigen::Vector2d& pole : poles_)
      if ((pole - eye.head<2>()).norm() < max_range + pole_radius) part.poles_.push_back(pole);
    return part;
  }

  /// Range to the first thing hit, infinity if none.
  [[nodiscard]] double cast(const Eigen::Vector3d& eye, const Eigen::Vector3d& direction) const {
    double range = direction[2] < 0 ? -eye[2] / direction[2] : std::numeric_limits<double>::infinity();
    for (const Building& building : buildings_) range = std::min(range, hit(building, eye, direction));
    for (const Eigen::Vector2d& pole : poles_) range = std::min(range, hit(pole, eye, direction));
    return range;
  }

  [[nodiscard]] static double hit(const Building& building, const Eigen::Vector3d& eye,
                                  const Eigen::Vector3d& direction) {
    double enter = 0, leave = std::numeric_limits<double>::infinity();
    for (Eigen::Index axis = 0; axis < 2; ++axis) {
      const double a = (building.low[axis] - eye[axis]) / direction[axis];
      const double b = (building.high[axis] - eye[axis]) / direction[axis];
      enter = std::max(enter, std::min(a, b));
      leave = std::min(leave, std::max(a, b));
    }
    const double height = eye[2] + enter * direction[2];
    return enter < leave && height < building.height ? enter : std::numeric_limits<double>::infinity();
  }

  [[nodiscard]] static double hit(const Eigen::Vector2d& pole, const Eigen::Vector3d& eye,
                                  const Eigen::Vector3d& direction) {
    const Eigen::Vector2d to_pole = pole - eye.head<2>();
    const double flat = direction.head<2>().norm();
    const double along = to_pole.dot(direction.head<2>()) / flat;
    const double across = to_pole.squaredNorm() - along * along;
    if (along < 0 || across > pole_radius * pole_radius) return std::numeric_limits<double>::infinity();
    const double range = (along - std::sqrt(pole_radius * pole_radius - across)) / flat;
    return eye[2] + range * direction[2] < pole_height ? range : std::numeric_limits<double>::infinity();
  }

  Rng rng_;
  std::vector<Building> buildings_;
  std::vector<Eigen::Vector2d> poles_;
};

/// Two scans of the same place: the first is indexed, the second asks.
struct ScanPair {
  std::string name;
  PointCloud<float> first;
  PointCloud<float> second;
};

/// KITTI 00, frames 94 and 95, if CHAINSLAM_UNPACKED_DATA says where; and two scans of the city.
inline const std::vector<ScanPair>& scan_pairs() {
  static const std::vector<ScanPair> pairs = [] {
    std::vector<ScanPair> made;
    if (const char* root = std::getenv("CHAINSLAM_UNPACKED_DATA")) {
      const auto folder = std::filesystem::path(root) / "registration_pairs/kitti00_094_095/kitti00_094_095";
      for (const auto& place : {folder, folder.parent_path()})
        if (made.empty() && std::filesystem::exists(place / "000094.bin"))
          made.push_back({"kitti", read_kitti_bin(place / "000094.bin"), read_kitti_bin(place / "000095.bin")});
    }
    const City city;
    made.push_back({"city", city.scan(0), city.scan(1)});
    return made;
  }();
  return pairs;
}

}  // namespace chainslam::bench
