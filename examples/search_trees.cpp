// Nearest neighbours: a static k-d tree over points of one's own type, and an ikd-tree that grows and forgets.
// Usage: example_search_trees [CLOUD], a .pcd, .ply or .bin file; without one, a scan of a hall.
#include <chainslam/io/cloud_file.hpp>
#include <chainslam/search/ikd_tree.hpp>
#include <chainslam/search/kd_tree.hpp>
#include <cstdio>

#include "generated/hall.hpp"

using namespace chainslam;

/// Points of one's own type are searched without a copy of the cloud, once `CloudTraits` says how to read them.
struct Return {
  double x, y, z;
  int ring;
};
using Returns = std::vector<Return>;
template <>
struct chainslam::CloudTraits<Returns> {
  static std::size_t size(const Returns& returns) { return returns.size(); }
  static Eigen::Vector3d position(const Returns& returns, std::size_t i) {
    return {returns[i].x, returns[i].y, returns[i].z};
  }
};

int main(int count, char** arguments) try {
  Rng rng(1);
  const PointCloud<float> cloud =
      count == 2 ? read_cloud(arguments[1]) : generated::scan(generated::upright(0, 3, 0), rng);
  Returns returns;
  for (const Eigen::Vector3f& p : cloud.positions)
    returns.push_back({p.x(), p.y(), p.z(), static_cast<int>(returns.size()) % 32});

  const KdTree<float> tree(returns);
  const Eigen::Vector3f query = cloud.positions.at(cloud.size() / 2);
  std::printf("k-d tree   %zu points, %d not finite\n", tree.size(), tree.rejected());
  for (const Neighbor<float>& near : tree.knn(query, 5))
    std::printf("           point %d of ring %d, %.3f m away\n", near.index,
                returns[static_cast<std::size_t>(near.index)].ring, std::sqrt(near.squared_distance));
  std::printf("           %zu points within 0.5 m, %zu of the 5 nearest within 1 cm\n", tree.radius(query, 0.5f).size(),
              tree.knn(query, 5, 0.01f).size());

  // A local map: one point a voxel of 0.2 m, the one nearest its centre; each carries the number of its scan.
  IkdTree<float, NearestToCenter, 3, int> map(NearestToCenter{.voxel_size = 0.2});
  const std::vector<int> first(cloud.size(), 1);
  const Index added = map.insert(cloud, first);
  std::printf("ikd-tree   %d of %zu points inserted\n", added, cloud.size());
  const bool taken = map.insert(query + Eigen::Vector3f(0, 0, 50), 2);
  const auto above = map.knn(query + Eigen::Vector3f(0, 0, 49), 1);
  std::printf("           a point above it %s, found as scan %d\n", taken ? "taken" : "refused",
              map.payload(above.at(0).index));
  const Index box = map.erase_inside({query + Eigen::Vector3f(-2, -2, 40), query + Eigen::Vector3f(2, 2, 60)});
  const Index far = map.erase_farther_than(query, 8.0f);
  std::printf("           erased %d in a box and %d farther than 8 m: %zu left\n", box, far, map.size());
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
