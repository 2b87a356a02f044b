#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// What is known of some variables together, linear about points that stay: residual
/// offset + sum of sqrt_information_k log(point_k^-1 x_k). Marginalization leaves such factors.
template <LieGroup Group>
struct LinearPrior {
  using Value = Group;                                       ///< type of the variables
  static constexpr std::size_t arity = std::dynamic_extent;  ///< number of variables
  static constexpr int rows = Eigen::Dynamic;                ///< rows of the residual
  static constexpr bool holds_in_place = true;               ///< whether its neighbours need nothing else to hold them
  using Linearized = LinearizedFactor<rows, Group::dof, arity>;  ///< what `linearize` returns

  std::vector<Key> variables;        ///< their keys, as in `points` and the columns
  std::vector<Group> points;         ///< of each variable
  Eigen::MatrixXd sqrt_information;  ///< `Group::dof` columns for each variable
  Eigen::VectorXd offset;            ///< the residual at `points`

  /// Keys of the variables, in the order of the Jacobians.
  [[nodiscard]] const std::vector<Key>& keys() const { return variables; }

  /// The whitened residual; see `Factor`.
  [[nodiscard]] Eigen::VectorXd residual(const Values<Group>& values) const {
    Eigen::VectorXd result = offset;
    for (std::size_t k = 0; k < variables.size(); ++k) add_step(k, points[k].local(values[variables[k]]), result);
    return result;
  }

  /// The whitened residual and its Jacobians; see `Factor`.
  [[nodiscard]] Linearized linearize(const Values<Group>& values) const {
    Linearized result{offset, {}};
    for (std::size_t k = 0; k < variables.size(); ++k) {
      const typename Group::Tangent step = points[k].local(values[variables[k]]);
      add_step(k, step, result.residual);
      result.jacobians.push_back(turned_block(k, Group::right_jacobian_inverse(step)));
    }
    return result;
  }

  /// Calls visit(members...), to save or to load them.
  template <class Self, class Visit>
  static void visit_members(Self& self, Visit&& visit) {
    visit(self.variables, self.points, self.sqrt_information, self.offset);
  }

 private:
  /// Of a variable, column-major.
  [[nodiscard]] const double* block(std::size_t k) const {
    return sqrt_information.data() + static_cast<Eigen::Index>(k) * Group::dof * offset.size();
  }
  void add_step(std::size_t k, const typename Group::Tangent& step, Eigen::VectorXd& sum) const {
    const double* from = block(k);
    for (int column = 0; column < Group::dof; ++column) {
      for (Eigen::Index row = 0; row < offset.size(); ++row) sum.data()[row] += *from++ * step[column];
    }
  }
  /// A variable's block times a matrix.
  [[nodiscard]] Eigen::Matrix<double, rows, Group::dof> turned_block(std::size_t k,
                                                                     const typename Group::Jacobian& turn) const {
    Eigen::Matrix<double, rows, Group::dof> turned(offset.size(), Group::dof);
    double* to = turned.data();
    for (int column = 0; column < Group::dof; ++column) {
      for (Eigen::Index row = 0; row < offset.size(); ++row, ++to) {
        *to = 0.0;
        for (int inner = 0; inner < Group::dof; ++inner)
          *to += block(k)[inner * offset.size() + row] * turn(inner, column);
      }
    }
    return turned;
  }
};
static_assert(Factor<LinearPrior<SE3d>>);

}  // namespace chainslam
