#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

namespace chainslam::bench {

using Points = std::vector<Eigen::Vector3f>;

/// Axis-aligned, metres.
struct Box {
  Eigen::Vector3f low;
  Eigen::Vector3f high;
};

/// The map follows the sensor: what it keeps, and what it leaves, as the slabs between the old square and the new one.
struct Move {
  Box keep;
  std::vector<Box> left;
};

/// Edge of the voxels to which maps are thinned, metres: a power of two, so that peers that compute cells in float are
/// right, too.
constexpr double map_voxel = 0.5;

/// One of ours or a peer behind one interface, so that a bench is written once. A call does a whole scan: its own cost,
/// and that nothing is inlined across it, does not show.
class Structure {
 public:
  Structure() = default;
  Structure(const Structure&) = delete;
  Structure& operator=(const Structure&) = delete;
  virtual ~Structure() = default;

  /// Holds these points, all of them, and no others.
  virtual void build(const Points& points) = 0;
  /// Takes one more scan, of which one point a voxel is kept.
  virtual void insert(const Points& /*scan*/) { throw std::logic_error("this structure does not grow"); }
  virtual void erase(const Move& /*move*/) { throw std::logic_error("this structure does not forget"); }

  /// The k nearest of each query. Keeps them in the form in which the structure gives them.
  virtual void knn(const Points& queries, std::size_t k) = 0;
  /// The same for queries that are the last ones moved a little. Peers have nothing of the kind and ask again.
  virtual void knn_again(const Points& queries, std::size_t k) { knn(queries, k); }
  /// The squared distances found last, k a query, ascending; infinity where there were fewer.
  [[nodiscard]] virtual std::vector<float> squared_distances() const = 0;
  /// Gives back what holds the answers, which is no part of the map.
  virtual void drop_answers() = 0;
  /// Points within the radius, over all queries; each query's are listed, not only counted.
  [[nodiscard]] virtual std::size_t within(const Points& /*queries*/, float /*radius*/) {
    throw std::logic_error("this structure has no radius search");
  }

  /// What the map holds.
  [[nodiscard]] virtual Points points() = 0;
  /// Beyond this distance it need not find what is there, metres.
  [[nodiscard]] virtual float reach() const { return std::numeric_limits<float>::infinity(); }
};

/// What of a peer can be compared.
enum class Thinning {
  nearest_to_center,  ///< keeps the point of a voxel that is nearest its centre: the same map as ours
  own                 ///< another rule, so another map: each is right for what it holds
};

/// A structure by its name, and how to make an empty one.
struct Maker {
  std::string name;
  std::unique_ptr<Structure> (*make)();
  Thinning thinning = Thinning::nearest_to_center;
  bool exact = true;         ///< finds all there is within its reach
  bool finds_within = true;  ///< has a radius search
};

/// A peer that answers each query by two vectors: something for each point, and the squared distances.
template <class Answer>
class AnswersInVectors : public Structure {
 public:
  [[nodiscard]] std::vector<float> squared_distances() const override {
    std::vector<float> all;
    for (const Found& found : found_) {
      all.insert(all.end(), found.squared.begin(), found.squared.end());
      all.resize(all.size() + k_ - found.squared.size(), std::numeric_limits<float>::infinity());
    }
    return all;
  }
  void drop_answers() override { found_ = {}; }

 protected:
  struct Found {
    Answer points;
    std::vector<float> squared;
  };

  /// Calls `ask(query, found)` for each.
  template <class Ask>
  void answer(const Points& queries, std::size_t k, Ask&& ask) {
    k_ = k;
    found_.resize(queries.size());
    for (std::size_t i = 0; i < queries.size(); ++i) ask(queries[i], found_[i]);
  }

 private:
  std::vector<Found> found_;
  std::size_t k_ = 0;
};

/// Answers of nanoflann's form, in columns.
class DistanceRows {
 public:
  void resize(std::size_t queries, std::size_t k) {
    k_ = k;
    indices.resize(queries * k);
    distances.assign(queries * k, std::numeric_limits<float>::infinity());
  }
  void drop() { *this = {}; }
  [[nodiscard]] std::uint32_t* indices_of(std::size_t query) { return indices.data() + query * k_; }
  [[nodiscard]] float* distances_of(std::size_t query) { return distances.data() + query * k_; }

  std::vector<std::uint32_t> indices;
  std::vector<float> distances;

 private:
  std::size_t k_ = 0;
};

}  // namespace chainslam::bench
