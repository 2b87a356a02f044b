#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/detail/source_columns.hpp"

namespace chainslam::detail {

/// A rigid motion, its matrix ready: p_target = rotation * (p_source - pivot) + pivot's place.
struct Placement {
  Eigen::Matrix3d rotation = identity<Eigen::Matrix3d>();
  Eigen::Vector3d pivot = Eigen::Vector3d::Zero();  ///< of the source, in the target's frame
};

/// rotation * v.
template <class Number>
[[nodiscard]] std::array<Number, 3> rotated(const Eigen::Matrix3d& R, const std::array<Number, 3>& v) {
  return {R(0, 0) * v[0] + R(0, 1) * v[1] + R(0, 2) * v[2], R(1, 0) * v[0] + R(1, 1) * v[1] + R(1, 2) * v[2],
          R(2, 0) * v[0] + R(2, 1) * v[1] + R(2, 2) * v[2]};
}

/// The match of every source point, with what a metric wants to know of it beside it: written when a match changes,
/// read in rows at every pass.
template <class Scalar, Surface TargetSurface>
class MatchColumns {
 public:
  /// So far that its square is beyond every distance: where a point has no match.
  static constexpr Scalar far = Scalar(1e18);

  explicit MatchColumns(Index count)
      : indices_(static_cast<std::size_t>(count), -1), positions_(count, far), surfaces_(count) {}

  /// The index in the target of point i's match, or -1. It may be farther away than the largest distance.
  [[nodiscard]] Index index(Index i) const { return indices_[static_cast<std::size_t>(i)]; }
  [[nodiscard]] const Columns<Scalar, 3>& positions() const { return positions_; }
  [[nodiscard]] const Columns<float, numbers_of(TargetSurface)>& surfaces() const { return surfaces_; }

 protected:
  template <class Target>
  void set(const Target& target, Index i, Index match) {
    if (match == index(i)) return;
    indices_[static_cast<std::size_t>(i)] = match;
    if (match < 0) return positions_.set(i, std::array<Scalar, 3>{far, far, far});
    const auto& q = target.position(match);
    positions_.set(i, std::array<Scalar, 3>{q[0], q[1], q[2]});
    if constexpr (TargetSurface == Surface::normal) surfaces_.set(i, finite_normal(target.normal(match)));
    if constexpr (TargetSurface == Surface::covariance) surfaces_.set(i, upper_triangle(target.covariance(match)));
  }

 private:
  std::vector<Index> indices_;
  Columns<Scalar, 3> positions_;
  Columns<float, numbers_of(TargetSurface)> surfaces_;
};

/// Moves points [begin, end) and hands each to `visit(i, query)`, in the target's scalar.
template <class Scalar, class Visit>
void for_each_moved(const SourceColumns& source, const Placement& at, Index begin, Index end, Visit&& visit) {
  for (Index i = begin; i < end; ++i) {
    const std::array<double, 3> x{*source.positions.at(0, i), *source.positions.at(1, i), *source.positions.at(2, i)};
    const std::array<double, 3> y = rotated(at.rotation, x);
    visit(i,
          Eigen::Matrix<Scalar, 3, 1>(static_cast<Scalar>(y[0] + at.pivot[0]), static_cast<Scalar>(y[1] + at.pivot[1]),
                                      static_cast<Scalar>(y[2] + at.pivot[2])));
  }
}

/// Matches that the target names: asked for again at every pass.
template <MatchingTarget Target, Surface TargetSurface>
class NamedMatches : public MatchColumns<typename Target::Scalar, TargetSurface> {
 public:
  using Scalar = typename Target::Scalar;

  NamedMatches(const Target& target, Index count, Scalar max_distance)
      : MatchColumns<Scalar, TargetSurface>(count), target_(target), max_distance_(max_distance) {}

  [[nodiscard]] static double within(const Target& /*target*/, double max_distance) { return max_distance; }

  void update(const SourceColumns& source, const Placement& at, Index begin, Index end, bool /*keep*/) {
    for_each_moved<Scalar>(source, at, begin, end, [&](Index i, const Eigen::Matrix<Scalar, 3, 1>& query) {
      this->set(target_, i, target_.match(query, max_distance_));
    });
  }

 private:
  const Target& target_;
  Scalar max_distance_;
};

}  // namespace chainslam::detail
