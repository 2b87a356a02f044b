#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <stdexcept>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// How a `VoxelMap` downsamples its input, and how far it looks.
struct VoxelMapOptions {
  double voxel_size = 1.0;          ///< edge, metres
  Index max_points_per_voxel = 20;  ///< further points of a full voxel are not taken
  double min_spacing = 0.1;         ///< metres; a point nearer than this to one in the map is not taken; 0 takes all
  Index reach = 1;                  ///< blocks of 4 voxels searched on each side, 1 to 8: sets `max_search_radius()`
};

/// What becomes of a point whose voxel already holds points.
enum class VoxelVerdict {
  refuse,  ///< it is left out
  add,     ///< it is kept beside the others
  meet,    ///< it and the voxel's one point decide: see `meet` of the policy
};

/// How a map that grows downsamples its input: a rule for each cubic voxel, whose membership is decided by whole
/// numbers computed in double, as in `VoxelGrid`, so that it is exact 500 km from the origin.
///
/// A policy remembers a small number for each voxel that holds points, its state, of `state_bits` bits (0, 4, 8 or 16);
/// offsets are squared distances from the voxel's centre, in voxel sizes.
/// - `first_state(offset)`: the state of a voxel whose first point this is.
/// - `judge(state, offset)`: what becomes of a further point; may change the state.
/// - `forget(state)`: a point was erased; whether the voxel holds others. May change the state.
/// - `state_beyond_points`, if there: the state is not determined by the points, and is saved with them.
/// A policy that answers `meet` keeps one point a voxel and has
/// - `meet(state, held, held_offset, offered, offset)`: whether the voxel's point changes; if so `held` is what it
///   becomes. The state is adapted.
template <class P>
concept VoxelPolicy = requires(const P& policy, unsigned& state, double offset) {
  { policy.voxel_size } -> std::convertible_to<double>;
  { P::state_bits } -> std::convertible_to<int>;
  { policy.first_state(offset) } -> std::same_as<unsigned>;
  { policy.judge(state, offset) } -> std::same_as<VoxelVerdict>;
  { policy.forget(state) } -> std::same_as<bool>;
};

/// Every point is kept.
struct KeepAll {};

/// The first point of a voxel is kept; the cheapest rule.
struct FirstInVoxel {
  double voxel_size = 0.5;  ///< edge, metres

  static constexpr int state_bits = 0;                            ///< bits of a voxel's state
  [[nodiscard]] unsigned first_state(double) const { return 0; }  ///< see `VoxelPolicy`
  [[nodiscard]] VoxelVerdict judge(unsigned&, double) const { return VoxelVerdict::refuse; }  ///< see `VoxelPolicy`
  [[nodiscard]] bool forget(unsigned&) const { return false; }                                ///< see `VoxelPolicy`
};
static_assert(VoxelPolicy<FirstInVoxel>);

/// The point nearest the voxel's centre is kept, the first of equals (FAST-LIO2, section V-C). The state is a step on a
/// scale of distances, which settles most offers without a look at the point.
struct NearestToCenter {
  double voxel_size = 0.5;  ///< edge, metres

  static constexpr int state_bits = 8;                                              ///< bits of a voxel's state
  [[nodiscard]] unsigned first_state(double offset) const { return step(offset); }  ///< see `VoxelPolicy`
  /// See `VoxelPolicy`.
  [[nodiscard]] VoxelVerdict judge(unsigned& state, double offset) const {
    return step(offset) > state ? VoxelVerdict::refuse : VoxelVerdict::meet;
  }
  [[nodiscard]] bool forget(unsigned&) const { return false; }  ///< see `VoxelPolicy`
  /// See `VoxelPolicy`.
  template <class Vector>
  [[nodiscard]] bool meet(unsigned& state, Vector& held, double held_offset, const Vector& offered,
                          double offset) const {
    if (!(offset < held_offset)) return false;
    state = step(offset);
    held = offered;
    return true;
  }

 private:
  /// So many equal steps of distance, up to half a diagonal, that hardly an offer meets a point which it does not move.
  [[nodiscard]] static unsigned step(double offset) {
    constexpr float steps = 256 / 0.8660254f;
    return std::min(255U, static_cast<unsigned>(steps * std::sqrt(static_cast<float>(offset))));
  }
};
static_assert(VoxelPolicy<NearestToCenter>);

/// One point a voxel: the mean of all that it was offered, rounded to the map's scalar after each. The first 65 535
/// count alike, each later one as if it were the 65 535th.
struct MeanOfVoxel {
  double voxel_size = 0.5;  ///< edge, metres

  static constexpr int state_bits = 16;                           ///< bits of a voxel's state
  static constexpr bool state_beyond_points = true;               ///< the state is saved with the points
  [[nodiscard]] unsigned first_state(double) const { return 1; }  ///< see `VoxelPolicy`
  [[nodiscard]] VoxelVerdict judge(unsigned&, double) const { return VoxelVerdict::meet; }  ///< see `VoxelPolicy`
  [[nodiscard]] bool forget(unsigned&) const { return false; }                              ///< see `VoxelPolicy`
  /// See `VoxelPolicy`.
  template <class Vector>
  [[nodiscard]] bool meet(unsigned& state, Vector& held, double, const Vector& offered, double) const {
    constexpr unsigned most = 65535;
    state = std::min(state + 1, most);
    const Eigen::Matrix<double, Vector::RowsAtCompileTime, 1> old = held.template cast<double>();
    const Eigen::Matrix<double, Vector::RowsAtCompileTime, 1> step = offered.template cast<double>() - old;
    held = (old + step / static_cast<double>(state)).template cast<typename Vector::Scalar>();
    return true;
  }
};
static_assert(VoxelPolicy<MeanOfVoxel>);

/// The first `count` points of a voxel are kept.
struct AtMost {
  double voxel_size = 0.5;  ///< edge, metres
  Index count = 20;         ///< 1 to 255

  static constexpr int state_bits = 8;                            ///< bits of a voxel's state
  [[nodiscard]] unsigned first_state(double) const { return 1; }  ///< see `VoxelPolicy`
  /// See `VoxelPolicy`.
  [[nodiscard]] VoxelVerdict judge(unsigned& state, double) const {
    if (state >= static_cast<unsigned>(count)) return VoxelVerdict::refuse;
    ++state;
    return VoxelVerdict::add;
  }
  [[nodiscard]] bool forget(unsigned& state) const { return --state > 0; }  ///< see `VoxelPolicy`
};
static_assert(VoxelPolicy<AtMost>);

template <class P>
concept DownsamplingPolicy = std::same_as<P, KeepAll> || VoxelPolicy<P>;

/// @throws std::invalid_argument unless the voxel's size is positive and finite and counts are in range.
template <DownsamplingPolicy Policy>
void require_valid(const Policy& policy) {
  if constexpr (VoxelPolicy<Policy>)
    if (!(policy.voxel_size > 0) || !is_finite(policy.voxel_size) || !is_finite(1.0 / policy.voxel_size))
      throw std::invalid_argument("downsampling: voxel_size must be positive and finite");
  if constexpr (std::same_as<Policy, AtMost>)
    if (policy.count < 1 || policy.count > 255) throw std::invalid_argument("downsampling: count must be 1 to 255");
}

}  // namespace chainslam
