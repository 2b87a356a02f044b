#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/sparse/cholesky.hpp"

namespace chainslam {

/// Groups of rotations with translations, SE(2) and SE(3), tangent [translation; rotation].
template <class G>
concept RigidMotionGroup = LieGroup<G> && requires(const G& x) {
  { x.rotation().matrix() } -> std::convertible_to<Eigen::MatrixXd>;
  { x.translation() } -> std::convertible_to<Eigen::VectorXd>;
  G(x.rotation(), x.translation());
};

namespace detail {

/// A factor that measures one variable seen from another, as `BetweenFactor`.
template <class F>
concept RelativeMeasurement = requires(const F& factor) {
  { factor.from } -> std::convertible_to<Key>;
  { factor.to } -> std::convertible_to<Key>;
  factor.measurement.rotation();
  factor.sqrt_information.rows();
};

/// A factor that measures one variable by itself, as `PriorFactor`.
template <class F>
concept AbsoluteMeasurement = requires(const F& factor) {
  { factor.key } -> std::convertible_to<Key>;
  factor.mean.rotation();
  factor.sqrt_information.rows();
};

/// The rotation nearest to a matrix in the Frobenius norm.
template <class Rotation>
[[nodiscard]] Rotation nearest_rotation(const typename Rotation::Jacobian& matrix) requires(Rotation::dof == 3) {
  return Rotation::from_quaternion(
      typename Rotation::Quaternion(Eigen::Vector4d(jacobi_eigen(horn_matrix(matrix)).vectors.col(3))));
}
template <class Rotation>
[[nodiscard]] Rotation nearest_rotation(const Eigen::Matrix2d& matrix) requires(Rotation::dof == 1) {
  return Rotation::from_matrix(matrix);
}

/// Two linear least-squares problems on one pattern: rotations as if they were any matrices, then translations.
template <class Graph>
class ChordalRelaxation {
 public:
  using Group = typename Graph::Value;
  using Rotation = std::remove_cvref_t<decltype(std::declval<Group>().rotation())>;
  static constexpr int dimension = Group::dof == 6 ? 3 : 2;
  using Matrix = Eigen::Matrix<double, dimension, dimension>;
  using Vector = Eigen::Matrix<double, dimension, 1>;

  explicit ChordalRelaxation(const Graph& graph) : values_(graph.values()) {
    column_.assign(static_cast<std::size_t>(values_.size()), -1);
    for (Key key = 0; key < values_.size(); ++key) {
      if (graph.is_fixed(key)) continue;
      column_[static_cast<std::size_t>(key)] = to_index(keys_.size());
      keys_.push_back(key);
    }
    graph.for_each_factor([&](const auto& factor) { take(factor); });
    std::vector<BlockCoordinate> blocks;
    for (const Edge& edge : edges_) {
      if (column(edge.from) >= 0 && column(edge.to) >= 0) blocks.push_back({column(edge.from), column(edge.to)});
    }
    matrix_ = BlockMatrix<dimension>(BlockPattern(to_index(keys_.size()), blocks));
    solver_.analyze(matrix_.pattern());
  }

  [[nodiscard]] bool solve() { return solve_rotations() && solve_translations(); }
  [[nodiscard]] Values<Group> take_values() { return std::move(values_); }

 private:
  struct Edge {
    Key from, to;
    Matrix rotation;  ///< R_from_to
    Vector translation;
    double rotation_weight;
    Matrix translation_information;  ///< in the measured frame of `to`
  };
  struct Anchor {
    Key key;
    Matrix rotation;
    Vector translation;
    double rotation_weight;
    Matrix translation_information;
  };
  /// One right-hand side a column; a block row for each free variable.
  using RightSides = Eigen::MatrixXd;

  [[nodiscard]] Index column(Key key) const { return column_[static_cast<std::size_t>(key)]; }

  template <class F>
  void take(const F& factor) {
    if constexpr (RelativeMeasurement<F>) {
      edges_.push_back({factor.from, factor.to, factor.measurement.rotation().matrix(),
                        factor.measurement.translation(), rotation_weight(factor), translation_information(factor)});
    } else if constexpr (AbsoluteMeasurement<F>) {
      anchors_.push_back({factor.key, factor.mean.rotation().matrix(), factor.mean.translation(),
                          rotation_weight(factor), translation_information(factor)});
    }
  }
  /// The mean over the axes.
  template <class F>
  [[nodiscard]] static double rotation_weight(const F& factor) {
    constexpr int axes = Group::dof - dimension;
    return factor.sqrt_information.template rightCols<axes>().squaredNorm() / axes;
  }
  template <class F>
  [[nodiscard]] static Matrix translation_information(const F& factor) {
    return factor.sqrt_information.template leftCols<dimension>().transpose() *
           factor.sqrt_information.template leftCols<dimension>();
  }

  /// For X = R^T: sum of weight |X_to - R_from_to^T X_from|^2 (Carlone et al. 2015, section III-B; Martinec and
  /// Pajdla 2007).
  [[nodiscard]] bool solve_rotations() {
    RightSides right = RightSides::Zero(rows(), dimension);
    matrix_.set_zero();
    const auto known = [&](Key key) -> Matrix { return values_[key].rotation().matrix().transpose(); };
    for (const Edge& edge : edges_) {
      const Matrix weight = edge.rotation_weight * Matrix::Identity();
      add(edge.from, edge.to, weight, weight, edge.rotation_weight * edge.rotation.transpose(), right, known);
    }
    for (const Anchor& anchor : anchors_) {
      if (column(anchor.key) < 0) continue;
      diagonal(anchor.key) += anchor.rotation_weight * Matrix::Identity();
      row(right, anchor.key) += anchor.rotation_weight * anchor.rotation.transpose();
    }
    if (!solve(right)) return false;
    for (const Key key : keys_) {
      const Matrix relaxed = row(right, key).transpose();
      values_[key] = Group(nearest_rotation<Rotation>(relaxed), values_[key].translation());
    }
    return true;
  }

  /// sum of |t_to - t_from - R_from t_from_to|^2, weighted in the measured frame.
  [[nodiscard]] bool solve_translations() {
    RightSides right = RightSides::Zero(rows(), 1);
    matrix_.set_zero();
    const auto known = [&](Key key) -> Vector { return values_[key].translation(); };
    for (const Edge& edge : edges_) {
      const Matrix R_from = values_[edge.from].rotation().matrix();
      const Matrix axes = R_from * edge.rotation;
      const Matrix weight = axes * edge.translation_information * axes.transpose();
      const Vector pull = weight * (R_from * edge.translation);
      add(edge.from, edge.to, weight, weight, weight, right, known);
      if (column(edge.to) >= 0) row(right, edge.to) += pull;
      if (column(edge.from) >= 0) row(right, edge.from) -= pull;
    }
    for (const Anchor& anchor : anchors_) {
      if (column(anchor.key) < 0) continue;
      const Matrix weight = anchor.rotation * anchor.translation_information * anchor.rotation.transpose();
      diagonal(anchor.key) += weight;
      row(right, anchor.key) += weight * anchor.translation;
    }
    if (!solve(right)) return false;
    for (const Key key : keys_) values_[key] = Group(values_[key].rotation(), Vector(row(right, key)));
    return true;
  }

  /// Adds the square of a term on two variables: its diagonal blocks, and minus its block (to, from). What is known of
  /// fixed variables goes to the right.
  template <class Known>
  void add(Key from, Key to, const Matrix& of_from, const Matrix& of_to, const Matrix& coupling, RightSides& right,
           Known&& known) {
    const Index i = column(from), j = column(to);
    if (i >= 0) diagonal(from) += of_from;
    if (j >= 0) diagonal(to) += of_to;
    if (i >= 0 && j >= 0) {
      auto block = matrix_.block(*matrix_.pattern().find(std::max(i, j), std::min(i, j)));
      if (j > i)
        block -= coupling;
      else
        block -= coupling.transpose();
    } else if (j >= 0) {
      row(right, to) += coupling * known(from);
    } else if (i >= 0) {
      row(right, from) += coupling.transpose() * known(to);
    }
  }

  [[nodiscard]] Eigen::Index rows() const { return static_cast<Eigen::Index>(keys_.size()) * dimension; }
  [[nodiscard]] auto diagonal(Key key) { return matrix_.block(matrix_.pattern().begin(column(key))); }
  [[nodiscard]] auto row(RightSides& sides, Key key) const {
    return sides.template middleRows<dimension>(Eigen::Index{column(key)} * dimension);
  }

  [[nodiscard]] bool solve(RightSides& right) {
    if (!solver_.factorize(matrix_).ok()) return false;
    for (Eigen::Index k = 0; k < right.cols(); ++k)
      solver_.solve({right.col(k).data(), static_cast<std::size_t>(right.rows())});
    return right.allFinite();
  }

  Values<Group> values_;
  std::vector<Index> column_;  ///< of each key; -1 where fixed
  std::vector<Key> keys_;      ///< of each column
  std::vector<Edge> edges_;
  std::vector<Anchor> anchors_;
  BlockMatrix<dimension> matrix_;
  BlockCholesky<dimension> solver_;
};

}  // namespace detail

/// Where a pose graph's variables lie by its relative and absolute poses alone, whatever their values are: a start for
/// optimization that noise and long loops disturb far less than composed odometry does.
///
/// Rotations by linear least squares over all matrices, each then replaced by the nearest rotation; translations by
/// linear least squares given them (Carlone, Tron, Daniilidis and Dellaert 2015, "Initialization techniques for 3D
/// SLAM"). Fixed variables keep their values. Kernels are left out of account, as are factors of other kinds.
///
/// @param graph  a `FactorGraph`, or anything with its `values`, `is_fixed` and `for_each_factor`.
/// @returns nothing if these factors do not determine all variables.
template <class Graph>
  requires RigidMotionGroup<typename Graph::Value>
[[nodiscard]] std::optional<Values<typename Graph::Value>> chordal_initialization(const Graph& graph) {
  detail::ChordalRelaxation<Graph> relaxation(graph);
  if (!relaxation.solve()) return std::nullopt;
  return relaxation.take_values();
}

}  // namespace chainslam
