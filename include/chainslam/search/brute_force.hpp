#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/search_base.hpp"

namespace chainslam {

/// Looks at every point: the reference that the other searches are tested against, and the fastest for a few dozen
/// points. Keeps a copy of the positions.
///
/// The index of a point is its position in the input, from 0, whether or not the others were taken; indices are
/// not used again.
template <class ScalarType = float, int Dim = 3>
class BruteForce : public IncrementalSearchBase<BruteForce<ScalarType, Dim>, ScalarType, Dim> {
  using Base = IncrementalSearchBase<BruteForce, ScalarType, Dim>;
  friend Base;
  friend SearchBase<BruteForce, ScalarType, Dim>;

 public:
  using typename Base::Scalar;
  using typename Base::Vector;

  BruteForce() = default;

  /// @param points  in any frame, metres; NaN and infinite ones are never found.
  template <detail::PointSource<Dim> Points>
  explicit BruteForce(const Points& points) {
    positions_.reserve(static_cast<std::size_t>(detail::source_size<Dim>(points)));
    insert(points);
  }

  /// Points that can be found.
  [[nodiscard]] std::size_t size() const { return static_cast<std::size_t>(size_); }
  /// Points left out because a coordinate is NaN or infinite.
  [[nodiscard]] Index rejected() const { return rejected_; }
  /// Bytes held, free capacity included.
  [[nodiscard]] std::size_t memory() const { return positions_.capacity() * sizeof(Vector); }
  /// Whether i is the index of a point.
  [[nodiscard]] bool contains(Index i) const {
    return i >= 0 && static_cast<std::size_t>(i) < positions_.size() && is_finite(position(i));
  }
  /// Position of point i, metres.
  [[nodiscard]] const Vector& position(Index i) const { return positions_[static_cast<std::size_t>(i)]; }

  using Base::insert;
  /// Takes a point if it is finite. Returns whether it did.
  bool insert(const Vector& p) {
    static_cast<void>(to_index(positions_.size() + 1, "BruteForce"));
    positions_.push_back(p);
    const bool taken = is_finite(p);
    ++(taken ? size_ : rejected_);
    return taken;
  }

  /// Erases a point. Returns false if there is none with this index.
  bool erase(Index i) {
    if (!contains(i)) return false;
    positions_[static_cast<std::size_t>(i)].setConstant(std::numeric_limits<Scalar>::quiet_NaN());
    --size_;
    return true;
  }
  /// Erases the points for which `leaves(index, position)` holds. Returns how many went.
  template <class Predicate>
  Index erase_if(Predicate&& leaves) {
    const Index before = size_;
    for_each_point([&](Index i, const Vector& p) {
      if (leaves(i, p)) erase(i);
    });
    return before - size_;
  }
  void clear() { *this = BruteForce(); }  ///< erases everything

  /// Calls `visit(index, position)` for every point, in the order of the indices.
  template <class Visit>
  void for_each_point(Visit&& visit) const {
    for (std::size_t i = 0; i < positions_.size(); ++i)
      if (is_finite(positions_[i])) visit(static_cast<Index>(i), positions_[i]);
  }

 private:
  template <class Collector>
  void search(const Vector& query, Collector& found) const {
    for (std::size_t i = 0; i < positions_.size(); ++i) {
      const Scalar distance = squared_distance<Dim>(positions_[i].data(), query.data());
      if (distance < found.bound()) found.offer(static_cast<Index>(i), distance);  // false for NaN
    }
  }

  template <class Region>
  Index erase_region(const Region& region) {
    return erase_if([&](Index, const Vector& p) { return region.contains(p); });
  }
  template <class Region, class Visit>
  void visit_region(const Region& region, Visit&& visit) const {
    for_each_point([&](Index i, const Vector& p) {
      if (region.contains(p)) visit(i, p);
    });
  }

  std::vector<Vector> positions_;  ///< NaN or infinite where there is no point
  Index size_ = 0;
  Index rejected_ = 0;
};
static_assert(IncrementalSearch<BruteForce<float>> && IncrementalSearch<BruteForce<double, 2>>);
static_assert(SeededSearch<BruteForce<float>> && FixedSizeSearch<BruteForce<float>>);

}  // namespace chainslam
