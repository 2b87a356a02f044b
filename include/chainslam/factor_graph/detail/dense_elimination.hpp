#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "chainslam/factor_graph/linear_prior.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"

namespace chainslam::detail {

/// Eliminates one variable from the linearised factors on it: what they say of the others, their least squares in it
/// taken, is left as a linear factor (the Schur complement, and a square root of it).
template <LieGroup Group>
class DenseElimination {
 public:
  static constexpr int dof = Group::dof;

  /// @param stays  the other variables, ascending.
  DenseElimination(Key leaves, std::vector<Key> stays) : leaves_(leaves), stays_(std::move(stays)) {
    const Eigen::Index size = dof * (1 + static_cast<Eigen::Index>(stays_.size())) + 1;
    products_ = Eigen::MatrixXd::Zero(size, size);
  }

  template <class Keys, class Linearized>
  void add(const Keys& keys, const Linearized& linearized) {
    Eigen::MatrixXd row = Eigen::MatrixXd::Zero(linearized.residual.rows(), products_.cols());
    for (std::size_t k = 0; k < keys.size(); ++k) row.middleCols<dof>(column(keys[k])) = linearized.jacobians[k];
    row.rightCols<1>() = linearized.residual;
    products_ += row.transpose() * row;
  }

  /// @param moves  whether the variable that leaves is free; if not, it stays at its value for ever.
  /// @param points  where the others are linearised.
  [[nodiscard]] LinearPrior<Group> eliminate(bool moves, std::vector<Group> points) {
    const Eigen::VectorXd before = products_.diagonal();
    for (Eigen::Index k = 0; moves && k < dof; ++k) {
      const double pivot = products_(k, k);
      if (!(pivot > rounding * before[k])) continue;  // nothing is known in this direction
      const Eigen::VectorXd of_pivot = products_.col(k) / std::sqrt(pivot);
      products_ -= of_pivot * of_pivot.transpose();
    }
    const Eigen::Index rest = products_.cols() - dof;
    Eigen::MatrixXd left = products_.bottomRightCorner(rest, rest);
    return {stays_, std::move(points), square_root(left, before.tail(rest)), offset_};
  }

 private:
  static constexpr double rounding = 1e-13;  ///< of an entry of the diagonal before elimination

  [[nodiscard]] Eigen::Index column(Key key) const {
    if (key == leaves_) return 0;
    return dof * (1 + (std::lower_bound(stays_.begin(), stays_.end(), key) - stays_.begin()));
  }

  /// Cholesky with pivots from the diagonal, largest first, until only rounding is left (Higham 2002, section 10.3).
  /// What no step can lower becomes a last row without derivatives, so that the squared error stays what it was.
  [[nodiscard]] Eigen::MatrixXd square_root(Eigen::MatrixXd& products, const Eigen::VectorXd& before) {
    const Eigen::Index columns = products.cols() - 1;
    Eigen::MatrixXd root = Eigen::MatrixXd::Zero(columns + 1, columns + 1);
    Eigen::Index rows = 0;
    for (; rows < columns; ++rows) {
      Eigen::Index pivot = -1;
      double largest = rounding;
      for (Eigen::Index k = 0; k < columns; ++k) {
        if (!(before[k] > 0.0 && products(k, k) / before[k] > largest)) continue;
        largest = products(k, k) / before[k];
        pivot = k;
      }
      if (pivot == -1) break;
      root.row(rows) = products.row(pivot) / std::sqrt(products(pivot, pivot));
      products -= root.row(rows).transpose() * root.row(rows);
      products.row(pivot).setZero();
      products.col(pivot).setZero();
    }
    root(rows++, columns) = std::sqrt(std::max(0.0, products(columns, columns)));
    offset_ = root.col(columns).head(rows);
    return root.topLeftCorner(rows, columns);
  }

  Key leaves_;
  std::vector<Key> stays_;
  Eigen::MatrixXd products_;  ///< [J r]^T [J r], the variable that leaves first
  Eigen::VectorXd offset_;
};

}  // namespace chainslam::detail
