// Aligns a cloud to another, both made here: what the README shows, whole.
#include <cmath>
#include <cstdio>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/registration/align.hpp"

int main() {
  using namespace chainslam;

  // Target: a floor and two walls. Source: the same, seen from somewhere else.
  std::vector<Eigen::Vector3f> target;
  for (float a = 0; a < 10; a += 0.1f)
    for (float b = 0; b < 10; b += 0.1f) target.insert(target.end(), {{a, b, 0}, {a, 0, b}, {0, a, b}});
  Vector6d motion;
  motion << 0.4, -0.3, 0.2, 0.03, -0.02, 0.05;  // translation in metres, rotation in radians
  const SE3d T_target_source = SE3d::exp(motion);
  const PointCloud<float> source = transformed(target, T_target_source.inverse());

  const AlignResult result = align(source, target, SE3d());

  const Eigen::Vector3d error = (T_target_source.inverse() * result.T_target_source).translation();
  std::printf("%d of %zu points matched, error %.2g m\n", result.inliers, source.size(), error.norm());
  return result.status == AlignStatus::converged && error.norm() < 1e-3 ? 0 : 1;
}
