#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/registration/detail/consensus.hpp"
#include "chainslam/registration/detail/quad.hpp"
#include "chainslam/registration/detail/source_columns.hpp"
#include "chainslam/registration/matched_points.hpp"

namespace chainslam::detail {

/// The matches in columns of doubles about their middle, for fitting motions again to those that agree.
class RefitTable {
 public:
  explicit RefitTable(const MatchedPoints& points)
      : source_middle_(mean(points.source)),
        target_middle_(mean(points.target)),
        count_(points.size()),
        sources_(count_),
        targets_(count_, far) {
    for (Index i = 0; i < count_; ++i) {
      const Eigen::Vector3d p = points.source[static_cast<std::size_t>(i)] - source_middle_;
      const Eigen::Vector3d q = points.target[static_cast<std::size_t>(i)] - target_middle_;
      sources_.set(i, std::array<double, 3>{p[0], p[1], p[2]});
      targets_.set(i, std::array<double, 3>{q[0], q[1], q[2]});
    }
  }

  /// Fits the motion to the matches that agree with it, and again, `rounds` times at most, while its gain grows.
  template <RotationModel Rotation>
  [[nodiscard]] Hypothesis refit(const Hypothesis& hypothesis, double max_distance, Index rounds,
                                 const Rotation& rotation = {}) const {
    constexpr double rounding = 1e-12;
    Hypothesis best = hypothesis;
    Agreement agreement = agree(best.T_target_source, max_distance);
    for (Index round = 0; round < rounds && best.consensus >= Rotation::least_points; ++round) {
      const std::optional<SE3d> T = motion(agreement, rotation);
      if (!T) break;
      agreement = agree(*T, max_distance);
      if (!(agreement.gain > best.gain * (1 + rounding))) break;
      best = {.T_target_source = *T, .consensus = agreement.count, .gain = agreement.gain};
    }
    return best;
  }

 private:
  /// Of the matches that agree with a pose: how many, their gain, and the sums that a motion is fitted to.
  struct Agreement {
    Index count = 0;
    double gain = 0;
    Eigen::Vector3d source = Eigen::Vector3d::Zero(), target = Eigen::Vector3d::Zero();
    Eigen::Matrix3d target_source = zeros<Eigen::Matrix3d>();
  };

  [[nodiscard]] Agreement agree(const SE3d& T, double max_distance) const {
    const Eigen::Matrix3d R = T.rotation().matrix();
    const Eigen::Vector3d t = T * source_middle_ - target_middle_;
    const Quad largest = max_distance * max_distance, one = 1.0, none = 0.0;
    Quad count = 0.0, gain = 0.0;
    std::array<Quad, 3> source{none, none, none}, target{none, none, none};
    std::array<std::array<Quad, 3>, 3> products{source, source, source};
    for (Index i = 0; i < count_; i += Quad::size) {
      std::array<Quad, 3> p, q;
      Quad squared = 0.0;
      for (int axis = 0; axis < 3; ++axis) {
        p[static_cast<std::size_t>(axis)] = Quad::load(sources_.at(axis, i));
        q[static_cast<std::size_t>(axis)] = Quad::load(targets_.at(axis, i));
      }
      for (int row = 0; row < 3; ++row) {
        const Quad d =
            R(row, 0) * p[0] + R(row, 1) * p[1] + R(row, 2) * p[2] + t[row] - q[static_cast<std::size_t>(row)];
        squared += d * d;
      }
      const Quad weight = Quad::where_at_most(squared, largest, one, none);
      count += weight;
      gain += weight * (largest - squared);
      for (std::size_t row = 0; row < 3; ++row) {
        const Quad agreeing = weight * q[row];
        target[row] += agreeing;
        source[row] += weight * p[row];
        for (std::size_t column = 0; column < 3; ++column) products[row][column] += agreeing * p[column];
      }
    }
    Agreement sums{.count = static_cast<Index>(count.sum()), .gain = gain.sum()};
    for (Eigen::Index row = 0; row < 3; ++row) {
      const auto r = static_cast<std::size_t>(row);
      sums.source[row] = source[r].sum();
      sums.target[row] = target[r].sum();
      for (Eigen::Index column = 0; column < 3; ++column)
        sums.target_source(row, column) = products[r][static_cast<std::size_t>(column)].sum();
    }
    return sums;
  }

  template <RotationModel Rotation>
  [[nodiscard]] std::optional<SE3d> motion(const Agreement& sums, const Rotation& model) const {
    if (sums.count == 0) return std::nullopt;
    const double share = 1.0 / sums.count;
    const Eigen::Vector3d source = share * sums.source, target = share * sums.target;
    const std::optional<SO3d> rotation =
        model.rotation(difference_of(sums.target_source, product_transposed(sums.target, source)));
    if (!rotation) return std::nullopt;
    const Eigen::Vector3d source_mean = source_middle_ + source, target_mean = target_middle_ + target;
    const Eigen::Vector3d turned_mean = *rotation * source_mean;
    return SE3d(*rotation, target_mean - turned_mean);
  }

  static constexpr double far = 1e100;  ///< where there is no match

  Eigen::Vector3d source_middle_, target_middle_;
  Index count_;
  Columns<double, 3> sources_, targets_;
};

}  // namespace chainslam::detail
