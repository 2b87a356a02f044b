#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "chainslam/core/finite.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/map/frame.hpp"

namespace chainslam {

/// The covariance of a pose: its upper triangle, row by row, rounded to floats. One that is not finite, or not as
/// floats, becomes that of a pose of which nothing is known.
class PackedCovariance {
 public:
  static constexpr std::size_t entries = 21;  ///< numbers in an upper triangle

  PackedCovariance() = default;
  /// From its upper triangle, row by row.
  explicit PackedCovariance(const std::array<float, entries>& upper) : upper_(upper) {}
  /// Rounds the upper triangle to float.
  explicit PackedCovariance(const Matrix6d& covariance) {
    constexpr double unknown = 1e30;  // m^2 and rad^2
    bool known = true;
    for (int k = 0; k < 36; ++k) known &= is_finite(covariance.data()[k]) && std::abs(covariance.data()[k]) <= unknown;
    std::size_t k = 0;
    for (int i = 0; i < 6; ++i)
      for (int j = i; j < 6; ++j) upper_[k++] = static_cast<float>(known ? covariance(i, j) : i == j ? unknown : 0.0);
  }

  /// The symmetric matrix.
  [[nodiscard]] Matrix6d matrix() const {
    Matrix6d covariance;
    std::size_t k = 0;
    for (int i = 0; i < 6; ++i)
      for (int j = i; j < 6; ++j) covariance(i, j) = covariance(j, i) = static_cast<double>(upper_[k++]);
    return covariance;
  }
  [[nodiscard]] const std::array<float, entries>& upper() const { return upper_; }  ///< the upper triangle, row by row
  /// Whether all members are equal.
  friend bool operator==(const PackedCovariance&, const PackedCovariance&) = default;

 private:
  std::array<float, entries> upper_{};
};

/// What a map keeps of each frame of odometry, also of those that are no keyframes: where it was, and how well that is
/// known.
struct FrameRecord {
  SessionId session{};            ///< the session of the frame
  Timestamp time{};               ///< of the pose
  SE3d T_odom_body{};             ///< as odometry gave it
  PackedCovariance covariance{};  ///< of T_odom_body, tangent [translation; rotation], metres and radians
  FrameHealth health{};           ///< as odometry gave it
};

/// @returns the record of a frame; its session is given by the map that takes it.
[[nodiscard]] inline FrameRecord record_of(const Frame& frame) {
  return {{}, frame.time, frame.T_odom_body, PackedCovariance(frame.covariance), frame.health};
}

}  // namespace chainslam
