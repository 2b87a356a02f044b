#pragma once

#include <array>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// A measured T_from_to between variables of two sessions, each in a frame of its own whose place in the map is a
/// variable, too (Kim et al. 2010, "Multiple relative pose graphs for robust cooperative mapping"): residual
/// log(measurement^-1 (anchor_from x_from)^-1 anchor_to x_to), whitened.
///
/// A session is carried over by its anchor alone: its own variables and what is between them stay as they are.
template <LieGroup Group, RobustCost Kernel = Trivial>
struct AnchoredBetweenFactor {
  using Value = Group;                                           ///< type of the variables
  static constexpr std::size_t arity = 4;                        ///< number of variables
  static constexpr int rows = Group::dof;                        ///< rows of the residual
  using Residual = Eigen::Matrix<double, rows, 1>;               ///< whitened residual
  using Linearized = LinearizedFactor<rows, Group::dof, arity>;  ///< what `linearize` returns

  Key anchor_from = 0;  ///< T_map_session of `from`
  Key from = 0;         ///< the variable at the start
  Key anchor_to = 0;    ///< T_map_session of `to`; another one
  Key to = 0;           ///< the variable at the end
  Group measurement;    ///< T_from_to
  /// R of the whitened residual R r.
  SqrtInformation<Group::dof> sqrt_information = identity<SqrtInformation<Group::dof>>();
  [[no_unique_address]] Kernel kernel{};  ///< robust kernel of the squared whitened residual

  /// Keys of the variables, in the order of the Jacobians.
  [[nodiscard]] std::array<Key, arity> keys() const { return {anchor_from, from, anchor_to, to}; }

  /// The whitened residual; see `Factor`.
  [[nodiscard]] Residual residual(const Values<Group>& values) const {
    return sqrt_information * (measurement.inverse() * relative(values)).log();
  }

  /// As for `BetweenFactor`; a exp(d) x is a x exp(Ad(x^-1) d).
  [[nodiscard]] Linearized linearize(const Values<Group>& values) const {
    const Group T_from_to = relative(values);
    const typename Group::Tangent error = (measurement.inverse() * T_from_to).log();
    Linearized result;
    result.residual = sqrt_information * error;
    result.jacobians[3] = sqrt_information * Group::right_jacobian_inverse(error);
    result.jacobians[1] = -result.jacobians[3] * T_from_to.inverse().adjoint();
    result.jacobians[0] = result.jacobians[1] * values[from].inverse().adjoint();
    result.jacobians[2] = result.jacobians[3] * values[to].inverse().adjoint();
    return result;
  }

  /// Calls visit(members...), to save or to load them.
  template <class Self, class Visit>
  static void visit_members(Self& self, Visit&& visit) {
    visit(self.anchor_from, self.from, self.anchor_to, self.to, self.measurement, self.sqrt_information, self.kernel);
  }

 private:
  [[nodiscard]] Group relative(const Values<Group>& values) const {
    return (values[anchor_from] * values[from]).inverse() * (values[anchor_to] * values[to]);
  }
};
static_assert(RobustFactor<AnchoredBetweenFactor<SE3d>>);

}  // namespace chainslam
