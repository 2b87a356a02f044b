#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <stdexcept>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/localization.hpp"
#include "chainslam/slam/odometry_noise.hpp"

namespace chainslam::detail {

/// A pose and how well it is known.
struct UncertainPose {
  SE3d pose{};                              ///< T_map_body
  Matrix6d covariance = zeros<Matrix6d>();  ///< tangent [translation; rotation], of a right perturbation
};

/// The covariance of which this is the square root of the inverse.
/// @param sqrt_information  R of a positive definite R^T R.
[[nodiscard]] [[gnu::cold]] inline Matrix6d covariance_of(const SqrtInformation<6>& sqrt_information) {
  const Matrix6d R = sqrt_information;
  const Matrix6d root = solved_right(identity<Matrix6d>(), cholesky(transposed_product(R, R)));
  return times_transposed(root, root);
}

/// A pose moved by odometry: the covariance is carried along and grows by the odometry's.
/// @param noise  of `T_from_to`, tangent [translation; rotation], metres and radians.
[[nodiscard]] [[gnu::cold]] inline UncertainPose moved(const UncertainPose& from, const SE3d& T_from_to,
                                                       const Matrix6d& noise) {
  return {from.pose * T_from_to, sum_of(detail::carried(from.covariance, T_from_to.inverse()), noise)};
}

/// A pose after a measurement of it.
struct CorrectedPose {
  UncertainPose pose;           ///< between the prediction and the measurement
  double squared_distance = 0;  ///< Mahalanobis, of the measurement from the prediction: chi-squared, 6 degrees
};

/// Kalman update of a pose by a measurement of the whole pose: Barfoot and Furgale 2014, to the first order.
/// @throws std::invalid_argument if the covariances' sum is not positive definite.
[[nodiscard]] [[gnu::cold]] inline CorrectedPose corrected(const UncertainPose& predicted,
                                                           const UncertainPose& measured) {
  const Vector6d innovation = predicted.pose.local(measured.pose);
  // S^-1 = R^T R for the sum S of both covariances.
  const Matrix6d R =
      NoiseModel<6>::from_covariance(symmetric(sum_of(predicted.covariance, measured.covariance))).sqrt_information();
  const Vector6d whitened = product(R, innovation);
  const Matrix6d gain = product_transposed(predicted.covariance, R);
  CorrectedPose result;
  result.squared_distance = whitened.squaredNorm();
  result.pose.pose = predicted.pose.retract(product(gain, whitened));
  result.pose.covariance = symmetric(difference_of(predicted.covariance, product_transposed(gain, gain)));
  return result;
}

/// A place of the map at which the drive may be.
struct StartHypothesis {
  SessionId frame{};           ///< of the map
  KeyframeId reference{};      ///< of the map, around which the last scan that agreed was registered
  UncertainPose latest{};      ///< by the last scan that agreed: T_map_body
  SE3d T_odom_body{};          ///< of that scan
  double travelled = 0;        ///< metres of the path up to that scan
  double first = 0, last = 0;  ///< metres of the path at the first and the last scan that agreed
  Index recognitions = 0;      ///< see `StartOptions`
  Index agreeing = 0;          ///< scans
  Index refusing = 0;          ///< scans that could not be registered, or not where they have to be

  /// See `StartOptions::min_evidence`.
  [[nodiscard]] Index evidence() const { return recognitions + agreeing - 2 * refusing; }
  /// Where it puts a scan of which odometry says where it is.
  [[nodiscard]] SE3d predicted(const SE3d& T_odom_now) const {
    return latest.pose * (T_odom_body.inverse() * T_odom_now);
  }
};

/// Places at which the drive may be, and the evidence for each of them.
class StartHypotheses {
 public:
  /// @throws std::invalid_argument if an option makes no sense.
  explicit StartHypotheses(const StartOptions& options = {}) : options_(options) {
    if (options.min_evidence < 1 || options.min_recognitions < 1 || options.min_scans < 1 || options.max_count < 1 ||
        !(options.min_travel >= 0) ||
        !(options.agree_translation > 0 && options.agree_per_metre >= 0 && options.agree_rotation > 0) ||
        !(options.shift >= 0) || !(options.lead >= 1))
      throw std::invalid_argument(
          "StartOptions: counts must be at least 1, distances and angles positive, shift not negative, lead at least "
          "1");
  }

  /// Whether two poses are the same, as far as a path of so many metres between them can be relied on.
  [[nodiscard]] bool agree(const SE3d& a, const SE3d& b, double path = 0) const {
    const SE3d off = a.inverse() * b;
    return off.translation().norm() <= options_.agree_translation + options_.agree_per_metre * path &&
           off.rotation().log().norm() <= options_.agree_rotation;
  }
  /// Whether a registered pose is where a hypothesis has it.
  [[nodiscard]] bool agrees(const StartHypothesis& one, SessionId frame, const SE3d& T_map_body,
                            const SE3d& T_odom_body, double travelled) const {
    return one.frame == frame && agree(one.predicted(T_odom_body), T_map_body, std::abs(travelled - one.travelled));
  }
  /// How well a pose is known that others agree with, if nothing else says.
  [[nodiscard]] Matrix6d agreement_covariance() const {
    Matrix6d covariance = zeros<Matrix6d>();
    for (int i = 0; i < 3; ++i) {
      covariance(i, i) = 0.25 * options_.agree_translation * options_.agree_translation;
      covariance(i + 3, i + 3) = 0.25 * options_.agree_rotation * options_.agree_rotation;
    }
    return covariance;
  }

  /// A scan that a place was recognized from was registered around `reference`: counts for the hypothesis that has it
  /// there.
  /// @returns the new hypothesis, if there was none; it has one scan.
  StartHypothesis* recognized(SessionId frame, KeyframeId reference, const UncertainPose& at, const SE3d& T_odom_body,
                              double travelled) {
    for (StartHypothesis& one : all_)
      if (agrees(one, frame, at.pose, T_odom_body, travelled)) {
        ++one.recognitions;
        return nullptr;
      }
    if (static_cast<Index>(all_.size()) >= options_.max_count) all_.erase(weakest());
    all_.push_back({.frame = frame,
                    .reference = reference,
                    .latest = at,
                    .T_odom_body = T_odom_body,
                    .travelled = travelled,
                    .first = travelled,
                    .last = travelled,
                    .recognitions = 1,
                    .agreeing = 1});
    return &all_.back();
  }

  /// A scan was tried where a hypothesis has it.
  /// @param at  where it was registered, around `reference`; nothing if that was refused.
  void tried(StartHypothesis& one, KeyframeId reference, const std::optional<UncertainPose>& at,
             const SE3d& T_odom_body, double travelled) const {
    if (!at || !agrees(one, one.frame, at->pose, T_odom_body, travelled)) {
      ++one.refusing;
      return;
    }
    ++one.agreeing;
    one.first = std::min(one.first, travelled);
    one.last = std::max(one.last, travelled);
    if (travelled < one.travelled) return;  // of before
    one.latest = *at;
    one.reference = reference;
    one.T_odom_body = T_odom_body;
    one.travelled = travelled;
  }

  /// Discards those that more scans refuse than agree with.
  void prune() {
    std::erase_if(all_, [](const StartHypothesis& one) { return one.refusing > one.agreeing; });
  }

  /// The hypothesis that has all the evidence asked for, if one has.
  [[nodiscard]] const StartHypothesis* accepted() const {
    const StartHypothesis* best = nullptr;
    for (const StartHypothesis& one : all_)
      if (is_sufficient(one) && (best == nullptr || one.evidence() > best->evidence())) best = &one;
    if (best == nullptr) return nullptr;
    for (const StartHypothesis& other : all_)
      if (&other != best && other.frame == best->frame && options_.lead * other.evidence() > best->evidence())
        return nullptr;
    return best;
  }

  [[nodiscard]] std::vector<StartHypothesis>& all() { return all_; }              ///< all of them
  [[nodiscard]] const std::vector<StartHypothesis>& all() const { return all_; }  ///< all of them
  [[nodiscard]] const StartOptions& options() const { return options_; }          ///< its settings
  void clear() { all_.clear(); }                                                  ///< discards all

 private:
  [[nodiscard]] bool is_sufficient(const StartHypothesis& one) const {
    return one.evidence() >= options_.min_evidence && one.recognitions >= options_.min_recognitions &&
           one.agreeing >= options_.min_scans && one.last - one.first >= options_.min_travel;
  }
  [[nodiscard]] std::vector<StartHypothesis>::iterator weakest() {
    return std::min_element(all_.begin(), all_.end(), [](const StartHypothesis& a, const StartHypothesis& b) {
      return a.evidence() < b.evidence();
    });
  }

  StartOptions options_;
  std::vector<StartHypothesis> all_;
};

}  // namespace chainslam::detail
