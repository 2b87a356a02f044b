#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/box_node.hpp"
#include "chainslam/search/detail/region_lanes.hpp"
#include "chainslam/search/detail/regions.hpp"
#include "chainslam/search/detail/voxel_place.hpp"
#include "chainslam/search/detail/voxel_states.hpp"
#include "chainslam/search/downsampling.hpp"

namespace chainslam::detail {

/// What a tree asks before it takes a point, for policies that thin: knows which voxels hold points.
template <class Scalar, int Dim, class Policy>
class Thinning {
 public:
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  static constexpr bool thins = true;
  static constexpr bool saves_states = requires { Policy::state_beyond_points; };

  using Where = VoxelPlace;
  /// Where a point belongs, and the bucket of its block.
  struct Ahead {
    Where at;
    std::size_t bucket;
  };

  explicit Thinning(const Policy& policy)
      : policy_(policy), inverse_voxel_(1.0 / policy.voxel_size), voxels_(policy.voxel_size) {
    require_valid(policy);
  }

  [[nodiscard]] const Policy& policy() const { return policy_; }
  [[nodiscard]] double voxel_size() const { return policy_.voxel_size; }
  [[nodiscard]] std::size_t memory() const { return voxels_.memory(); }
  [[nodiscard]] std::size_t swept() const { return voxels_.swept(); }
  void reset_swept() { voxels_.reset_swept(); }

  [[nodiscard]] Where where(const Vector& p) const { return voxel_place(p, inverse_voxel_); }
  /// Likewise; and asks the memory for what `offer` will read, which `fetch` goes on with.
  [[nodiscard]] Ahead where_ahead(const Vector& p) const {
    const Where at = where(p);
    return {at, at.there() ? voxels_.fetch_bucket(at.cell) : 0};
  }
  void fetch(const Ahead& ahead) const {
    if (ahead.at.there()) voxels_.fetch_block(ahead.bucket);
  }

  /// What becomes of a point. If it is added, its voxel is marked.
  [[nodiscard]] VoxelVerdict offer(const Where& at) {
    voxels_.sweep();
    const auto place = voxels_.find_or_add(at.cell);
    if (!voxels_.occupied(place)) {
      voxels_.occupy(place, policy_.first_state(at.offset));
      return VoxelVerdict::add;
    }
    unsigned state = voxels_.state(place);
    const VoxelVerdict verdict = policy_.judge(state, at.offset);
    if (verdict == VoxelVerdict::add) voxels_.set_state(place, state);
    return verdict;
  }

  /// Lets the point of a voxel meet one that is offered. Returns whether `held` has changed.
  [[nodiscard]] bool meet(const Where& at, Vector& held, const Vector& offered) {
    if constexpr (requires(Vector & p, unsigned& state) { policy_.meet(state, p, 0.0, offered, 0.0); }) {
      const auto place = voxels_.find_again(at.cell);
      unsigned state = voxels_.state(place);
      Vector result = held;
      const bool changed = policy_.meet(state, result, where(held).offset, offered, at.offset);
      voxels_.set_state(place, state);
      if (!changed || !in_voxel(result, at)) return false;  // a mean may be rounded out of its voxel
      held = result;
      return true;
    } else {
      return false;
    }
  }

  [[nodiscard]] bool in_voxel(const Vector& p, const Where& at) const {
    const Where other = where(p);
    return other.there() && other.cell == at.cell;
  }
  /// A box that holds all points of a voxel.
  [[nodiscard]] Bounds<Scalar, Dim> box_of(const Where& at) const {
    const std::array<double, 3> corner{1.0 * at.cell.x, 1.0 * at.cell.y, 1.0 * at.cell.z};
    Bounds<Scalar, Dim> box;
    for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
      const double slack = 4.0 * std::numeric_limits<Scalar>::epsilon() * (std::abs(corner[axis]) + 1);
      box.low[axis] = static_cast<Scalar>((corner[axis] - slack) * policy_.voxel_size);
      box.high[axis] = static_cast<Scalar>((corner[axis] + 1 + slack) * policy_.voxel_size);
    }
    return box;
  }

  /// A point has been erased.
  void forget(const Vector& p) {
    const auto place = voxels_.find_again(where(p).cell);
    unsigned state = voxels_.state(place);
    if (policy_.forget(state))
      voxels_.set_state(place, state);
    else
      voxels_.vacate(place);
  }
  /// How far from a point its voxel may reach along an axis.
  [[nodiscard]] double reach() const { return 1.001 * policy_.voxel_size; }
  /// All points of a region have been erased; nothing was said of some in a box whose voxels lie in the region.
  template <class Region>
  void forget_inside(const Region& region, const Bounds<Scalar, Dim>& box) {
    if constexpr (requires { widened(region); }) voxels_.vacate_inside(widened(region), wide_box(box));
  }

  /// What is saved with a point beside itself.
  [[nodiscard]] unsigned state_of(const Vector& p) const { return voxels_.state(voxels_.find(where(p).cell)); }
  /// Marks the voxel of a point that is loaded. Returns false if the policy would not have kept it.
  [[nodiscard]] bool restore(const Vector& p, unsigned saved) {
    const Where at = where(p);
    if (!at.there() || (saves_states && saved == 0) || offer(at) != VoxelVerdict::add) return false;
    if constexpr (saves_states) voxels_.set_state(voxels_.find_again(at.cell), saved);
    return true;
  }

 private:
  Policy policy_;
  double inverse_voxel_;
  VoxelStates<Dim, Policy::state_bits> voxels_;
};

/// Takes every finite point.
template <class Scalar, int Dim>
class Thinning<Scalar, Dim, KeepAll> {
 public:
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  static constexpr bool thins = false;
  static constexpr bool saves_states = false;
  struct Where {
    bool finite;
    [[nodiscard]] bool there() const { return finite; }
  };
  struct Ahead {
    Where at;
  };

  explicit Thinning(const KeepAll&) {}

  [[nodiscard]] const KeepAll& policy() const { return policy_; }
  [[nodiscard]] double voxel_size() const { return 0; }
  [[nodiscard]] std::size_t memory() const { return 0; }
  [[nodiscard]] std::size_t swept() const { return 0; }
  void reset_swept() {}
  [[nodiscard]] Where where(const Vector& p) const { return {is_finite(p)}; }
  [[nodiscard]] Ahead where_ahead(const Vector& p) const { return {where(p)}; }
  void fetch(const Ahead&) const {}
  [[nodiscard]] VoxelVerdict offer(const Where&) const { return VoxelVerdict::add; }
  void forget(const Vector&) const {}
  [[nodiscard]] double reach() const { return 0; }
  template <class Region>
  void forget_inside(const Region&, const Bounds<Scalar, Dim>&) const {}
  [[nodiscard]] unsigned state_of(const Vector&) const { return 0; }
  [[nodiscard]] bool restore(const Vector& p, unsigned) const { return is_finite(p); }

 private:
  [[no_unique_address]] KeepAll policy_;
};

}  // namespace chainslam::detail
