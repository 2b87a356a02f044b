// Writes the golden values of test/features and test/registration, as PCL and Open3D compute them:
// build target bench_golden_values with -DCHAINSLAM_BENCH_PEERS=ON and give the folder test/ of the checkout.

#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <string>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/se3.hpp"
#include "registration/peers/open3d.hpp"
#include "registration/peers/pcl.hpp"

namespace chainslam::bench {
namespace {

constexpr const char* maker = "# Written by bench/registration/golden_values.cpp with PCL and Open3D. Metres.\n";

/// Whole millimetres, so that few digits say them exactly.
Eigen::Vector3f rounded(const Eigen::Vector3d& p) {
  return (1000 * p).array().round().matrix().cast<float>() / 1000.0f;
}

/// A floor, two walls and part of a ball, 4 m wide, with 5 mm of noise.
Positions corner(Rng& rng, int count) {
  Positions points;
  for (int i = 0; i < count; ++i) {
    const double u = rng.uniform(0, 4), v = rng.uniform(0, 4), noise = rng.normal(0, 0.005);
    Eigen::Vector3d p(u, v, noise);
    if (i % 4 == 1) p = {u, noise, v / 2};
    if (i % 4 == 2) p = {noise, u, v / 2};
    if (i % 4 == 3)
      p = Eigen::Vector3d(2.5, 2.5, 0.3) +
          (1 + noise) * Eigen::Vector3d(rng.normal(), rng.normal(), std::abs(rng.normal())).normalized();
    points.push_back(rounded(p));
  }
  return points;
}

class Text {
 public:
  explicit Text(const std::string& path) : path_(path), file_(path) { file_.precision(9); }
  ~Text() = default;
  Text(const Text&) = delete;
  Text& operator=(const Text&) = delete;

  template <class Value>
  Text& operator<<(const Value& value) {
    if (!(file_ << value)) throw std::runtime_error("cannot write " + path_);
    return *this;
  }
  void row(const Eigen::Vector3f& v) { *this << v[0] << ' ' << v[1] << ' ' << v[2]; }

 private:
  std::string path_;
  std::ofstream file_;
};

/// Normals and curvatures of ten neighbours seen from (2, 2, 3), and FPFH within 1.2 m of them.
void write_features(const std::string& path) {
  Rng rng(1);
  const Positions points = corner(rng, 160);
  PclCloud cloud(points);
  cloud.estimate_normals(10, 0, {2, 2, 3});
  cloud.estimate_fpfh(1.2);
  const Positions normals = cloud.normals();
  const std::vector<float> curvatures = cloud.curvatures();
  const PeerFeatures features = cloud.features();
  Text text(path);
  text << maker << "# PCL: point, normal of its 10 nearest towards (2, 2, 3), curvature, 33 bins of FPFH within 1.2 m\n"
       << points.size() << '\n';
  for (std::size_t i = 0; i < points.size(); ++i) {
    text.row(points[i]);
    text << ' ';
    text.row(normals[i]);
    text << ' ' << curvatures[i];
    for (const float bin : features[i]) text << ' ' << bin;
    text << '\n';
  }
}

void write_pose(Text& text, const std::string& name, const PeerPose& pose) {
  text << name;
  for (Eigen::Index row = 0; row < 3; ++row)
    for (Eigen::Index column = 0; column < 4; ++column) text << ' ' << pose.T_target_source.matrix()(row, column);
  text << '\n';
}

void write_cloud(Text& text, const std::string& name, const Positions& points) {
  text << name << ' ' << points.size() << '\n';
  for (const Eigen::Vector3f& p : points) {
    text.row(p);
    text << '\n';
  }
}

/// Two samples of one scene, the second moved: pairs within 0.5 m, from the identity, normals of ten neighbours.
void write_poses(const std::string& path) {
  Rng rng(2);
  const Positions target = corner(rng, 600);
  Vector6d twist;
  twist << 0.08, -0.05, 0.03, 0.02, -0.01, 0.04;
  const SE3d T_source_target = SE3d::exp(twist);
  Positions source;
  for (const Eigen::Vector3f& p : corner(rng, 500)) source.push_back(rounded(T_source_target * p.cast<double>()));
  PclCloud pcl_source(source), pcl_target(target);
  pcl_source.estimate_normals(10, 0, {2, 2, 3});
  pcl_target.estimate_normals(10, 0, {2, 2, 3});
  Open3dCloud open3d_source(source), open3d_target(target);
  open3d_target.estimate_normals(10, 100, {2, 2, 3});
  const PeerTransform start = PeerTransform::Identity();
  Text text(path);
  text << maker << "# T_target_source, twelve numbers row by row: the truth, and by registration of the points below\n";
  PeerPose truth;
  truth.T_target_source.matrix() = T_source_target.inverse().matrix();
  write_pose(text, "truth", truth);
  write_pose(text, "pcl_gicp", pcl_gicp(pcl_source, pcl_target, start, {.max_distance = 0.5}));
  write_pose(text, "pcl_plane", pcl_icp_with_normals(pcl_source, pcl_target, start, {.max_distance = 0.5}));
  write_pose(text, "open3d_gicp", open3d_gicp(open3d_source, open3d_target, start, 0.5));
  write_pose(text, "open3d_plane", open3d_plane_icp(open3d_source, open3d_target, start, 0.5));
  write_cloud(text, "source", source);
  write_cloud(text, "target", target);
}

}  // namespace
}  // namespace chainslam::bench

int main(int argc, char** argv) try {
  if (argc != 2) throw std::runtime_error("usage: bench_golden_values FOLDER (test/ of the checkout)");
  const std::string folder = argv[1];
  chainslam::bench::write_features(folder + "/features/golden/corner_features.txt");
  chainslam::bench::write_poses(folder + "/registration/golden/corner_poses.txt");
} catch (const std::exception& error) {
  std::fprintf(stderr, "bench_golden_values: %s\n", error.what());
  return 1;
}
