#pragma once

#include <Eigen/Core>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/matching.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

/// A pose and what the matches say of it.
struct Hypothesis {
  SE3d T_target_source;  ///< maps source points into the target's frame
  Index consensus = 0;   ///< matches brought together
  double gain = 0;       ///< by how much their squared distances fall short of the largest allowed, summed, m^2
};

/// The two ends of all matches, metres, and the normals there if both sides have them.
struct MatchedPoints {
  std::vector<Eigen::Vector3d> source;          ///< metres, in the source's frame
  std::vector<Eigen::Vector3d> target;          ///< metres, in the target's frame
  std::vector<Eigen::Vector3d> source_normals;  ///< as long as the points, or empty
  std::vector<Eigen::Vector3d> target_normals;  ///< as long as the points, or empty

  [[nodiscard]] Index size() const { return static_cast<Index>(source.size()); }  ///< number of matches
  /// Whether there is a normal for each point.
  [[nodiscard]] bool has_normals() const { return !source.empty() && source_normals.size() == source.size(); }
};

/// The points that matches name; matches with a point that is not finite are passed over.
///
/// @param who  what throws.
/// @throws std::invalid_argument if a match names a point that is not there.
template <Cloud Source, NearestNeighborSearch Target>
[[nodiscard]] MatchedPoints gather_matches(const Source& source, const Target& target,
                                           std::span<const FeatureMatch> matches, const char* who) {
  const Index count = to_index(cloud_size(source), "cloud");
  const auto as_double = [](const auto& v) {
    return Eigen::Vector3d(static_cast<double>(v[0]), static_cast<double>(v[1]), static_cast<double>(v[2]));
  };
  bool normals = false;
  if constexpr (OrientedCloud<Source> && OrientedSearch<Target>) {
    normals = true;
    if constexpr (requires { source.has_normals(); }) normals = source.has_normals();
    if constexpr (requires { target.has_normals(); }) normals = normals && target.has_normals();
  }
  MatchedPoints points;
  for (const FeatureMatch& match : matches) {
    if (match.source < 0 || match.source >= count || match.target < 0)
      throw std::invalid_argument(std::string(who) + ": a match names a point that is not there");
    const Eigen::Vector3d p = position(source, static_cast<std::size_t>(match.source));
    const Eigen::Vector3d q = as_double(target.position(match.target));
    if (!is_finite(p) || !is_finite(q)) continue;
    points.source.push_back(p);
    points.target.push_back(q);
    if constexpr (OrientedCloud<Source> && OrientedSearch<Target>) {
      if (!normals) continue;
      const Eigen::Vector3d m = as_double(CloudTraits<Source>::normal(source, static_cast<std::size_t>(match.source)));
      const Eigen::Vector3d n = as_double(target.normal(match.target));
      points.source_normals.push_back(m);
      points.target_normals.push_back(n);
    }
  }
  return points;
}

/// Any rotation may be the right one.
struct AnyRotation {
  static constexpr Index least_points = 3;  ///< matches that determine a pose

  /// The rotation R for which the sum of target . (R source) is largest; S is the sum of target source'. Nothing where
  /// it is not determined (Horn 1987, see `umeyama`).
  [[nodiscard]] std::optional<SO3d> rotation(const Eigen::Matrix3d& S) const {
    constexpr double least_gap = 1e-12;
    const JacobiEigen<double, 4> eigen = jacobi_eigen(detail::horn_matrix(S));
    if (!(eigen.values[3] - eigen.values[2] > least_gap * eigen.values[3])) return std::nullopt;
    const Eigen::Vector4d q = block_of<4, 1>(eigen.vectors, 0, 3);
    return SO3d::from_quaternion(SO3d::Quaternion(q[3], q[0], q[1], q[2]));
  }
};

/// Both frames stand upright, z against gravity, as observed by an IMU: only the heading is unknown.
struct YawOnly {
  static constexpr Index least_points = 2;  ///< matches that determine a pose

  /// The rotation about z that fits best; nothing if none does.
  [[nodiscard]] std::optional<SO3d> rotation(const Eigen::Matrix3d& S) const {
    const double sine = S(1, 0) - S(0, 1), cosine = S(0, 0) + S(1, 1);
    const double length = std::hypot(sine, cosine);
    if (!(length > 0) || !is_finite(length)) return std::nullopt;
    return SO3d::exp(Eigen::Vector3d(0, 0, std::atan2(sine, cosine)));
  }
};

/// Says which rotations may be the right one, and finds the best of them: `rotation(S)`, as in `AnyRotation`.
template <class R>
concept RotationModel = requires(const R& model, const Eigen::Matrix3d& S) {
  { model.rotation(S) } -> std::same_as<std::optional<SO3d>>;
  { R::least_points } -> std::convertible_to<Index>;
};
static_assert(RotationModel<AnyRotation> && RotationModel<YawOnly>);

/// The rigid motion T_target_source for which the weighted sum of |target_i - T source_i|^2 is least; nothing where it
/// is not determined.
///
/// @param weights  one for each pair, not negative.
template <RotationModel Rotation = AnyRotation>
[[nodiscard]] std::optional<SE3d> fit_motion(std::span<const Eigen::Vector3d> source,
                                             std::span<const Eigen::Vector3d> target, std::span<const double> weights,
                                             const Rotation& model = {}) {
  double total = 0;
  Eigen::Vector3d source_mean = Eigen::Vector3d::Zero(), target_mean = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < weights.size(); ++i) {
    total += weights[i];
    source_mean += weights[i] * source[i];
    target_mean += weights[i] * target[i];
  }
  if (!(total > 0)) return std::nullopt;
  source_mean = scaled(1.0 / total, source_mean);
  target_mean = scaled(1.0 / total, target_mean);
  Eigen::Matrix3d S = zeros<Eigen::Matrix3d>();
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const Eigen::Vector3d p = source[i] - source_mean, q = target[i] - target_mean;
    S = sum_of(S, scaled(weights[i], product_transposed(q, p)));
  }
  const std::optional<SO3d> rotation = model.rotation(S);
  if (!rotation) return std::nullopt;
  const Eigen::Vector3d turned_mean = *rotation * source_mean;
  return SE3d(*rotation, target_mean - turned_mean);
}

}  // namespace chainslam
