#include <nanoflann.hpp>
#include <optional>
#include <utility>

#include "search/peers/peers.hpp"
#include "search/peers/thinned_points.hpp"

namespace chainslam::bench {
namespace {

/// nanoflann's static tree, leaf 10 (its default), built anew after each change of the map.
class Nanoflann : public Structure {
 public:
  void build(const Points& points) override {
    map_.clear();
    map_.points = points;
    tree_.emplace(3, adaptor_, nanoflann::KDTreeSingleIndexAdaptorParams(10));
  }

  void insert(const Points& scan) override {
    for (const Eigen::Vector3f& p : scan) {
      const ThinnedPoints::Change change = map_.offer(p, [&] { return map_.next_slot(); });
      if (change.removed != ThinnedPoints::none) map_.move_last_to(change.removed);
    }
    tree_.emplace(3, adaptor_, nanoflann::KDTreeSingleIndexAdaptorParams(10));
  }

  void erase(const Move& move) override {
    Points kept;
    for (const Eigen::Vector3f& p : map_.points)
      if (inside(move.keep, p)) kept.push_back(p);
    map_.clear();
    insert(kept);
  }

  void knn(const Points& queries, std::size_t k) override {
    found_.resize(queries.size(), k);
    if (!tree_) return;
    for (std::size_t i = 0; i < queries.size(); ++i)
      tree_->knnSearch(queries[i].data(), k, found_.indices_of(i), found_.distances_of(i));
  }
  [[nodiscard]] std::vector<float> squared_distances() const override { return found_.distances; }
  void drop_answers() override { found_.drop(); }

  [[nodiscard]] std::size_t within(const Points& queries, float radius) override {
    nanoflann::SearchParams unsorted;
    unsorted.sorted = false;
    std::size_t count = 0;
    for (const Eigen::Vector3f& query : queries)
      count += tree_->radiusSearch(query.data(), radius * radius, near_, unsorted);
    return count;
  }

  [[nodiscard]] Points points() override { return map_.points; }

 private:
  using Metric = nanoflann::L2_Simple_Adaptor<float, NanoflannPoints, float, std::uint32_t>;
  using Tree = nanoflann::KDTreeSingleIndexAdaptor<Metric, NanoflannPoints, 3, std::uint32_t>;

  ThinnedPoints map_;
  NanoflannPoints adaptor_{&map_.points};
  std::optional<Tree> tree_;
  DistanceRows found_;
  std::vector<std::pair<std::uint32_t, float>> near_;
};

}  // namespace

std::unique_ptr<Structure> make_nanoflann_peer() { return std::make_unique<Nanoflann>(); }

}  // namespace chainslam::bench
