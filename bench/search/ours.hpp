#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/search/batch.hpp"
#include "chainslam/search/concepts.hpp"
#include "search/structure.hpp"

namespace chainslam::bench {

/// One of our structures: `make_search(points)` builds it, of none for an empty one.
template <class Search, Search (*make_search)(const Points&)>
class Ours : public Structure {
 public:
  void build(const Points& points) override { search_.emplace(make_search(points)); }

  void insert(const Points& scan) override {
    if constexpr (IncrementalSearch<Search>) {
      search().insert(scan);
    } else {
      Structure::insert(scan);
    }
  }
  void erase(const Move& move) override {
    if constexpr (IncrementalSearch<Search>) {
      search().erase_outside(Eigen::AlignedBox3f(move.keep.low, move.keep.high));
    } else {
      Structure::erase(move);
    }
  }

  void knn(const Points& queries, std::size_t k) override {
    resize(queries.size(), k);
    if (knn_of_fixed_size<1, 2, 5, 20>(queries, k)) return;
    for (std::size_t i = 0; i < queries.size(); ++i) counts_[i] = search().knn(queries[i], row(i), infinity);
  }

  void knn_again(const Points& queries, std::size_t k) override {
    if constexpr (SeededSearch<Search>) {
      for (std::size_t i = 0; i < queries.size(); ++i)
        counts_[i] = search().knn(queries[i], row(i), infinity, row(i).first(static_cast<std::size_t>(counts_[i])));
    } else {
      knn(queries, k);
    }
  }

  [[nodiscard]] std::vector<float> squared_distances() const override {
    std::vector<float> all(found_.size(), infinity);
    for (std::size_t i = 0; i < counts_.size(); ++i)
      for (std::size_t j = 0; j < static_cast<std::size_t>(counts_[i]); ++j)
        all[i * k_ + j] = found_[i * k_ + j].squared_distance;
    return all;
  }

  void drop_answers() override {
    found_ = {};
    counts_ = {};
  }

  [[nodiscard]] std::size_t within(const Points& queries, float radius) override {
    std::size_t count = 0;
    for (const Eigen::Vector3f& query : queries) {
      search().within(query, radius, near_);
      count += near_.size();
    }
    return count;
  }

  [[nodiscard]] Points points() override {
    Points points;
    if constexpr (IncrementalSearch<Search>)
      search().for_each_point([&](Index, const Eigen::Vector3f& p) { points.push_back(p); });
    return points;
  }
  [[nodiscard]] float reach() const override {
    if constexpr (requires { search_->max_search_radius(); }) {
      return search_->max_search_radius();
    } else {
      return infinity;
    }
  }

 protected:
  static constexpr float infinity = std::numeric_limits<float>::infinity();

  [[nodiscard]] Search& search() {
    if (!search_) build({});
    return *search_;
  }
  void resize(std::size_t queries, std::size_t k) {
    k_ = k;
    found_.resize(queries * k);
    counts_.resize(queries);
  }
  [[nodiscard]] std::span<Neighbor<float>> row(std::size_t query) { return std::span(found_).subspan(query * k_, k_); }

  std::vector<Neighbor<float>> found_;
  std::vector<Index> counts_;
  std::size_t k_ = 0;

 private:
  /// Asks by the number that the compiler knows, if k is one of these. Returns whether it is.
  template <int... Sizes>
  bool knn_of_fixed_size(const Points& queries, std::size_t k) {
    if constexpr (FixedSizeSearch<Search>)
      return ((k == Sizes && (knn_of_size<Sizes>(queries), true)) || ...);
    else
      return false;
  }
  template <int K>
  void knn_of_size(const Points& queries) {
    for (std::size_t i = 0; i < queries.size(); ++i) {
      const KNearest<float, K> nearest = search().template knn<K>(queries[i], infinity);
      std::copy(nearest.neighbors.begin(), nearest.neighbors.end(), row(i).begin());
      counts_[i] = nearest.count;
    }
  }

  std::optional<Search> search_;
  std::vector<Neighbor<float>> near_;
};

/// The same, asked a scan at a time.
template <class Search, Search (*make_search)(const Points&)>
class OursBatched : public Ours<Search, make_search> {
 public:
  void knn(const Points& queries, std::size_t k) override {
    knn_batch(this->search(), queries, static_cast<Index>(k), this->infinity, rows_);
  }
  void knn_again(const Points& queries, std::size_t /*k*/) override {
    knn_batch_again(this->search(), queries, this->infinity, rows_);
  }
  [[nodiscard]] std::vector<float> squared_distances() const override {
    std::vector<float> all;
    for (Index i = 0; i < rows_.rows(); ++i) {
      for (const Neighbor<float>& neighbor : rows_[i]) all.push_back(neighbor.squared_distance);
      all.resize(static_cast<std::size_t>((i + 1) * rows_.k()), this->infinity);
    }
    return all;
  }
  void drop_answers() override { rows_ = {}; }

 private:
  NeighborRows<float> rows_;
};

template <class Search, Search (*make_search)(const Points&)>
std::unique_ptr<Structure> make_ours_batched() {
  return std::make_unique<OursBatched<Search, make_search>>();
}

template <class Search, Search (*make_search)(const Points&)>
std::unique_ptr<Structure> make_ours() {
  return std::make_unique<Ours<Search, make_search>>();
}

}  // namespace chainslam::bench
