#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/matched_points.hpp"

namespace chainslam {

/// What `GncTls` found.
struct GncResult {
  SE3d T_target_source;         ///< maps source points into the target's frame
  std::vector<double> weights;  ///< of the pairs, in [0, 1]
  Index inliers = 0;            ///< pairs with a weight of 1/2 or more
  Index iterations = 0;         ///< steps made
};

/// The rigid motion of least truncated squares, found by graduated non-convexity: the cost starts convex and becomes
/// the truncated one step by step (Yang et al. 2020, GNC-TLS, eq. 14 and remark 5). Bears up to about 80 % of wrong
/// pairs; prune the others first.
///
/// @tparam Rotation  `AnyRotation`, or `YawOnly` where gravity is known.
template <class Rotation = AnyRotation>
struct GncTls {
  static_assert(RotationModel<Rotation>,
                "GncTls: Rotation needs `std::optional<SO3d> rotation(S) const` and `least_points`, as in AnyRotation; "
                "see chainslam/registration/matched_points.hpp");

  double noise_bound = 0.5;                   ///< metres: pairs farther apart are wrong
  double factor = 1.4;                        ///< by which the cost becomes less convex in a step
  Index max_iterations = 60;                  ///< steps of convexity, at most
  [[no_unique_address]] Rotation rotation{};  ///< which rotations are allowed

  /// @param source, target  pairs of finite points, metres.
  /// @returns nothing where the motion is not determined.
  /// @throws std::invalid_argument if the lengths differ or an option makes no sense.
  [[nodiscard]] std::optional<GncResult> solve(std::span<const Eigen::Vector3d> source,
                                               std::span<const Eigen::Vector3d> target) const {
    if (source.size() != target.size()) throw std::invalid_argument("GncTls: source and target differ in length");
    if (!(noise_bound > 0) || !(factor > 1))
      throw std::invalid_argument("GncTls: noise_bound must be positive, factor above 1");
    if (to_index(source.size()) < Rotation::least_points) return std::nullopt;
    const double squared_bound = noise_bound * noise_bound;
    GncResult result;
    result.weights.assign(source.size(), 1.0);
    std::optional<SE3d> T = fit_motion(source, target, result.weights, rotation);
    if (!T) return std::nullopt;
    std::vector<double> squared(source.size());
    double mu = 0, last_cost = 0;
    for (; result.iterations < max_iterations; ++result.iterations) {
      for (std::size_t i = 0; i < squared.size(); ++i) {
        const Eigen::Vector3d moved = *T * source[i];
        squared[i] = squared_distance<3>(moved.data(), target[i].data());
      }
      if (result.iterations == 0) {
        const double largest = *std::max_element(squared.begin(), squared.end());
        if (largest <= squared_bound) break;  // all are right
        mu = squared_bound / (2 * largest - squared_bound);
      }
      const double cost = reweigh(squared, mu, squared_bound, result.weights);
      if (result.iterations > 0 && std::abs(cost - last_cost) <= 1e-6 * cost && is_settled(result.weights)) break;
      last_cost = cost;
      T = fit_motion(source, target, result.weights, rotation);
      if (!T) return std::nullopt;
      mu *= factor;
    }
    result.T_target_source = *T;
    result.inliers = static_cast<Index>(
        std::count_if(result.weights.begin(), result.weights.end(), [](double w) { return w >= 0.5; }));
    return result;
  }

 private:
  /// Weights by the present convexity; returns the weighted sum of squares.
  static double reweigh(std::span<const double> squared, double mu, double squared_bound,
                        std::vector<double>& weights) {
    const double low = mu / (mu + 1) * squared_bound, high = (mu + 1) / mu * squared_bound;
    double cost = 0;
    for (std::size_t i = 0; i < squared.size(); ++i) {
      if (squared[i] <= low)
        weights[i] = 1;
      else if (squared[i] >= high)
        weights[i] = 0;
      else
        weights[i] = std::sqrt(squared_bound * mu * (mu + 1) / squared[i]) - mu;
      cost += weights[i] * squared[i];
    }
    return cost;
  }
  /// Whether all pairs have been classified as right or wrong.
  [[nodiscard]] static bool is_settled(std::span<const double> weights) {
    return std::all_of(weights.begin(), weights.end(), [](double w) { return w <= 0 || w >= 1; });
  }
};

}  // namespace chainslam
