#include <Eigen/Core>
#include <cstdio>

// It prints when its thread starts and ends.
#define printf(...) static_cast<void>(0)
#include <ikd_Tree.cpp>  // templates: compiled for the smallest point it has, 12 bytes
#undef printf

#include "search/peers/peers.hpp"

namespace chainslam::bench {
namespace {

/// ikd-Tree (Cai, Xu and Zhang 2021) as FAST-LIO2 uses it, with its thread that rebuilds.
class IkdTreePeer : public AnswersInVectors<KD_TREE<ikdTree_PointType>::PointVector> {
 public:
  void build(const Points& points) override { tree_->Build(converted(points)); }

  void insert(const Points& scan) override {
    if (tree_->Root_Node == nullptr) return build(scan);
    Tree::PointVector points = converted(scan);
    tree_->Add_Points(points, true);
  }

  void erase(const Move& move) override {
    std::vector<BoxPointType> boxes;
    for (const Box& box : move.left) {
      BoxPointType& added = boxes.emplace_back();
      std::copy_n(box.low.data(), 3, added.vertex_min);
      std::copy_n(box.high.data(), 3, added.vertex_max);
    }
    tree_->Delete_Point_Boxes(boxes);
  }

  void knn(const Points& queries, std::size_t k) override {
    answer(queries, k, [&](const Eigen::Vector3f& query, Found& found) {
      tree_->Nearest_Search(converted(query), static_cast<int>(k), found.points, found.squared);
    });
  }

  [[nodiscard]] std::size_t within(const Points& queries, float radius) override {
    std::size_t count = 0;
    for (const Eigen::Vector3f& query : queries) {
      tree_->Radius_Search(converted(query), radius, near_);
      count += near_.size();
    }
    return count;
  }

  [[nodiscard]] Points points() override {
    Tree::PointVector all;
    tree_->flatten(tree_->Root_Node, all, NOT_RECORD);
    Points points;
    for (const auto& p : all) points.emplace_back(p.x, p.y, p.z);
    return points;
  }

 private:
  using Tree = KD_TREE<ikdTree_PointType>;

  static ikdTree_PointType converted(const Eigen::Vector3f& p) { return {p.x(), p.y(), p.z()}; }
  static Tree::PointVector converted(const Points& points) {
    Tree::PointVector all;
    all.reserve(points.size());
    for (const Eigen::Vector3f& p : points) all.push_back(converted(p));
    return all;
  }

  // 44 MB: too large for a stack. Parameters as in FAST-LIO2.
  std::unique_ptr<Tree> tree_ = std::make_unique<Tree>(0.5f, 0.6f, static_cast<float>(map_voxel));
  Tree::PointVector near_;
};

}  // namespace

std::unique_ptr<Structure> make_ikd_tree_peer() { return std::make_unique<IkdTreePeer>(); }

}  // namespace chainslam::bench
