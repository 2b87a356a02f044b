#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

/// Which neighbours a point is described by: the `max_neighbors` nearest, the point itself counted, of those within
/// `radius`. About five voxels wide sees corners and edges, two or three see only planes.
struct FpfhOptions {
  double radius = 5.0;        ///< metres
  Index max_neighbors = 100;  ///< at least 2
};

/// One column a point: three histograms of 11 bins, each of which sums to 100, or all zeros for a point that has none.
using FpfhFeatures = Eigen::Matrix<float, 33, Eigen::Dynamic>;

namespace detail {

inline constexpr int fpfh_bins = 11;
using FpfhColumn = Eigen::Matrix<float, 3 * fpfh_bins, 1>;

/// The bin, of 11 equal ones over [-pi, pi], that the angle of (x, y) lies in. Compares with the borders' directions:
/// no arc tangent, so that no C library has a say.
[[nodiscard]] inline int angle_bin(double x, double y) {
  // The borders at (2 j - 1) pi / 11, j = 1 ... 5; the lower half plane mirrors the upper.
  static constexpr std::array<double, 5> cosines{0.95949297361449739, 0.65486073394528506, 0.14231483827328514,
                                                 -0.41541501300188643, -0.84125353283118117};
  static constexpr std::array<double, 5> sines{0.28173255684142970, 0.75574957435425828, 0.98982144188093273,
                                               0.90963199535451837, 0.54064081745559758};
  const double above = std::abs(y);
  int borders = 0;
  for (std::size_t j = 0; j < cosines.size(); ++j) borders += cosines[j] * above - sines[j] * x > 0 ? 1 : 0;
  return y < 0 ? fpfh_bins / 2 - borders : fpfh_bins / 2 + borders;
}

/// The bin, of 11 equal ones over [-1, 1], that a cosine lies in.
[[nodiscard]] inline int cosine_bin(double cosine) {
  return static_cast<int>(std::clamp(0.5 * fpfh_bins * (cosine + 1.0), 0.0, fpfh_bins - 1.0));
}

/// The bins of theta, alpha and phi for two oriented points; nothing where they lie in one place or on a line along the
/// normal, which has no frame. With the Darboux frame u = n_s, v = (p_t - p_s) x u / |...|, w = u x v of the point s
/// whose normal is the nearer to the line between them: theta = atan2(w . n_t, u . n_t), alpha = v . n_t, phi = u .
/// (p_t - p_s) / |p_t - p_s| (Rusu et al. 2009, eq. 1 and 2).
[[nodiscard]] inline std::optional<std::array<int, 3>> pair_bins(const Eigen::Vector3d& p, const Eigen::Vector3d& n_p,
                                                                 const Eigen::Vector3d& q, const Eigen::Vector3d& n_q) {
  constexpr double least_squared_sine = 1e-12;
  Eigen::Vector3d line = q - p;
  const Eigen::Vector3d *u = &n_p, *n_t = &n_q;
  double along = u->dot(line);
  if (std::abs(along) < std::abs(n_q.dot(line))) {
    std::swap(u, n_t);
    line = -line;
    along = u->dot(line);
  }
  const double squared_length = line.squaredNorm();
  const Eigen::Vector3d v = line.cross(*u);
  const double squared_width = v.squaredNorm();
  if (!(squared_width > least_squared_sine * squared_length)) return std::nullopt;
  const double width = std::sqrt(squared_width);
  const double cosine = u->dot(*n_t);
  return std::array{angle_bin(width * cosine, line.dot(*n_t) - along * cosine), cosine_bin(v.dot(*n_t) / width),
                    cosine_bin(along / std::sqrt(squared_length))};
}

/// The nearest neighbours of every point of a cloud, the point itself left out.
template <class Scalar>
struct NeighborTable {
  std::size_t width = 0;
  std::vector<Neighbor<Scalar>> entries;
  std::vector<std::size_t> counts;

  [[nodiscard]] std::span<const Neighbor<Scalar>> of(std::size_t i) const {
    return std::span(entries).subspan(i * width, counts[i]);
  }
};

/// @param options  checked; only points with a normal are asked for.
template <NearestNeighborSearch Search, Executor Exec>
[[nodiscard]] NeighborTable<typename Search::Scalar> oriented_neighbors(const PointCloud<float>& cloud,
                                                                        const Search& search,
                                                                        const FpfhOptions& options, const Exec& exec) {
  using Scalar = typename Search::Scalar;
  constexpr Index grain = 256;
  const auto has_normal = [&](std::size_t i) {
    const float squared = cloud.normals[i].squaredNorm();
    return is_finite(squared) && squared > 0.25F;
  };
  NeighborTable<Scalar> table;
  table.width = static_cast<std::size_t>(options.max_neighbors);
  table.entries.resize(cloud.size() * table.width);
  table.counts.resize(cloud.size());
  exec.for_chunks(to_index(cloud.size(), "cloud"), grain, [&](Index begin, Index end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      if (!has_normal(i) || !is_finite(cloud.positions[i])) continue;
      const Eigen::Matrix<Scalar, 3, 1> point = cloud.positions[i].template cast<Scalar>();
      const auto row = std::span(table.entries).subspan(i * table.width, table.width);
      const auto found = static_cast<std::size_t>(search.knn(point, row, static_cast<Scalar>(options.radius)));
      const auto kept = std::remove_if(row.begin(), row.begin() + static_cast<std::ptrdiff_t>(found),
                                       [&](const Neighbor<Scalar>& neighbor) {
                                         const auto j = static_cast<std::size_t>(neighbor.index);
                                         return j == i || !(neighbor.squared_distance > 0) || !has_normal(j);
                                       });
      table.counts[i] = static_cast<std::size_t>(kept - row.begin());
    }
  });
  return table;
}

/// SPFH: the histograms of the pairs of point i with each of its neighbours, in per cent of the pairs; zeros without
/// any.
template <class Scalar>
[[nodiscard]] FpfhColumn simplified_histogram(const PointCloud<float>& cloud, std::size_t i,
                                              std::span<const Neighbor<Scalar>> neighbors) {
  std::array<Index, 3 * fpfh_bins> counts{};
  Index pairs = 0;
  const Eigen::Vector3d p = position(cloud, i), n_p = cloud.normals[i].cast<double>();
  for (const Neighbor<Scalar>& neighbor : neighbors) {
    const auto j = static_cast<std::size_t>(neighbor.index);
    const auto bins = pair_bins(p, n_p, position(cloud, j), cloud.normals[j].cast<double>());
    if (!bins) continue;
    for (std::size_t k = 0; k < 3; ++k) ++counts[k * fpfh_bins + static_cast<std::size_t>((*bins)[k])];
    ++pairs;
  }
  FpfhColumn histogram = FpfhColumn::Zero();
  for (std::size_t bin = 0; pairs > 0 && bin < counts.size(); ++bin)
    histogram[static_cast<Eigen::Index>(bin)] = 100.0F * static_cast<float>(counts[bin]) / static_cast<float>(pairs);
  return histogram;
}

}  // namespace detail

/// Describes the surroundings of each point by how normals turn about it: Fast Point Feature Histograms (Rusu, Blodow
/// and Beetz 2009), which a rigid motion of cloud and normals does not change.
///
/// FPFH(p) = (SPFH(p) + sum w_i SPFH(p_i) / sum w_i) / 2 with w_i = 1 / |p_i - p| over p's neighbours: the paper's
/// weights, but a mean where the paper has a sum over metres, so that the unit of length does not decide how much the
/// neighbours count. Neighbours in the very same place are left out. Rows as in PCL and Open3D: theta, alpha, phi.
///
/// @param cloud    n points with unit normals, metres. All normals must look to the side that the points were seen
///                 from, in this cloud as in those it is compared with. Points without a normal (zero or not finite)
///                 or without neighbours get zeros.
/// @param search   over the same points: its indices are the cloud's.
/// @returns 33 x n, the same to the bit for any executor. Needs 8 n max_neighbors bytes (16 for double) meanwhile.
/// @throws std::invalid_argument if the cloud has no normals or an option makes no sense.
template <NearestNeighborSearch Search, Executor Exec = Serial>
[[nodiscard]] FpfhFeatures estimate_fpfh(const PointCloud<float>& cloud, const Search& search,
                                         const FpfhOptions& options = {}, const Exec& executor = {}) {
  if (!(options.radius > 0) || options.max_neighbors < 2)
    throw std::invalid_argument("estimate_fpfh: radius must be positive, max_neighbors at least 2");
  if (!cloud.empty() && !cloud.has_normals())
    throw std::invalid_argument("estimate_fpfh: the cloud has no normals; call estimate_normals first");
  constexpr Index grain = 256;
  const Index count = to_index(cloud.size(), "cloud");
  const auto neighbors = detail::oriented_neighbors(cloud, search, options, executor);
  FpfhFeatures simplified(33, count), features(33, count);
  executor.for_chunks(count, grain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const auto point = static_cast<std::size_t>(i);
      simplified.col(i) = detail::simplified_histogram(cloud, point, neighbors.of(point));
    }
  });
  executor.for_chunks(count, grain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      detail::FpfhColumn sum = detail::FpfhColumn::Zero();
      float weights = 0;
      for (const auto& neighbor : neighbors.of(static_cast<std::size_t>(i))) {
        const detail::FpfhColumn column = simplified.col(neighbor.index);
        if (!(column.head<detail::fpfh_bins>().sum() > 0)) continue;
        const auto weight = static_cast<float>(1 / std::sqrt(neighbor.squared_distance));
        sum += weight * column;
        weights += weight;
      }
      features.col(i) = simplified.col(i);
      if (weights > 0) features.col(i) = 0.5F * (features.col(i) + sum / weights);
    }
  });
  return features;
}

}  // namespace chainslam
