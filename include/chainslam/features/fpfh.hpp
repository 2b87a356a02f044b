#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/lanes.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/detail/pair_histogram.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "chainslam/search/leaf_neighbors.hpp"

namespace chainslam {

/// A cloud with the search over its points, as `IndexedCloud`, whose normals are estimated once someone asks for one
/// nearby: what registration takes as a target that meets one source only, which matches a part of it. A target that
/// meets many is better given its normals at once, as an `IndexedCloud`.
///
/// The normals are those of `estimate_normals`, to the bit, in whatever order they are asked for. Const calls may run
/// at the same time on several threads, `normal` among them.
class OrientedOnDemand {
 public:
  using Search = KdTree<float>;  ///< the search over the points
  using Scalar = float;          ///< number type

  /// @param cloud      n points, metres; normals that it has are not looked at.
  /// @param options    `covariances` are not given.
  /// @param viewpoint  where the points were seen from, same frame, metres.
  /// @throws std::invalid_argument as `estimate_normals`.
  explicit OrientedOnDemand(PointCloud<float> cloud, const NormalOptions& options = {.neighbors = 10},
                            const Eigen::Vector3d& viewpoint = Eigen::Vector3d::Zero())
      : options_(options), viewpoint_(viewpoint), cloud_(std::move(cloud)), search_(cloud_) {
    detail::check(options_);
    options_.covariances = false;
    cloud_.normals.assign(cloud_.size(), Eigen::Vector3f::Zero());
    const Index groups = detail::count_chunks(detail::TreeLeaves(search_).count(), detail::leaves_at_once);
    estimated_ = std::make_unique<std::once_flag[]>(static_cast<std::size_t>(groups));
  }

  [[nodiscard]] const Search& search() const { return search_; }  ///< the search over the points
  /// Points that can be found: those of the cloud that are finite.
  [[nodiscard]] std::size_t size() const { return search_.size(); }
  [[nodiscard]] static constexpr bool has_normals() { return true; }  ///< whether there is a normal for each point

  /// Position of point i, metres.
  [[nodiscard]] const Eigen::Vector3f& position(Index i) const { return cloud_.positions[static_cast<std::size_t>(i)]; }
  /// Of a point that can be found.
  [[nodiscard]] const Eigen::Vector3f& normal(Index i) const {
    assert(search_.contains(i));
    const Index group = detail::TreeLeaves(search_).leaf_of(i) / detail::leaves_at_once;
    std::call_once(estimated_[static_cast<std::size_t>(group)], [&] { estimate(group); });
    return cloud_.normals[static_cast<std::size_t>(i)];
  }

  /// As `NearestNeighborSearch` has it.
  Index knn(const Eigen::Vector3f& query, std::span<Neighbor<float>> out,
            float max_distance = std::numeric_limits<float>::infinity()) const {
    return search_.knn(query, out, max_distance);
  }
  /// As `NearestNeighborSearch` has it.
  void within(const Eigen::Vector3f& query, float radius, std::vector<Neighbor<float>>& out) const {
    search_.within(query, radius, out);
  }

 private:
  void estimate(Index group) const {
    const Index begin = group * detail::leaves_at_once;
    const Index end = std::min(begin + detail::leaves_at_once, detail::TreeLeaves(search_).count());
    NormalEstimates no_estimates;
    (void)detail::estimate_in_leaves(search_, detail::NormalWriter{cloud_, no_estimates, options_, viewpoint_}, begin,
                                     end);
  }

  NormalOptions options_;
  Eigen::Vector3d viewpoint_;
  mutable PointCloud<float> cloud_;  ///< the normals of a group are written once, before they are read
  Search search_;
  mutable std::unique_ptr<std::once_flag[]> estimated_;  ///< of each group of leaves
};
static_assert(OrientedSearch<OrientedOnDemand>);

/// How FPFH puts a point's own histogram and those of its neighbours, at distances d_i, together.
enum class FpfhBlend {
  half_own,        ///< half its own, half the others' mean with weights 1 / d_i: as the paper, but for the mean
  neighbors_only,  ///< the others' mean with weights 1 / d_i^2: what PCL computes
};

/// Which neighbours a point is described by: the `max_neighbors` nearest, the point itself counted, of those within
/// `radius`. About five voxels wide sees corners and edges, two or three see only planes.
struct FpfhOptions {
  double radius = 5.0;                    ///< metres
  Index max_neighbors = 100;              ///< 0: all; else at least 2
  FpfhBlend blend = FpfhBlend::half_own;  ///< how histograms are put together
};

/// One column a point: three histograms of 11 bins, each of which sums to 100, or all zeros for a point that has none.
using FpfhFeatures = Eigen::Matrix<float, 33, Eigen::Dynamic>;

namespace detail {

/// The SPFH of all points in rows whose length is a whole number of registers.
class HistogramRows {
 public:
  static constexpr std::size_t length = 3 * fpfh_bins, stride = (length + 7) / 8 * 8;

  explicit HistogramRows(std::size_t count) : values_(count * stride) {}

  [[nodiscard]] float* operator[](std::size_t i) { return values_.data() + i * stride; }
  [[nodiscard]] const float* operator[](std::size_t i) const { return values_.data() + i * stride; }
  /// Whether the point has a histogram: they sum to 100, and some bin of the first is not empty.
  [[nodiscard]] bool empty(std::size_t i) const { return !((*this)[i][length] > 0); }
  void set(std::size_t i, const PairHistogram::Counts& counts, std::int32_t pairs) {
    float* row = (*this)[i];
    const float share = 100.0F / static_cast<float>(pairs);
    for (std::size_t bin = 0; bin < length; ++bin) row[bin] = share * static_cast<float>(counts[bin]);
    row[length] = 1;
  }

 private:
  std::vector<float> values_;
};

[[nodiscard]] inline bool has_normal(const Eigen::Vector3f& normal) {
  const float squared = normal.squaredNorm();
  return is_finite(squared) && squared > 0.25F;
}

/// SPFH: the histograms of the pairs of each point with its neighbours, in per cent of the pairs.
template <class Scalar, Executor Exec>
[[nodiscard]] HistogramRows simplified_histograms(const PointCloud<float>& cloud,
                                                  const Neighborhoods<Scalar>& neighborhoods, const Exec& executor) {
  constexpr Index grain = 256;
  std::vector<std::uint8_t> oriented(cloud.size());
  for (std::size_t i = 0; i < cloud.size(); ++i) oriented[i] = has_normal(cloud.normals[i]) ? 1 : 0;
  HistogramRows histograms(cloud.size());
  executor.for_chunks(neighborhoods.size(), grain, [&](Index begin, Index end) {
    PairHistogram histogram;
    PairHistogram::Counts counts;
    for (Index i = begin; i < end; ++i) {
      const auto at = static_cast<std::size_t>(i);
      if (oriented[at] == 0) continue;
      histogram.clear();
      for (const Neighbor<Scalar>& neighbor : neighborhoods[i]) {
        const auto j = static_cast<std::size_t>(neighbor.index);
        if (oriented[j] != 0 && neighbor.squared_distance > 0)
          histogram.add(difference_of(cloud.positions[j], cloud.positions[at]), cloud.normals[j]);
      }
      const std::int32_t pairs = histogram.count(cloud.normals[at], counts);
      if (pairs > 0) histograms.set(at, counts, pairs);
    }
  });
  return histograms;
}

/// The weighted mean of the neighbours' histograms; zeros without any.
template <class Scalar>
void mean_histogram(const HistogramRows& histograms, std::span<const Neighbor<Scalar>> neighbors, FpfhBlend blend,
                    std::array<float, HistogramRows::stride>& mean) {
  constexpr std::size_t registers = HistogramRows::stride / lane_count;
  std::array<FloatLanes, registers> sums{};
  float weights = 0;
  for (const Neighbor<Scalar>& neighbor : neighbors) {
    const auto j = static_cast<std::size_t>(neighbor.index);
    if (!(neighbor.squared_distance > 0) || histograms.empty(j)) continue;
    const auto squared = static_cast<float>(neighbor.squared_distance);
    const float weight = 1 / (blend == FpfhBlend::half_own ? std::sqrt(squared) : squared);
    const float* row = histograms[j];
    for (std::size_t k = 0; k < registers; ++k) {
      FloatLanes values;
      load(row + k * lane_count, values);
      sums[k] += weight * values;
    }
    weights += weight;
  }
  const float share = weights > 0 ? 1 / weights : 0.0F;
  for (std::size_t k = 0; k < registers; ++k) store(share * sums[k], mean.data() + k * lane_count);
}

}  // namespace detail

/// Describes the surroundings of each point by how normals rotate around it: Fast Point Feature Histograms (Rusu,
/// Blodow and Beetz 2009), which a rigid motion of cloud and normals does not change. For points whose neighbourhoods
/// are known; their reach is the features'.
///
/// FPFH(p) = (SPFH(p) + sum w_i SPFH(p_i) / sum w_i) / 2 with w_i = 1 / |p_i - p| over p's neighbours: the paper's
/// weights, but a mean where the paper has a sum over metres, so that the unit of length does not decide how much the
/// neighbours count. Neighbours in the very same place are left out. Rows as in PCL and Open3D: theta, alpha, phi.
/// The frame of a pair is that of the point whose normal is the nearer to the line between them; where both lean alike,
/// as equal normals do, rounding chooses, here as in PCL, and with the frame the sign of phi.
///
/// @param cloud  n points with unit normals, metres. All normals must look to the side that the points were seen
///               from, in this cloud as in those it is compared with. Points without a normal (zero or not finite)
///               or without neighbours get zeros.
/// @returns 33 x n, the same to the bit for any executor.
/// @throws std::invalid_argument if the cloud has no normals or the neighbourhoods are not its own.
template <class Scalar, Executor Exec = Serial>
[[nodiscard]] FpfhFeatures estimate_fpfh(const PointCloud<float>& cloud, const Neighborhoods<Scalar>& neighborhoods,
                                         FpfhBlend blend = FpfhBlend::half_own, const Exec& executor = {}) {
  constexpr Index grain = 256;
  constexpr std::size_t length = detail::HistogramRows::length;
  if (!cloud.empty() && !cloud.has_normals())
    throw std::invalid_argument("estimate_fpfh: the cloud has no normals; call estimate_normals first");
  if (neighborhoods.size() != to_index(cloud.size(), "cloud"))
    throw std::invalid_argument("estimate_fpfh: the neighbourhoods are of another cloud");
  const detail::HistogramRows histograms = detail::simplified_histograms(cloud, neighborhoods, executor);
  FpfhFeatures features(static_cast<Eigen::Index>(length), neighborhoods.size());
  executor.for_chunks(neighborhoods.size(), grain, [&](Index begin, Index end) {
    std::array<float, detail::HistogramRows::stride> others;
    for (Index i = begin; i < end; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const float* own = histograms[at];
      float* feature = features.data() + at * length;
      std::copy_n(own, length, feature);
      if (histograms.empty(at)) continue;
      detail::mean_histogram(histograms, neighborhoods[i], blend, others);
      if (!(others[length] > 0)) continue;  // no neighbour has one
      const bool half_own = blend == FpfhBlend::half_own;
      for (std::size_t bin = 0; bin < length; ++bin)
        feature[bin] = half_own ? 0.5F * (own[bin] + others[bin]) : others[bin];
    }
  });
  return features;
}

/// The same over a search.
///
/// @param search  over the same points: its indices are the cloud's.
/// @throws std::invalid_argument if the cloud has no normals or an option makes no sense.
template <NearestNeighborSearch Search, Executor Exec = Serial>
[[nodiscard]] FpfhFeatures estimate_fpfh(const PointCloud<float>& cloud, const Search& search,
                                         const FpfhOptions& options = {}, const Exec& executor = {}) {
  if (!(options.radius > 0) || options.max_neighbors < 0 || options.max_neighbors == 1)
    throw std::invalid_argument("estimate_fpfh: radius must be positive, max_neighbors 0 or at least 2");
  if (!cloud.empty() && !cloud.has_normals())
    throw std::invalid_argument("estimate_fpfh: the cloud has no normals; call estimate_normals first");
  return estimate_fpfh(cloud, Neighborhoods(cloud, search, options.radius, options.max_neighbors, executor),
                       options.blend, executor);
}

}  // namespace chainslam
