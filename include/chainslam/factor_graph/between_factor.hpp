#pragma once

#include <array>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

namespace detail {

/// Of a `BetweenFactor`, whatever its kernel: compiled once for all of them.
template <LieGroup Group>
[[nodiscard]] [[gnu::noinline]] typename Group::Tangent between_residual(
    const Group& measurement, const SqrtInformation<Group::dof>& sqrt_information, const Group& from, const Group& to) {
  return whitened<Group::dof, 1>(sqrt_information, (measurement.inverse() * (from.inverse() * to)).log());
}
template <LieGroup Group>
[[nodiscard]] [[gnu::noinline]] LinearizedFactor<Group::dof, Group::dof, 2> linearized_between(
    const Group& measurement, const SqrtInformation<Group::dof>& sqrt_information, const Group& from, const Group& to) {
  constexpr int rows = Group::dof;
  const Group T_from_to = from.inverse() * to;
  const typename Group::Tangent error = (measurement.inverse() * T_from_to).log();
  LinearizedFactor<rows, rows, 2> result;
  result.residual = whitened<rows, 1>(sqrt_information, error);
  result.jacobians[1] = whitened<rows, rows>(sqrt_information, Group::right_jacobian_inverse(error));
  const typename Group::Jacobian forth = product(result.jacobians[1], T_from_to.inverse().adjoint());
  for (int k = 0; k < rows * rows; ++k) result.jacobians[0].data()[k] = -forth.data()[k];
  return result;
}

}  // namespace detail

/// A measured T_from_to = x_from^-1 x_to: residual log(measurement^-1 x_from^-1 x_to), whitened.
///
/// Jacobians are exact, the logarithm's included: with r the residual before whitening, J_to = Jr^-1(r) and
/// J_from = -Jr^-1(r) Ad(x_to^-1 x_from) (Sola et al. 2018, eq. 79 and 82).
template <LieGroup Group, RobustCost Kernel = Trivial>
struct BetweenFactor {
  using Value = Group;                              ///< type of the variables
  static constexpr std::size_t arity = 2;           ///< number of variables
  static constexpr int rows = Group::dof;           ///< rows of the residual
  static constexpr bool left_invariant = true;      ///< a motion of both variables from the left changes nothing
  using Residual = Eigen::Matrix<double, rows, 1>;  ///< whitened residual
  using Linearized = LinearizedFactor<rows, Group::dof, arity>;  ///< what `linearize` returns

  Key from = 0;       ///< the variable at the start
  Key to = 0;         ///< the variable at the end
  Group measurement;  ///< T_from_to
  /// R of the whitened residual R r.
  SqrtInformation<Group::dof> sqrt_information = identity<SqrtInformation<Group::dof>>();
  [[no_unique_address]] Kernel kernel{};  ///< robust kernel of the squared whitened residual

  /// Keys of the variables, in the order of the Jacobians.
  [[nodiscard]] std::array<Key, arity> keys() const { return {from, to}; }

  /// The whitened residual; see `Factor`.
  [[nodiscard]] Residual residual(const Values<Group>& values) const {
    return detail::between_residual(measurement, sqrt_information, values[from], values[to]);
  }

  /// The whitened residual and its Jacobians; see `Factor`.
  [[nodiscard]] Linearized linearize(const Values<Group>& values) const {
    return detail::linearized_between(measurement, sqrt_information, values[from], values[to]);
  }

  /// Calls visit(members...), to save or to load them.
  template <class Self, class Visit>
  static void visit_members(Self& self, Visit&& visit) {
    visit(self.from, self.to, self.measurement, self.sqrt_information, self.kernel);
  }
};
static_assert(RobustFactor<BetweenFactor<SE3d>>);

}  // namespace chainslam
