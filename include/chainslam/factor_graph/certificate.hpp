#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/chordal_initialization.hpp"
#include "chainslam/factor_graph/detail/held_components.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/sparse/cholesky.hpp"

namespace chainslam {

/// What is known of a pose graph's global optimum.
struct Certificate {
  double cost = 0.0;         ///< of the graph's values
  double lower_bound = 0.0;  ///< no values whatsoever cost less, up to rounding

  [[nodiscard]] double gap() const { return cost - lower_bound; }  ///< how far the cost may be above the global optimum
};

namespace detail {

/// A relative pose with isotropic noise and chordal distances, which costs no more than the between factor it stands
/// for: kappa |R_to - R_from R|^2 + tau |t_to - t_from - R_from t|^2.
///
/// |R - I|^2 = 8 sin^2(angle / 2) <= 2 angle^2, and the logarithm's translation is no shorter than the plain one.
template <class Group>
struct ChordalFactor {
  using Value = Group;
  static constexpr int dimension = Group::dof == 6 ? 3 : 2;
  static constexpr std::size_t arity = 2;
  static constexpr int rows = dimension * (dimension + 1);
  using Matrix = Eigen::Matrix<double, dimension, dimension>;
  using Vector = Eigen::Matrix<double, dimension, 1>;
  using Residual = Eigen::Matrix<double, rows, 1>;
  using Linearized = LinearizedFactor<rows, Group::dof, arity>;

  Key from, to;
  Group measurement;
  double kappa, tau;

  [[nodiscard]] std::array<Key, arity> keys() const { return {from, to}; }

  /// Columns of the rotation, then the translation.
  [[nodiscard]] static Residual stacked(const Matrix& rotation, const Vector& translation) {
    Residual result;
    result << rotation.reshaped(), translation;
    return result;
  }
  [[nodiscard]] Residual residual(const Values<Group>& values) const {
    const Matrix R_from = values[from].rotation().matrix();
    const Matrix turn = values[to].rotation().matrix() - R_from * measurement.rotation().matrix();
    const Vector shift = values[to].translation() - values[from].translation() - R_from * measurement.translation();
    return stacked(std::sqrt(kappa) * turn, std::sqrt(tau) * shift);
  }

  [[nodiscard]] Linearized linearize(const Values<Group>& values) const {
    const Matrix R_from = values[from].rotation().matrix(), R_to = values[to].rotation().matrix();
    const Matrix R = measurement.rotation().matrix();
    const Vector t = measurement.translation();
    const double root_kappa = std::sqrt(kappa), root_tau = std::sqrt(tau);
    Linearized result;
    result.residual = residual(values);
    for (int k = 0; k < Group::dof; ++k) {
      const bool moves = k < dimension;
      const Matrix G = moves ? Matrix::Zero() : generator(k - dimension);
      const Vector v = moves ? Vector(Vector::Unit(std::min(k, dimension - 1))) : Vector::Zero();
      result.jacobians[0].col(k) = stacked(-root_kappa * (R_from * (G * R)), -root_tau * (R_from * (v + G * t)));
      result.jacobians[1].col(k) = stacked(root_kappa * (R_to * G), root_tau * (R_to * v));
    }
    return result;
  }

 private:
  [[nodiscard]] static Matrix generator(int axis) {
    Matrix G = Matrix::Zero();
    const int i = dimension == 2 ? 0 : (axis + 1) % 3, j = dimension == 2 ? 1 : (axis + 2) % 3;
    G(j, i) = 1.0;
    G(i, j) = -1.0;
    return G;
  }
};

/// The largest isotropic noise, one deviation for translations and one for rotations, whose squares never exceed those
/// of `information`; as {tau, kappa} of a `ChordalFactor`.
template <int Dof>
[[nodiscard]] std::pair<double, double> isotropic_minorant(const Eigen::Matrix<double, Dof, Dof>& information) {
  constexpr int dimension = Dof == 6 ? 3 : 2, angles = Dof - dimension;
  const Eigen::Matrix<double, dimension, dimension> moves = information.template topLeftCorner<dimension, dimension>();
  const Eigen::Matrix<double, angles, angles> turns = information.template bottomRightCorner<angles, angles>();
  const double tau = jacobi_eigen(moves).values[0], omega = jacobi_eigen(turns).values[0];
  if (!(tau > 0.0 && omega > 0.0)) return {0.0, 0.0};
  Eigen::Matrix<double, Dof, 1> scale;
  scale << Eigen::Matrix<double, dimension, 1>::Constant(1.0 / std::sqrt(tau)),
      Eigen::Matrix<double, angles, 1>::Constant(1.0 / std::sqrt(omega));
  const Eigen::Matrix<double, Dof, Dof> scaled = scale.asDiagonal() * information * scale.asDiagonal();
  const double share = std::clamp(jacobi_eigen(scaled).values[0], 0.0, 1.0);
  return {share * tau, 0.5 * share * omega};
}

/// The dual of the relaxed problem at one of its stationary points.
template <class Group>
class DualBound {
 public:
  using Chordal = ChordalFactor<Group>;
  static constexpr int dimension = Chordal::dimension;
  static constexpr int block = dimension + 1;
  using Matrix = Eigen::Matrix<double, dimension, dimension>;
  using Block = Eigen::Matrix<double, block, block>;
  using Row = Eigen::Matrix<double, dimension, block>;

  DualBound(std::span<const Chordal> factors, const Values<Group>& values, std::span<const Key> pinned)
      : poses_(values.size()) {
    std::vector<BlockCoordinate> blocks;
    for (const Chordal& factor : factors) blocks.push_back({factor.from, factor.to});
    matrix_ = BlockMatrix<block>(BlockPattern(values.size(), blocks));
    std::vector<Row> gradient(static_cast<std::size_t>(values.size()), Row::Zero());
    for (const Chordal& factor : factors) add(factor, values, gradient);
    for (Key key = 0; key < values.size(); ++key) {
      const Matrix raw = values[key].rotation().matrix().transpose() *
                         gradient[static_cast<std::size_t>(key)].template leftCols<dimension>();
      const Matrix multiplier = 0.5 * (raw + raw.transpose());
      sum_ += multiplier.trace();
      diagonal(key).template topLeftCorner<dimension, dimension>() -= multiplier;
      scale_ += matrix_.block(matrix_.pattern().begin(key)).diagonal().template head<dimension>().cwiseAbs().sum();
    }
    scale_ /= std::max(1.0, static_cast<double>(poses_) * dimension);
    for (const Key key : pinned) diagonal(key)(dimension, dimension) += 1.0 + scale_;
  }

  /// The sum of the multipliers' traces, less what the rest lacks to be positive semi-definite.
  [[nodiscard]] double value() {
    BlockCholesky<block> solver({.pivot_tolerance = 0.0});
    solver.analyze(matrix_.pattern());
    std::vector<double> damping(static_cast<std::size_t>(poses_ * block), 0.0);
    for (double share = 1e-13; share < 10.0; share *= 10.0) {
      const double lift = share * scale_;
      for (std::size_t k = 0; k < damping.size(); ++k) damping[k] = k % block < dimension ? lift : 0.0;
      if (solver.factorize(matrix_, damping).ok()) return sum_ - lift * static_cast<double>(poses_) * dimension;
    }
    return -std::numeric_limits<double>::infinity();
  }

 private:
  [[nodiscard]] auto diagonal(Key key) { return matrix_.block(matrix_.pattern().begin(key)); }

  /// |(X_to - X_from T) W^1/2|^2 with X = [R t] and W = diag(kappa, ..., tau).
  void add(const Chordal& factor, const Values<Group>& values, std::vector<Row>& gradient) {
    const Block T = factor.measurement.matrix();
    Block W = factor.kappa * Block::Identity();
    W(dimension, dimension) = factor.tau;
    const Block TW = T * W;
    diagonal(factor.to) += W;
    diagonal(factor.from) += TW * T.transpose();
    auto coupling =
        matrix_.block(*matrix_.pattern().find(std::max(factor.from, factor.to), std::min(factor.from, factor.to)));
    if (factor.from > factor.to)
      coupling -= TW;
    else
      coupling -= TW.transpose();
    const auto row = [&](Key key) -> Row { return values[key].matrix().template topRows<dimension>(); };
    const Row difference = row(factor.to) - row(factor.from) * T;
    gradient[static_cast<std::size_t>(factor.to)] += difference * W;
    gradient[static_cast<std::size_t>(factor.from)] -= difference * TW.transpose();
  }

  BlockMatrix<block> matrix_;
  Offset poses_;
  double sum_ = 0.0;
  double scale_ = 0.0;
};

}  // namespace detail

/// Bounds a pose graph's cost from below, over all values: if the bound is near the cost, the optimum is the global
/// one.
///
/// The Lagrangian dual of the relaxation of Rosen, Carlone, Bandeira and Leonard 2019 ("SE-Sync"), at its stationary
/// point next to the graph's values. Tight where noise is moderate, and isotropic in translation and in rotation; else
/// true, but loose. Between factors count; those with kernels and factors of other kinds only cost more than nothing.
/// Costs an optimization.
/// @returns nothing if that fails.
template <class Group, class... Extra>
  requires RigidMotionGroup<Group>
[[nodiscard]] std::optional<Certificate> certify(const FactorGraph<Group, Extra...>& graph) {
  using Chordal = detail::ChordalFactor<Group>;
  FactorGraph<Group, Chordal> relaxed;
  for (const Group& value : graph.values()) relaxed.add_value(value);
  for (const BetweenFactor<Group>& factor : graph.betweens()) {
    const typename Group::Jacobian information = factor.sqrt_information.transpose() * factor.sqrt_information;
    const auto [tau, kappa] = detail::isotropic_minorant<Group::dof>(information);
    if (tau > 0.0 && kappa > 0.0) relaxed.add(Chordal{factor.from, factor.to, factor.measurement, kappa, tau});
  }
  const std::vector<Key> pinned = detail::floating_components(relaxed);
  for (const Key key : pinned) relaxed.set_fixed(key);
  if (!optimize(relaxed, LevenbergMarquardt{.relative_tolerance = 1e-12, .absolute_tolerance = 1e-12}).ok())
    return std::nullopt;
  detail::DualBound<Group> dual(relaxed.template factors<Chordal>(), relaxed.values(), pinned);
  return Certificate{graph.cost(), std::max(0.0, dual.value())};
}

}  // namespace chainslam
