// ICP of two clouds: metrics, a robust kernel of one's own, and what the result says.
// Usage: example_icp_of_two_files [SOURCE TARGET], each a .pcd, .ply or .bin file; without files, two scans of a hall.
#include <chainslam/cloud/voxel_grid.hpp>
#include <chainslam/io/cloud_file.hpp>
#include <chainslam/registration/align.hpp>
#include <cstdio>

#include "generated/hall.hpp"

using namespace chainslam;

/// A robust kernel: pairs whose residual exceeds `width` metres count for nothing, others the less the larger it is.
struct Fading {
  double width = 0.5;

  double weight(double squared_residual) const {
    const double rest = std::max(0.0, 1 - squared_residual / (width * width));
    return rest * rest;
  }
};
static_assert(RobustKernel<Fading>);

void print(const char* name, const AlignResult& result) {
  const Eigen::Vector3d t = result.T_target_source.translation(), w = result.T_target_source.rotation().log();
  std::printf("%-15s %s in %d steps: t = %.3f %.3f %.3f m, w = %.4f %.4f %.4f rad, overlap %.2f, sigma %.4f m\n", name,
              result.converged() ? "converged" : "not converged", result.iterations, t.x(), t.y(), t.z(), w.x(), w.y(),
              w.z(), result.overlap, std::sqrt(result.covariance.topLeftCorner<3, 3>().trace()));
}

int main(int count, char** arguments) try {
  Rng rng(1);
  const SE3d T_hall_source = generated::upright(0.5, 3.3, 0.1), T_hall_target = generated::upright(0, 3, 0);
  const bool given = count == 3;
  const PointCloud<float> source =
      voxel_downsample(given ? read_cloud(arguments[1]) : generated::scan(T_hall_source, rng), 0.25);
  const PointCloud<float> target =
      voxel_downsample(given ? read_cloud(arguments[2]) : generated::scan(T_hall_target, rng), 0.25);
  std::printf("points          %zu source, %zu target\n", source.size(), target.size());

  const SE3d guess;  // T_target_source: the identity
  print("point to point", PointToPointIcp{}.align(source, target, guess));
  print("point to plane", PointToPlaneIcp{.max_distance = 2.0}.align(source, target, guess));
  print("own kernel", Icp<PointToPlane, Fading>{.max_distance = 2.0}.align(source, target, guess));
  const AlignResult gicp = Gicp{.max_distance = 2.0}.align(source, target, guess);
  print("gicp", gicp);
  if (given) return gicp.converged() ? 0 : 1;

  const SE3d truth = T_hall_target.inverse() * T_hall_source;
  std::printf("error           %.4f m\n", (truth.translation() - gicp.T_target_source.translation()).norm());
  return gicp.converged() ? 0 : 1;
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
