#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/registration/icp.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam::bench {

/// Two crops of two real scans, the source turned about its sensor at random.
struct CropPair {
  PointCloud<float> source, target;  ///< each in its sensor's frame
  SE3d T_target_source;
  std::uint64_t seed = 0;
};

/// The recall protocol: a sector of 200 degrees of azimuth of one scan of KITTI
/// 00 (the target), and of the next scan (the source) a sector shifted so far
/// that the given share of it is common; frame, heading and a rotation of the
/// source from SO(3) drawn from the seed.
///
/// A crop is ambiguous, and passed over, where what both sides see does not
/// tell the pose, whatever the method: of the source's points, on voxels of 0.5
/// m, fewer than 300 lie within 0.5 m of the target's at the true pose, or
/// these tell one direction by planes with a mean squared cosine below 0.003 (3
/// degrees: the noise of normals), as along a street.
class CropSource {
 public:
  static constexpr double sector_deg = 200;
  static constexpr Index least_common = 300;
  static constexpr double least_information = 0.003;

  explicit CropSource(std::filesystem::path folder) : folder_(std::move(folder)) {
    poses_ = read_tum(folder_ / "poses_semantickitti.tum").poses;
    for (const auto& entry : std::filesystem::directory_iterator(folder_ / "velodyne_sync"))
      files_.push_back(entry.path());
    std::sort(files_.begin(), files_.end());
    if (files_.size() != poses_.size() || files_.size() < 2)
      throw std::runtime_error("crops: scans and poses differ in number");
  }

  /// The folder of the data, if CHAINSLAM_UNPACKED_DATA has it.
  [[nodiscard]] static std::optional<std::filesystem::path> find_data() {
    const char* root = std::getenv("CHAINSLAM_UNPACKED_DATA");
    if (root == nullptr) return std::nullopt;
    const std::filesystem::path outer = std::filesystem::path(root) / "kitti00_first101";
    for (const std::filesystem::path& folder : {outer / "kitti00_first101", outer})
      if (std::filesystem::exists(folder / "velodyne_sync")) return folder;
    return std::nullopt;
  }

  /// The pair of a seed, or nothing where it is ambiguous.
  /// @param overlap  of the sectors, in [0, 1].
  [[nodiscard]] std::optional<CropPair> crop(double overlap, std::uint64_t seed) {
    Rng rng(seed);
    const auto frame = static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(files_.size()) - 1));
    const double heading = rng.uniform(-std::numbers::pi, std::numbers::pi);
    const double shift = (1 - overlap) * sector_deg * std::numbers::pi / 180;
    const SE3d T_true = poses_[frame].inverse() * poses_[frame + 1];
    CropPair pair;
    pair.seed = seed;
    pair.target = sector(scan(frame), heading);
    pair.source = sector(scan(frame + 1), heading + shift);
    if (is_ambiguous(pair, T_true)) return std::nullopt;
    const Eigen::Vector4d q = Eigen::Vector4d(rng.normal(), rng.normal(), rng.normal(), rng.normal()).normalized();
    const SE3d T_turned_source(SO3d::from_quaternion(SO3d::Quaternion(q)), Eigen::Vector3d::Zero());
    for (Eigen::Vector3f& p : pair.source.positions) p = (T_turned_source * p.cast<double>().eval()).cast<float>();
    pair.T_target_source = T_true * T_turned_source.inverse();
    return pair;
  }

 private:
  [[nodiscard]] static PointCloud<float> sector(const PointCloud<float>& scan, double heading) {
    const double half = sector_deg / 2 * std::numbers::pi / 180;
    PointCloud<float> part;
    for (const Eigen::Vector3f& p : scan.positions) {
      const double azimuth = std::atan2(static_cast<double>(p.y()), static_cast<double>(p.x()));
      if (std::abs(std::remainder(azimuth - heading, 2 * std::numbers::pi)) <= half) part.positions.push_back(p);
    }
    return part;
  }

  [[nodiscard]] static bool is_ambiguous(const CropPair& pair, const SE3d& T_true) {
    PointCloud<float> target = voxel_downsample(pair.target, 0.5);
    estimate_normals(target, {.neighbors = 10});
    const AlignResult there = PointToPlaneIcp{.max_iterations = 0, .max_distance = 0.5}.align(
        voxel_downsample(pair.source, 0.5), IndexedCloud<>(std::move(target)), T_true);
    return there.inliers < least_common || there.eigenvalues[0] < least_information;
  }

  /// NCLT's record: 8 bytes a point, 5 mm steps from -100 m.
  [[nodiscard]] const PointCloud<float>& scan(std::size_t frame) {
    PointCloud<float>& cloud = scans_[frame];
    if (!cloud.empty()) return cloud;
    std::ifstream file(files_[frame], std::ios::binary);
    std::vector<unsigned char> bytes(std::filesystem::file_size(files_[frame]));
    file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    const auto metres = [&](std::size_t at) {
      return static_cast<float>(0.005 * (bytes[at] + 256 * bytes[at + 1]) - 100.0);
    };
    for (std::size_t at = 0; at + 8 <= bytes.size(); at += 8)
      cloud.positions.emplace_back(metres(at), metres(at + 2), metres(at + 4));
    return cloud;
  }

  std::filesystem::path folder_;
  std::vector<SE3d> poses_;
  std::vector<std::filesystem::path> files_;
  std::map<std::size_t, PointCloud<float>> scans_;
};

}  // namespace chainslam::bench
