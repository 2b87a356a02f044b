// Prints what the library computes, to the last bit: once header-only, once by chainslam::compiled.
#include <chainslam/cloud/voxel_grid.hpp>
#include <chainslam/factor_graph/batch_optimizer.hpp>
#include <chainslam/factor_graph/incremental_smoother.hpp>
#include <chainslam/features/fpfh.hpp>
#include <chainslam/features/normals.hpp>
#include <chainslam/odometry/lidar_inertial_odometry.hpp>
#include <chainslam/odometry/lidar_odometry.hpp>
#include <chainslam/registration/align.hpp>
#include <chainslam/search/ikd_tree.hpp>
#include <chainslam/search/kd_tree.hpp>
#include <chainslam/slam/back_end.hpp>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <vector>

using namespace chainslam;

namespace {

void print(const char* what, const SE3d& T) {
  std::printf("%s", what);
  const Vector6d tangent = T.log();
  for (int i = 0; i < 6; ++i) std::printf(" %a", tangent[i]);
  std::printf("\n");
}

/// What a scanner sees of a hall with a wavy wall and pillars, from x metres off its centre.
PointCloud<float> scan(double x) {
  PointCloud<float> cloud;
  for (int i = 0; i < 1800; ++i) {
    const double angle = i * std::numbers::pi / 900, wall = 18 + 3 * std::sin(3 * angle) + 2 * std::cos(7 * angle);
    const double range = i % 180 < 10 + i / 90 ? 6 + i / 180 : wall;
    for (const double height : {-1.0, 0.0, 1.0, 2.0, 3.0})
      cloud.positions.push_back(
          Eigen::Vector3d(range * std::cos(angle) - x, range * std::sin(angle), height).cast<float>());
  }
  return cloud;
}

SE3d pose(double i) { return SE3d(SO3d::exp({0.01 * i, -0.02 * i, 0.1 * i}), {i, 0.3 * i, 0.1}); }

template <class Graph>
void fill(Graph& graph) {
  for (int i = 0; i < 30; ++i) graph.add_value(pose(1.02 * i));
  const auto noise = NoiseModel<6>::from_sigma(0.1);
  graph.add(PriorFactor<SE3d>{0, pose(0), noise.sqrt_information()});
  for (int i = 0; i < 29; ++i)
    graph.add(BetweenFactor<SE3d>{i, i + 1, pose(i).inverse() * pose(i + 1), noise.sqrt_information()});
  graph.add(BetweenFactor<SE3d>{3, 27, pose(3).inverse() * pose(26.9), noise.sqrt_information()});
}

void graphs() {
  PoseGraph graph;
  fill(graph);
  std::printf("batch %d\n", static_cast<int>(optimize(graph).status));
  print("batch", graph.values()[29]);
  IncrementalSmoother<SE3d> smoother;
  fill(smoother);
  std::printf("smoother %d\n",
              static_cast<int>(smoother.update().status));  // before the next, which compilers may swap
  std::printf("smoother %d\n", smoother.converge().ok());
  print("smoother", smoother[29]);
}

void clouds() {
  PointCloud<float> cloud = voxel_downsample(scan(0.0), 0.5);
  estimate_normals(cloud, {.neighbors = 10});
  const FpfhFeatures features = estimate_fpfh(cloud, KdTree<float>(cloud), {.radius = 2.0});
  for (std::size_t i = 0; i < cloud.size(); i += 100) {
    for (const Eigen::Vector3f& v : {cloud.positions[i], cloud.normals[i]})
      std::printf("cloud %a %a %a\n", double{v[0]}, double{v[1]}, double{v[2]});
    for (Eigen::Index bin = 0; bin < 33; bin += 4)
      std::printf("fpfh %a\n", double{features(bin, static_cast<Eigen::Index>(i))});
  }
}

void registration() {
  std::vector<Eigen::Vector3f> target, source;  // a floor and two walls
  for (float a = 0; a < 10; a += 0.2f)
    for (float b = 0; b < 10; b += 0.2f) target.insert(target.end(), {{a, b, 0}, {a, 0, b}, {0, a, b}});
  for (const Eigen::Vector3f& p : target) source.push_back((pose(0.2).inverse() * p.cast<double>()).cast<float>());
  const AlignResult aligned = align(source, target, SE3d());
  std::printf("icp %d\n", static_cast<int>(aligned.status));
  print("icp", aligned.T_target_source);
  IkdTree<float> tree;
  tree.insert(scan(0.0).positions);
  const auto found = tree.knn<5>(Eigen::Vector3f(5, 4, 1));
  for (const auto& neighbor : found.found()) std::printf("knn %a\n", static_cast<double>(neighbor.squared_distance));
}

template <class Odometry>
void drive(const char* name) {
  Odometry odometry;
  for (int i = 0; i < 8; ++i) {
    const auto time = Timestamp::from_seconds(0.1 * i);
    for (int k = 0; k < 10; ++k)
      odometry.process(ImuSample{.time = time + seconds(0.01 * k), .gyro = {0, 0, 0.001 * k}, .accel = {0.1, 0, 9.81}});
    const auto frame = odometry.process(LidarScan{.time = time, .end = time, .cloud = scan(0.1 * i)});
    if (frame) print(name, frame->T_odom_body);
  }
}

void back_end() {
  BackEnd<> back_end;
  for (const char* name : {"morning", "noon"}) {
    back_end.begin_session(name);
    for (int i = 0; i < 16; ++i) {
      const double x = 1.5 * i - 11.5;
      back_end.add(
          Keyframe{.time = Timestamp::from_seconds(i),
                   .T_odom_body = SE3d({}, {1.5 * i, 0, 0}),
                   .cloud = std::make_shared<const PointCloud<float>>(scan(x)),
                   .gnss = GnssFix{.position_ecef = {6378137, x, 0}, .quality = GnssQuality::three_dimensional}});
    }
  }
  const auto map = back_end.finish();
  std::printf("closures %zu\n", map->closures.size());
  for (const Keyframe& keyframe : map->keyframes) print("keyframe", keyframe.T_map_body);
}

}  // namespace

int main() {
  clouds();
  registration();
  graphs();
  drive<LidarOdometry<>>("lidar");
  drive<LidarInertialOdometry<>>("lidar_inertial");
  back_end();
}
