#pragma once

#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::mapper {

/// COLMAP's PINHOLE camera: x right, y down, z forward; pixels, the upper left one's centre at (0.5, 0.5).
struct PinholeCamera {
  int width = 1280, height = 720;
  double fx = 640, fy = 640;  ///< pixels: 90 degrees wide
  double cx = 640, cy = 360;
};

/// A camera at the body's origin that looks along its x axis, the body's z axis up in the image.
[[nodiscard]] SE3d forward_camera();

/// What a map has of a reconstruction in COLMAP's text layout (https://colmap.github.io/format.html): a camera that is
/// given, a view of it at every keyframe, and points without tracks.
struct ColmapExport {
  PinholeCamera camera{};
  SE3d T_body_camera = forward_camera();
};

/// One camera, CAMERA_ID 1. @throws IoError
void write_colmap_cameras(const FileTarget& target, const PinholeCamera& camera);

/// A view at each keyframe of some sessions: IMAGE_ID is the keyframe's id and one, the pose T_camera_map, the name
/// `SESSION/NANOSECONDS.png`, the keyframe's session and time. No view has features. @throws IoError
void write_colmap_images(const FileTarget& target, const SlamMap& map, const std::vector<SessionId>& sessions,
                         const SE3d& T_body_camera);

/// Points, metres, in grey (a map has no colours), with no error (-1, COLMAP's own for none) and no track. @throws
/// IoError
void write_colmap_points(const FileTarget& target, const PointCloud<float>& cloud);

}  // namespace chainslam::mapper
