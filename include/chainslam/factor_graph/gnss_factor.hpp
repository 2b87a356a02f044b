#pragma once

#include <Eigen/Core>
#include <array>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// A measured position of the GNSS antenna: residual T_map_body p_body_antenna - p_map_antenna, whitened.
///
/// It says nothing of the rotation about the antenna: other factors have to.
template <RobustCost Kernel = Trivial>
struct GnssFactor {
  using Value = SE3d;                                           ///< type of the variables
  static constexpr std::size_t arity = 1;                       ///< number of variables
  static constexpr int rows = 3;                                ///< rows of the residual
  using Residual = Eigen::Vector3d;                             ///< whitened residual
  using Linearized = LinearizedFactor<rows, SE3d::dof, arity>;  ///< what `linearize` returns

  Key key = 0;                                                           ///< the variable
  Eigen::Vector3d position = Eigen::Vector3d::Zero();                    ///< p_map_antenna, metres
  Eigen::Vector3d lever_arm = Eigen::Vector3d::Zero();                   ///< p_body_antenna, metres
  SqrtInformation<3> sqrt_information = identity<SqrtInformation<3>>();  ///< R of the whitened residual R r
  [[no_unique_address]] Kernel kernel{};  ///< robust kernel of the squared whitened residual

  /// Keys of the variables, in the order of the Jacobians.
  [[nodiscard]] std::array<Key, arity> keys() const { return {key}; }

  /// The whitened residual; see `Factor`.
  [[nodiscard]] Residual residual(const Values<SE3d>& values) const {
    return sqrt_information * (values[key] * lever_arm - position);
  }

  /// d (T exp(xi) p) = R (v + w x p) with xi = [v; w].
  [[nodiscard]] Linearized linearize(const Values<SE3d>& values) const {
    const Eigen::Matrix3d rotation = values[key].rotation().matrix();
    Linearized result;
    result.residual = residual(values);
    result.jacobians[0].leftCols<3>().noalias() = sqrt_information * rotation;
    result.jacobians[0].rightCols<3>().noalias() = -result.jacobians[0].leftCols<3>() * SO3d::hat(lever_arm);
    return result;
  }

  /// Calls visit(members...), to save or to load them.
  template <class Self, class Visit>
  static void visit_members(Self& self, Visit&& visit) {
    visit(self.key, self.position, self.lever_arm, self.sqrt_information, self.kernel);
  }
};
static_assert(RobustFactor<GnssFactor<>> && RobustFactor<GnssFactor<Huber>>);

}  // namespace chainslam
