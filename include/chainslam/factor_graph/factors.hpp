#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/jacobians.hpp"
#include "chainslam/lie/s2.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// How far a factor's Jacobians are from differences of its residual, relative to them where they are large: below 1e-8
/// where both are right, and of the order of 1 where a term is missing. For tests of one's own factors.
template <Factor F>
[[nodiscard]] double jacobian_error(const F& factor, const Values<typename F::Value>& values) {
  using Group = typename F::Value;
  const auto linearized = factor.linearize(values);
  double worst = (linearized.residual - factor.residual(values)).norm();
  const auto keys = factor.keys();
  for (std::size_t k = 0; k < F::arity; ++k) {
    const auto expected = numeric_jacobian(
        [&](const Group& moved) {
          Values<Group> others = values;
          others[keys[k]] = moved;
          return Eigen::Matrix<double, F::rows, 1>(factor.residual(others));
        },
        values[keys[k]]);
    worst = std::max(worst, (linearized.jacobians[k] - expected).norm() / (1.0 + expected.norm()));
  }
  return worst;
}

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

/// Gravity direction measured in the body frame: residual R_map_body^T up_map - up_body over `sigma`.
///
/// Its length is that of the chord, 2 sin(angle / 2): the angle where that is small, and largest where the body stands
/// on its head. Nothing is said of position and heading.
template <RobustCost Kernel = Trivial>
struct GravityFactor {
  using Value = SE3d;                                           ///< type of the variables
  static constexpr std::size_t arity = 1;                       ///< number of variables
  static constexpr int rows = 3;                                ///< rows of the residual
  using Residual = Eigen::Vector3d;                             ///< whitened residual
  using Linearized = LinearizedFactor<rows, SE3d::dof, arity>;  ///< what `linearize` returns

  Key key = 0;           ///< the variable
  S2<double> up_body{};  ///< as measured: along the mean specific force of a body at rest, which points up
  double sigma = 1.0;    ///< radians
  S2<double> up_map{};   ///< up in the map's frame
  [[no_unique_address]] Kernel kernel{};  ///< robust kernel of the squared whitened residual

  /// Keys of the variables, in the order of the Jacobians.
  [[nodiscard]] std::array<Key, arity> keys() const { return {key}; }

  /// The whitened residual; see `Factor`.
  [[nodiscard]] Residual residual(const Values<SE3d>& values) const {
    return (seen(values) - up_body.direction()) / sigma;
  }

  /// d (R exp(w))^T u = hat(R^T u) w.
  [[nodiscard]] Linearized linearize(const Values<SE3d>& values) const {
    Linearized result;
    result.residual = residual(values);
    result.jacobians[0].leftCols<3>().setZero();
    result.jacobians[0].rightCols<3>() = SO3d::hat(seen(values)) / sigma;
    return result;
  }

  /// Calls visit(members...), to save or to load them.
  template <class Self, class Visit>
  static void visit_members(Self& self, Visit&& visit) {
    visit(self.key, self.up_body, self.sigma, self.up_map, self.kernel);
  }

 private:
  [[nodiscard]] Eigen::Vector3d seen(const Values<SE3d>& values) const {
    return values[key].rotation().inverse() * up_map.direction();
  }
};
static_assert(RobustFactor<GravityFactor<>> && RobustFactor<GravityFactor<Huber>>);

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
