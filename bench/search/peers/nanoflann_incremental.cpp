// The same program holds Debian's nanoflann: another name keeps the two apart.
#define nanoflann nanoflann_incremental
#include <nanoflann.hpp>

#include <algorithm>
#include <optional>

#include "search/peers/peers.hpp"
#include "search/peers/thinned_points.hpp"

namespace chainslam::bench {
namespace {

/// nanoflann's incremental tree (1.12), which rebuilds on the calling thread. It holds indices of the caller's points,
/// and has no thinning.
class NanoflannIncremental : public Structure {
 public:
  void build(const Points& points) override {
    map_.clear();
    map_.points = points;
    start();
    tree_->addPoints(0, static_cast<std::uint32_t>(points.size() - 1));
  }

  void insert(const Points& scan) override {
    const bool first = !tree_;
    if (first) start();
    added_.clear();
    // Each removal would look through the whole tree for something to rebuild: it does so once, after the last.
    tree_->setInlineRebuild(false);
    for (const Eigen::Vector3f& p : scan) {
      const ThinnedPoints::Change change = map_.offer(p, [&] { return free_slot(); });
      if (change.removed != ThinnedPoints::none) drop(change.removed);
      if (change.added != ThinnedPoints::none) added_.push_back(change.added);
    }
    tree_->setInlineRebuild(true);
    if (first) {
      tree_->buildFromIndices(added_);
    } else {
      for (const std::uint32_t slot : added_) tree_->addPoint(slot);
    }
    recycle();
  }

  void erase(const Move& move) override {
    Tree::BoundingBox keep;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto i = static_cast<Eigen::Index>(axis);
      keep[axis] = {move.keep.low[i], move.keep.high[i]};
    }
    std::vector<std::uint32_t> live;
    tree_->snapshotLiveIndices(live);
    for (const std::uint32_t slot : live)
      if (!inside(move.keep, map_.points[slot])) map_.forget(slot);
    tree_->removeOutsideBox(keep);
    recycle();
  }

  void knn(const Points& queries, std::size_t k) override {
    found_.resize(queries.size(), k);
    if (!tree_) return;
    for (std::size_t i = 0; i < queries.size(); ++i)
      static_cast<void>(tree_->knnSearch(queries[i].data(), k, found_.indices_of(i), found_.distances_of(i)));
  }
  [[nodiscard]] std::vector<float> squared_distances() const override { return found_.distances; }
  void drop_answers() override { found_.drop(); }

  [[nodiscard]] std::size_t within(const Points& queries, float radius) override {
    nanoflann::SearchParameters unsorted;
    unsorted.sorted = false;
    std::size_t count = 0;
    for (const Eigen::Vector3f& query : queries)
      count += tree_->radiusSearch(query.data(), radius * radius, near_, unsorted);
    return count;
  }

  [[nodiscard]] Points points() override {
    std::vector<std::uint32_t> live;
    tree_->snapshotLiveIndices(live);
    Points points;
    for (const std::uint32_t slot : live) points.push_back(map_.points[slot]);
    return points;
  }

 private:
  using Metric = nanoflann::L2_Simple_Adaptor<float, NanoflannPoints, float, std::uint32_t>;
  using Tree = nanoflann::KDTreeSingleIndexIncrementalAdaptor<Metric, NanoflannPoints, 3, std::uint32_t>;

  void start() {
    tree_.emplace(3, adaptor_);
    tree_->setCollectRemovedPoints(true);
  }

  /// Takes a point out of the tree, or, if it has only come with this scan, does not put it in.
  void drop(std::uint32_t slot) {
    if (tree_->referencesIndex(slot)) {
      tree_->removePoint(slot);
    } else {
      std::erase(added_, slot);
      free_.push_back(slot);
    }
  }

  std::uint32_t free_slot() {
    if (free_.empty()) return map_.next_slot();
    const std::uint32_t slot = free_.back();
    free_.pop_back();
    return slot;
  }

  /// Slots may be used again once the tree has let go of them.
  void recycle() {
    const std::vector<std::uint32_t> gone = tree_->acquireRemovedPoints();
    free_.insert(free_.end(), gone.begin(), gone.end());
  }

  ThinnedPoints map_;
  NanoflannPoints adaptor_{&map_.points};
  std::optional<Tree> tree_;
  std::vector<std::uint32_t> added_, free_;
  DistanceRows found_;
  std::vector<nanoflann::ResultItem<std::uint32_t, float>> near_;
};

}  // namespace

std::unique_ptr<Structure> make_nanoflann_incremental_peer() { return std::make_unique<NanoflannIncremental>(); }

}  // namespace chainslam::bench
