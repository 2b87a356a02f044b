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

/// A variable measured by itself: residual log(mean^-1 x), whitened.
template <LieGroup Group, RobustCost Kernel = Trivial>
struct PriorFactor {
  using Value = Group;                                           ///< type of the variables
  static constexpr std::size_t arity = 1;                        ///< number of variables
  static constexpr int rows = Group::dof;                        ///< rows of the residual
  using Residual = Eigen::Matrix<double, rows, 1>;               ///< whitened residual
  using Linearized = LinearizedFactor<rows, Group::dof, arity>;  ///< what `linearize` returns

  Key key = 0;  ///< the variable
  Group mean;   ///< as measured
  /// R of the whitened residual R r.
  SqrtInformation<Group::dof> sqrt_information = identity<SqrtInformation<Group::dof>>();
  [[no_unique_address]] Kernel kernel{};  ///< robust kernel of the squared whitened residual

  /// Keys of the variables, in the order of the Jacobians.
  [[nodiscard]] std::array<Key, arity> keys() const { return {key}; }

  /// The whitened residual; see `Factor`.
  [[nodiscard]] Residual residual(const Values<Group>& values) const {
    return whitened<rows, 1>(sqrt_information, (mean.inverse() * values[key]).log());
  }

  /// The whitened residual and its Jacobians; see `Factor`.
  [[nodiscard]] Linearized linearize(const Values<Group>& values) const {
    const typename Group::Tangent error = (mean.inverse() * values[key]).log();
    Linearized result;
    result.residual = whitened<rows, 1>(sqrt_information, error);
    result.jacobians[0] = whitened<rows, rows>(sqrt_information, Group::right_jacobian_inverse(error));
    return result;
  }

  /// Calls visit(members...), to save or to load them.
  template <class Self, class Visit>
  static void visit_members(Self& self, Visit&& visit) {
    visit(self.key, self.mean, self.sqrt_information, self.kernel);
  }
};
static_assert(RobustFactor<PriorFactor<SE3d>>);

}  // namespace chainslam
