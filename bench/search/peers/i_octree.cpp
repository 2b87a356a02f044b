#include <iostream>  // which its header needs and does not include

#include <Octree.h>

#include "search/peers/peers.hpp"

namespace chainslam::bench {
namespace {

/// i-Octree (Zhu et al. 2024), buckets of 32. It thins by the extent of its leaves, not by voxels: half a voxel each
/// way, as its authors set it.
class IOctree : public AnswersInVectors<std::vector<std::size_t>> {
 public:
  void build(const Points& points) override {
    std::vector<P> all = converted(points);
    tree_ = std::make_unique<thuni::Octree>(bucket, true, 0.01f);
    tree_->initialize(all);
  }

  void insert(const Points& scan) override {
    std::vector<P> points = converted(scan);
    if (tree_ == nullptr) tree_ = std::make_unique<thuni::Octree>(bucket, true, static_cast<float>(map_voxel / 2));
    tree_->update(points, true);
  }

  void erase(const Move& move) override {
    for (const Box& box : move.left) tree_->boxWiseDelete(box.low.data(), box.high.data(), true);
  }

  void knn(const Points& queries, std::size_t k) override {
    answer(queries, k, [&](const Eigen::Vector3f& query, Found& found) {
      tree_->knnNeighbors(converted(query), static_cast<int>(k), found.points, found.squared);
    });
  }

  [[nodiscard]] std::size_t within(const Points& queries, float radius) override {
    std::size_t count = 0;
    for (const Eigen::Vector3f& query : queries) {
      tree_->radiusNeighbors(converted(query), radius, near_, near_squared_);
      count += near_.size();
    }
    return count;
  }

  [[nodiscard]] Points points() override {
    Points points;
    for (const P& p : tree_->get_data<P, std::vector<P>>()) points.emplace_back(p.x, p.y, p.z);
    return points;
  }

 private:
  struct P {
    float x = 0, y = 0, z = 0;
  };
  static constexpr std::size_t bucket = 32;

  static P converted(const Eigen::Vector3f& p) { return {p.x(), p.y(), p.z()}; }
  static std::vector<P> converted(const Points& points) {
    std::vector<P> all;
    all.reserve(points.size());
    for (const Eigen::Vector3f& p : points) all.push_back(converted(p));
    return all;
  }

  std::unique_ptr<thuni::Octree> tree_;
  std::vector<std::size_t> near_;
  std::vector<float> near_squared_;
};

}  // namespace

std::unique_ptr<Structure> make_i_octree_peer() { return std::make_unique<IOctree>(); }

}  // namespace chainslam::bench
