#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "chainslam/core/lanes.hpp"

namespace chainslam::detail {

inline constexpr std::size_t fpfh_bins = 11;

/// Counts how one oriented point's pairs with others fall into the three histograms of FPFH.
///
/// With the Darboux frame u = n_s, v = (p_t - p_s) x u / |...|, w = u x v of the point s whose normal is the nearer to
/// the line between them: theta = atan2(w . n_t, u . n_t), alpha = v . n_t, phi = u . (p_t - p_s) / |p_t - p_s| (Rusu
/// et al. 2009, eq. 1 and 2). No angle is computed: a pair is compared with the borders of all bins, several pairs at
/// once. Pairs in one place, or on a line along the normal, have no frame and are not counted.
class PairHistogram {
 public:
  using Counts = std::array<std::int32_t, 3 * fpfh_bins>;

  void clear() { size_ = 0; }

  /// Adds the pair with a point at `offset` from the first.
  void add(const Eigen::Vector3f& offset, const Eigen::Vector3f& normal) {
    if (size_ + lane_count > room()) grow();
    for (std::size_t axis = 0; axis < 3; ++axis) {
      columns_[axis][size_] = offset[static_cast<Eigen::Index>(axis)];
      columns_[3 + axis][size_] = normal[static_cast<Eigen::Index>(axis)];
    }
    ++size_;
  }

  /// The pairs in each bin, theta's first. Returns how many pairs there are in all.
  /// @param normal  of the first point.
  std::int32_t count(const Eigen::Vector3f& normal, Counts& counts) {
    const std::size_t padded = whole_lanes(size_);
    for (std::size_t i = size_; i < padded; ++i)
      for (std::vector<float>& column : columns_) column[i] = 0;
    MaskLanes valid{};
    for (std::size_t i = 0; i < padded; i += lane_count) measure(i, normal, valid);
    const std::int32_t pairs = -sum(valid);
    count_angles(padded, pairs, counts.data());
    count_cosines(columns_[2].data(), padded, pairs, counts.data() + fpfh_bins);
    count_cosines(columns_[3].data(), padded, pairs, counts.data() + 2 * fpfh_bins);
    return pairs;
  }

 private:
  [[nodiscard]] std::size_t room() const { return columns_[0].size(); }
  void grow() {
    for (std::vector<float>& column : columns_) column.resize(std::max(2 * room(), std::size_t{128}));
  }

  /// Replaces the columns by what is compared with the borders: the point whose direction is theta's, alpha, phi.
  void measure(std::size_t i, const Eigen::Vector3f& normal, MaskLanes& valid) {
    constexpr float least_squared_sine = 1e-12F;
    FloatLanes dx, dy, dz, qx, qy, qz;
    load(&columns_[0][i], dx);
    load(&columns_[1][i], dy);
    load(&columns_[2][i], dz);
    load(&columns_[3][i], qx);
    load(&columns_[4][i], qy);
    load(&columns_[5][i], qz);
    const FloatLanes zero{};
    const FloatLanes px = zero + normal[0], py = zero + normal[1], pz = zero + normal[2];
    const FloatLanes along_p = dx * px + dy * py + dz * pz, along_q = dx * qx + dy * qy + dz * qz;
    const FloatLanes cosine = px * qx + py * qy + pz * qz;
    const MaskLanes swapped = along_p * along_p < along_q * along_q;

    FloatLanes ux, uy, uz, tx, ty, tz;
    choose(swapped, qx, px, ux);
    choose(swapped, qy, py, uy);
    choose(swapped, qz, pz, uz);
    choose(swapped, px, qx, tx);
    choose(swapped, py, qy, ty);
    choose(swapped, pz, qz, tz);
    // The line runs from the frame's point to the other: swapped, that is -d.
    FloatLanes along, across;
    choose(swapped, -along_q, along_p, along);
    choose(swapped, -along_p, along_q, across);
    const FloatLanes vx = dy * uz - dz * uy, vy = dz * ux - dx * uz, vz = dx * uy - dy * ux;
    const FloatLanes squared_length = dx * dx + dy * dy + dz * dz, squared_width = vx * vx + vy * vy + vz * vz;
    const MaskLanes good = squared_width > least_squared_sine * squared_length;
    FloatLanes inverse_length, inverse_width, alpha;
    inverse_root(squared_length, inverse_length);
    inverse_root(squared_width, inverse_width);
    negate_where(swapped, (vx * tx + vy * ty + vz * tz) * inverse_width, alpha);
    const FloatLanes none = zero - 2.0F;  // below all borders
    FloatLanes column;
    choose(good, squared_width * inverse_width * cosine, zero, column);
    store(column, &columns_[0][i]);
    choose(good, across - along * cosine, zero, column);
    store(column, &columns_[1][i]);
    choose(good, alpha, none, column);
    store(column, &columns_[2][i]);
    choose(good, along * inverse_length, none, column);
    store(column, &columns_[3][i]);
    valid += good;
  }

  /// 11 equal bins over [-pi, pi] for the angles of (x, y). Borders in the upper half plane are at (2 j - 1) pi / 11,
  /// j = 1 ... 5, and the lower half mirrors it; a point is beyond one if it lies to its left.
  void count_angles(std::size_t padded, std::int32_t pairs, std::int32_t* counts) const {
    constexpr std::size_t borders = fpfh_bins / 2;
    constexpr std::array<float, borders> cosines{0.95949297F, 0.65486073F, 0.14231484F, -0.41541501F, -0.84125353F};
    constexpr std::array<float, borders> sines{0.28173256F, 0.75574957F, 0.98982144F, 0.90963200F, 0.54064082F};
    std::array<MaskLanes, borders> beyond{}, below{};
    const FloatLanes zero{};
    for (std::size_t i = 0; i < padded; i += lane_count) {
      FloatLanes x, y, above;
      load(&columns_[0][i], x);
      load(&columns_[1][i], y);
      const MaskLanes lower = y < zero;
      negate_where(lower, y, above);
#pragma GCC unroll 5
      for (std::size_t j = 0; j < borders; ++j) {
        const MaskLanes left = cosines[j] * above > sines[j] * x;
        beyond[j] += left;
        below[j] += left & lower;
      }
    }
    std::array<std::int32_t, borders + 1> upper_half{}, lower_half{};
    for (std::size_t j = 0; j < borders; ++j) {
      lower_half[j] = -sum(below[j]);
      upper_half[j] = -sum(beyond[j]) - lower_half[j];
    }
    counts[borders] = pairs - upper_half[0] - lower_half[0];
    for (std::size_t j = 0; j < borders; ++j) {
      counts[borders + j + 1] = upper_half[j] - upper_half[j + 1];
      counts[borders - j - 1] = lower_half[j] - lower_half[j + 1];
    }
  }

  /// 11 equal bins over [-1, 1].
  static void count_cosines(const float* values, std::size_t padded, std::int32_t pairs, std::int32_t* counts) {
    std::array<MaskLanes, fpfh_bins - 1> beyond{};
    for (std::size_t i = 0; i < padded; i += lane_count) {
      FloatLanes value;
      load(values + i, value);
#pragma GCC unroll 10
      for (std::size_t j = 0; j < fpfh_bins - 1; ++j)
        beyond[j] += value >= (2.0F * static_cast<float>(j + 1) / static_cast<float>(fpfh_bins) - 1.0F);
    }
    std::int32_t above = pairs;
    for (std::size_t j = 0; j < fpfh_bins - 1; ++j) {
      const std::int32_t next = -sum(beyond[j]);
      counts[j] = above - next;
      above = next;
    }
    counts[fpfh_bins - 1] = above;
  }

  std::array<std::vector<float>, 6> columns_;  ///< offsets and normals; then what `measure` makes of them
  std::size_t size_ = 0;
};

}  // namespace chainslam::detail
