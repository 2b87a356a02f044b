#pragma once

// What ikd-Tree needs of PCL, so that timing it needs no PCL: three types of points, as large and as aligned as PCL's.

#include <Eigen/Core>

namespace pcl {

struct alignas(16) PointXYZ {
  float x = 0, y = 0, z = 0;
};

struct alignas(16) PointXYZI {
  float x = 0, y = 0, z = 0, padding = 0, intensity = 0;
};

struct alignas(16) PointXYZINormal {
  float x = 0, y = 0, z = 0, padding = 0;
  float normal_x = 0, normal_y = 0, normal_z = 0, normal_padding = 0;
  float intensity = 0, curvature = 0;
};

}  // namespace pcl
