#include <iostream>  // which its headers need and do not include
#include <memory>

#include <small_gicp/ann/flat_container.hpp>
#include <small_gicp/ann/incremental_voxelmap.hpp>
#include <small_gicp/ann/kdtree.hpp>

#include "search/peers/peers.hpp"

namespace chainslam::bench {
namespace {

/// Our points as they are, to spare it a copy.
struct Cloud {
  const Points* points;
};

}  // namespace
}  // namespace chainslam::bench

template <>
struct small_gicp::traits::Traits<chainslam::bench::Cloud> {
  static std::size_t size(const chainslam::bench::Cloud& cloud) { return cloud.points->size(); }
  static Eigen::Vector4d point(const chainslam::bench::Cloud& cloud, std::size_t i) {
    const Eigen::Vector3f& p = (*cloud.points)[i];
    return {p.x(), p.y(), p.z(), 1.0};
  }
};

namespace chainslam::bench {
namespace {

Eigen::Vector4d converted(const Eigen::Vector3f& p) { return {p.x(), p.y(), p.z(), 1.0}; }

/// What it found: indices and squared distances, k a query.
class Rows {
 public:
  void resize(std::size_t queries, std::size_t k) {
    k_ = k;
    indices_.resize(queries * k);
    squared_.assign(queries * k, std::numeric_limits<double>::infinity());
  }
  [[nodiscard]] std::size_t* indices(std::size_t query) { return indices_.data() + query * k_; }
  [[nodiscard]] double* squared(std::size_t query) { return squared_.data() + query * k_; }
  [[nodiscard]] std::vector<float> squared_distances() const {
    std::vector<float> all;
    for (const double squared : squared_)
      all.push_back(squared < 1e30 ? static_cast<float>(squared) : std::numeric_limits<float>::infinity());
    return all;
  }

 private:
  std::size_t k_ = 0;
  std::vector<std::size_t> indices_;
  std::vector<double> squared_;
};

/// small_gicp's voxel map (Koide 2024), one point a voxel and the 27 voxels around the query: approximate. It forgets
/// by itself what no scan has touched for a hundred scans.
class VoxelMapPeer : public Structure {
 public:
  VoxelMapPeer() {
    map_.voxel_setting.max_num_points_in_cell = 1;
    map_.search_offsets.clear();  // its setter adds the 27 to what is there
    map_.set_search_offsets(27);
  }

  void build(const Points& points) override { insert(points); }
  void insert(const Points& scan) override { map_.insert(Cloud{&scan}); }
  void erase(const Move& /*move*/) override {}

  void knn(const Points& queries, std::size_t k) override {
    found_.resize(queries.size(), k);
    for (std::size_t i = 0; i < queries.size(); ++i)
      map_.knn_search(converted(queries[i]), k, found_.indices(i), found_.squared(i));
  }
  [[nodiscard]] std::vector<float> squared_distances() const override { return found_.squared_distances(); }
  void drop_answers() override { found_ = {}; }

  [[nodiscard]] Points points() override {
    Points points;
    for (const Eigen::Vector4d& p : small_gicp::traits::voxel_points(map_))
      points.emplace_back(p.head<3>().cast<float>());
    return points;
  }

 private:
  small_gicp::IncrementalVoxelMap<small_gicp::FlatContainerPoints> map_{map_voxel};
  Rows found_;
};

/// small_gicp's static k-d tree.
class KdTreePeer : public Structure {
 public:
  void build(const Points& points) override {
    points_ = points;
    tree_ = std::make_unique<Tree>(cloud_);
  }

  void knn(const Points& queries, std::size_t k) override {
    found_.resize(queries.size(), k);
    for (std::size_t i = 0; i < queries.size(); ++i) {
      const Eigen::Vector4d query = converted(queries[i]);
      if (k == 1) {
        tree_->knn_search<1>(query, found_.indices(i), found_.squared(i));
      } else if (k == 5) {
        tree_->knn_search<5>(query, found_.indices(i), found_.squared(i));
      } else {
        tree_->knn_search(query, static_cast<int>(k), found_.indices(i), found_.squared(i));
      }
    }
  }
  [[nodiscard]] std::vector<float> squared_distances() const override { return found_.squared_distances(); }
  void drop_answers() override { found_ = {}; }
  [[nodiscard]] Points points() override { return points_; }

 private:
  using Tree = small_gicp::UnsafeKdTree<Cloud>;
  Points points_;
  Cloud cloud_{&points_};
  std::unique_ptr<Tree> tree_;
  Rows found_;
};

}  // namespace

std::unique_ptr<Structure> make_small_gicp_voxel_map() { return std::make_unique<VoxelMapPeer>(); }
std::unique_ptr<Structure> make_small_gicp_kd_tree() { return std::make_unique<KdTreePeer>(); }

}  // namespace chainslam::bench
