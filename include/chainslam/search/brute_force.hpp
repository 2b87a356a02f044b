#pragma once

#include <Eigen/Core>
#include <limits>
#include <span>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/nearest_list.hpp"

namespace chainslam {

/// Looks at every point: the reference that the other searches are tested against, and the fastest for a few dozen
/// points. Keeps a copy of the positions; indices are the cloud's.
template <class ScalarType = float>
class BruteForce {
 public:
  using Scalar = ScalarType;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;

  BruteForce() = default;

  /// @param cloud  points in any frame, metres; NaN and infinite ones are never found.
  template <Cloud Points>
  explicit BruteForce(const Points& cloud) {
    const Index count = to_index(cloud_size(cloud), "cloud");
    positions_.reserve(static_cast<std::size_t>(count));
    for (Index i = 0; i < count; ++i) {
      positions_.push_back(chainslam::position(cloud, static_cast<std::size_t>(i)).template cast<Scalar>());
      if (!is_finite(positions_.back())) ++rejected_;
    }
  }

  /// Points that can be found.
  [[nodiscard]] std::size_t size() const { return positions_.size() - static_cast<std::size_t>(rejected_); }
  /// Points left out because a coordinate is NaN or infinite.
  [[nodiscard]] Index rejected() const { return rejected_; }
  [[nodiscard]] const Vector3& position(Index i) const { return positions_[static_cast<std::size_t>(i)]; }

  Index knn(const Vector3& query, std::span<Neighbor<Scalar>> out,
            Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    detail::NearestList<Scalar> found(out, max_distance);
    search(query, found);
    return found.size();
  }

  void within(const Vector3& query, Scalar radius, std::vector<Neighbor<Scalar>>& out) const {
    detail::RadiusList<Scalar> found(out, radius);
    search(query, found);
  }

 private:
  template <class Collector>
  void search(const Vector3& query, Collector& found) const {
    for (std::size_t i = 0; i < positions_.size(); ++i) {
      const Vector3 d = positions_[i] - query;
      const Scalar distance = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
      if (distance < found.bound()) found.offer(static_cast<Index>(i), distance);  // false for NaN
    }
  }

  std::vector<Vector3> positions_;
  Index rejected_ = 0;
};
static_assert(NearestNeighborSearch<BruteForce<float>> && NearestNeighborSearch<BruteForce<double>>);

}  // namespace chainslam
