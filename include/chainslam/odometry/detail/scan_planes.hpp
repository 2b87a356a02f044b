#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/plane_fit.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/detail/plane_equations.hpp"
#include "chainslam/odometry/detail/plane_fits.hpp"
#include "chainslam/odometry/detail/plane_matches.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam::detail {

/// The nearest `Count` points of a map to a place that moves, as long as the map stays the same. Two more are kept, and
/// the nearest chosen of them wherever no other point can have come nearer; the map is searched again only elsewhere.
template <class Scalar, std::size_t Count>
class KeptNeighbors {
 public:
  static constexpr std::size_t kept = 8, asked = Count + 2;  ///< in registers of `kept`
  static_assert(Count > 0 && asked <= kept);
  using Vector = Eigen::Matrix<Scalar, 3, 1>;
  enum class Change { none, same, others };

  /// Goes to `p`. Says whether the nearest points are others than before, in whatever order, or fewer than `Count` are
  /// within `max_distance` (none).
  template <NearestNeighborSearch Map>
  [[nodiscard]] Change find(const Map& map, const Vector& p, Scalar max_distance) {
    const unsigned now = any() && max_distance == limit_ ? choose(p) : 0;
    if (now == 0) return search(map, p, max_distance);
    return std::exchange(chosen_, now) == now ? Change::same : Change::others;
  }

  /// Calls `visit(position)` for each of the nearest.
  template <class Visit>
  void for_each(Visit&& visit) const {
    for (unsigned left = chosen_; left != 0; left &= left - 1) {
      const auto i = static_cast<std::size_t>(std::countr_zero(left));
      visit(Vector(places_[0][i], places_[1][i], places_[2][i]));
    }
  }

 private:
  typedef Scalar Eight __attribute__((vector_size(kept * sizeof(Scalar))));
  static constexpr unsigned first_ones = (1U << Count) - 1;
  static constexpr Scalar none_there = std::numeric_limits<Scalar>::max();

  [[nodiscard]] bool any() const { return count_ >= static_cast<Index>(Count); }
  [[nodiscard]] unsigned choose(const Vector& p) const;
  template <NearestNeighborSearch Map>
  [[nodiscard]] Change search(const Map& map, const Vector& p, Scalar max_distance);
  template <NearestNeighborSearch Map>
  [[nodiscard]] Index ask(const Map& map, const Vector& p, Scalar max_distance) {
    const auto out = std::span(found_).first(asked);
    if constexpr (SeededSearch<Map>)
      if (count_ > 0) return map.knn(p, out, max_distance, std::span(found_).first(static_cast<std::size_t>(count_)));
    return map.knn(p, out, max_distance);
  }
  /// Whether the first of `found_` are those that were chosen of `before`.
  [[nodiscard]] bool same_as(const std::array<Neighbor<Scalar>, kept>& before, unsigned chosen) const {
    bool same = true;
    for (std::size_t i = 0; i < Count; ++i) {
      bool there = false;
      for (std::size_t j = 0; j < kept; ++j) there |= (chosen >> j & 1U) != 0 && found_[i].index == before[j].index;
      same &= there;
    }
    return same;
  }

  std::array<Neighbor<Scalar>, kept> found_;        ///< ascending from `at_`
  std::array<std::array<Scalar, kept>, 3> places_;  ///< of those found, axis by axis
  Vector at_;                                       ///< where the map was searched
  Index count_ = 0;
  unsigned chosen_ = 0;  ///< bit by bit: the nearest now
  Scalar free_way_ = 0;  ///< metres from `at_` within which the first ones stay the nearest
  Scalar beyond_ = 0;    ///< metres from `at_`, which points that are not kept lie beyond
  Scalar limit_ = 0;     ///< metres that points may be off
};

/// Which of the points kept are the nearest to `p`; 0 if others may be.
template <class Scalar, std::size_t Count>
unsigned KeptNeighbors<Scalar, Count>::choose(const Vector& p) const {
  constexpr auto rounding = static_cast<Scalar>(1e-5);
  const Scalar mx = p[0] - at_[0], my = p[1] - at_[1], mz = p[2] - at_[2];
  const Scalar squared_way = mx * mx + my * my + mz * mz;
  if (squared_way < free_way_ * free_way_ * (1 - rounding)) return first_ones;
  const Scalar reach = beyond_ * (1 - rounding) - std::sqrt(squared_way);
  if (!(reach > 0)) return 0;
  Eight dx, dy, dz;
  std::memcpy(&dx, places_[0].data(), sizeof dx);
  std::memcpy(&dy, places_[1].data(), sizeof dy);
  std::memcpy(&dz, places_[2].data(), sizeof dz);
  dx -= p[0];
  dy -= p[1];
  dz -= p[2];
  const Eight distances = dx * dx + dy * dy + dz * dz;
  auto rank = distances < Scalar(0);  // all 0: counts downwards, since true is -1
  for (std::size_t i = 0; i < kept; ++i) rank += distances[i] < distances;
  const Scalar squared_reach = reach * reach;
  const auto near = (rank > -static_cast<int>(Count)) & (distances < squared_reach);
  unsigned chosen = 0;
  for (std::size_t i = 0; i < kept; ++i) chosen |= static_cast<unsigned>(near[i] & 1) << i;
  return std::popcount(chosen) == static_cast<int>(Count) ? chosen : 0;  // else equal distances, or points too far
}

template <class Scalar, std::size_t Count>
template <NearestNeighborSearch Map>
auto KeptNeighbors<Scalar, Count>::search(const Map& map, const Vector& p, Scalar max_distance) -> Change {
  const std::array<Neighbor<Scalar>, kept> before = found_;
  count_ = ask(map, p, max_distance);
  at_ = p;
  limit_ = beyond_ = max_distance;
  if constexpr (requires { map.max_search_radius(); }) beyond_ = std::min(beyond_, map.max_search_radius());
  if (!any()) {
    chosen_ = 0;
    return Change::none;
  }
  for (std::size_t i = 0; i < kept; ++i) {
    const bool there = static_cast<Index>(i) < count_;
    const Vector place = there ? Vector(map.position(found_[i].index)) : Vector(none_there, none_there, none_there);
    for (std::size_t axis = 0; axis < 3; ++axis) places_[axis][i] = place[static_cast<Eigen::Index>(axis)];
  }
  // Each may come nearer or go farther by as much as the place moves.
  const Scalar farthest = std::sqrt(found_[Count - 1].squared_distance);
  free_way_ = std::max(Scalar(0), beyond_ - farthest);
  if (count_ > static_cast<Index>(Count))
    free_way_ = std::min(free_way_, (std::sqrt(found_[Count].squared_distance) - farthest) / 2);
  if (count_ == static_cast<Index>(asked))
    beyond_ = std::sqrt(found_[static_cast<std::size_t>(count_) - 1].squared_distance);
  return same_as(before, std::exchange(chosen_, first_ones)) ? Change::same : Change::others;
}

/// The points of a scan with the planes that they were matched with, kept from matching to matching while neither scan
/// nor map changes: neighbours are looked up again where they may be others, and planes fitted again where they are.
template <class Scalar, std::size_t Neighbors>
class ScanPlanes {
 public:
  ScanPlanes() = default;
  /// @param scan    n points, body frame, all finite.
  /// @param origin  in the map's frame, metres: somewhere near the scan.
  template <Cloud Scan>
  ScanPlanes(const Scan& scan, const Eigen::Vector3d& origin) : origin_(on_grid(origin)), kept_(cloud_size(scan)) {
    blocks_.resize((kept_.size() + PlaneBlock::width - 1) / PlaneBlock::width);
    for (std::size_t i = 0; i < kept_.size(); ++i)
      blocks_[i / PlaneBlock::width].set_point(i % PlaneBlock::width, position(scan, i));
  }

  /// Matches all points, lying at T_map_body.
  template <Cloud Scan, NearestNeighborSearch Map, Executor E>
  void match(const Scan& scan, const Map& map, const SE3d& T_map_body, const PlaneRule& rule, const E& executor);

  /// Sums over the matches; see there.
  template <Executor E, class Weight>
  [[nodiscard]] PlaneEquations equations(const SE3d& T_map_body, const ResidualGate& gate, Weight&& weight,
                                         const E& executor) const {
    return plane_equations(blocks_, origin_, T_map_body, gate, weight, executor);
  }

 private:
  /// Rounded to what float holds exactly, up to 16 km: g++ 12 may leave out a rounding to float and back.
  [[nodiscard]] static Eigen::Vector3d on_grid(const Eigen::Vector3d& p) {
    constexpr double steps = 1024;  // in a metre
    return {std::round(steps * p[0]) / steps, std::round(steps * p[1]) / steps, std::round(steps * p[2]) / steps};
  }
  void set(std::size_t point, const MatchedPlane& plane) {
    blocks_[point / PlaneBlock::width].set_plane(point % PlaneBlock::width, plane);
  }

  /// Far from the origin and nearly along a line, its solution takes double.
  [[nodiscard]] MatchedPlane intercept_plane_of(const KeptNeighbors<Scalar, Neighbors>& neighbors,
                                                const PlaneRule& rule) const {
    std::array<Eigen::Vector3d, Neighbors> points;
    std::size_t count = 0;
    neighbors.for_each([&](const auto& neighbor) { points[count++] = converted<double>(neighbor); });
    return intercept_plane(fit_plane(std::span<const Eigen::Vector3d>(points)), points, rule, origin_);
  }

  Eigen::Vector3d origin_ = zeros<Eigen::Vector3d>();
  std::vector<PlaneBlock> blocks_;
  std::vector<KeptNeighbors<Scalar, Neighbors>> kept_;
};

template <class Scalar, std::size_t Neighbors>
template <Cloud Scan, NearestNeighborSearch Map, Executor E>
void ScanPlanes<Scalar, Neighbors>::match(const Scan& scan, const Map& map, const SE3d& T_map_body,
                                          const PlaneRule& rule, const E& executor) {
  using Found = typename KeptNeighbors<Scalar, Neighbors>::Change;
  const Eigen::Matrix3d R = T_map_body.rotation().matrix();
  const Eigen::Vector3d& t = T_map_body.translation();
  const auto max_distance = static_cast<Scalar>(rule.max_neighbor_distance);
  const auto origin = converted<Scalar>(origin_);
  constexpr Index grain = blocks_a_chunk * static_cast<Index>(PlaneBlock::width);
  executor.for_chunks(to_index(kept_.size()), grain, [&](Index begin, Index end) {
    PlaneFits<Neighbors> fits;
    const auto take = [&](std::size_t point, const MatchedPlane& plane) { set(point, plane); };
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      const SearchVector<Map> p = converted<Scalar>(Eigen::Vector3d(sum_of(product(R, position(scan, i)), t)));
      const Found found = kept_[i].find(map, p, max_distance);
      if (found == Found::none) set(i, {});
      if (found != Found::others) continue;
      if (rule.form == PlaneForm::intercept) {
        set(i, intercept_plane_of(kept_[i], rule));
        continue;
      }
      fits.add(i);
      kept_[i].for_each([&](const auto& neighbor) {
        fits.add_neighbor(converted<float>(SearchVector<Map>(difference_of(neighbor, origin))));
      });
      if (fits.full()) fits.fit(rule, take);
    }
    fits.fit(rule, take);
  });
}

}  // namespace chainslam::detail
