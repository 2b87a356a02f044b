#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/sparse/dense_kernels.hpp"

namespace chainslam::detail {

/// Eliminates one variable from the linearized factors on it: what they say of the others, their least squares in it
/// taken, is left as a linear factor (the Schur complement, and a square root of it).
class DenseElimination {
 public:
  /// What is left: residual offset + sqrt_information (x - points).
  struct Left {
    Eigen::MatrixXd sqrt_information;  ///< columns by the variables that stay
    Eigen::VectorXd offset;
  };

  /// @param dof  of a variable.
  /// @param stays  the other variables, ascending.
  DenseElimination(Offset dof, Key leaves, std::vector<Key> stays)
      : dof_(dof),
        leaves_(leaves),
        stays_(std::move(stays)),
        size_(dof * (1 + static_cast<Offset>(stays_.size())) + 1),
        products_(size_ * size_, 0.0) {}

  /// @param numbers  as `write_linearization` writes them.
  void add(std::span<const Key> keys, Offset rows, const double* numbers) {
    Table<double> all(size_ * rows, 0.0);  // [J r]^T
    const double* const residual = numbers + dof_ * static_cast<Offset>(keys.size()) * rows;
    for (Offset row = 0; row < rows; ++row) {
      double* const of_row = all.data() + row * size_;
      for (const Key key : keys) {
        std::copy_n(numbers, dof_, of_row + place(key));
        numbers += dof_;
      }
      of_row[size_ - 1] = residual[row];
    }
    for (Offset k = 0; k < size_; ++k)
      add_product<1>(size_, all.data(), size_, all.data() + k, size_, rows, column(k), size_);
  }

  /// @param moves  whether the variable that leaves is free; if not, it stays at its value for ever.
  [[nodiscard]] Left eliminate(bool moves) {
    Table<double> before(size_);
    for (Offset k = 0; k < size_; ++k) before[k] = column(k)[k];
    for (Offset k = 0; moves && k < dof_; ++k) {
      if (column(k)[k] > rounding * before[k]) take_off(k);  // else nothing is known in this direction
    }
    return square_root(before);
  }

 private:
  static constexpr double rounding = 1e-13;  ///< of an entry of the diagonal before elimination

  [[nodiscard]] double* column(Offset k) { return products_.data() + k * size_; }
  [[nodiscard]] Offset place(Key key) const {
    if (key == leaves_) return 0;
    return dof_ * (1 + (std::lower_bound(stays_.begin(), stays_.end(), key) - stays_.begin()));
  }

  /// Subtracts what a pivot's column, divided by the root of its diagonal, is multiplied by itself.
  /// @returns the column so divided.
  Table<double> take_off(Offset pivot) {
    Table<double> root(size_);
    const double divisor = std::sqrt(column(pivot)[pivot]);
    for (Offset k = 0; k < size_; ++k) root[k] = column(pivot)[k] / divisor;
    for (Offset k = 0; k < size_; ++k) subtract_product<1>(size_, root.data(), size_, &root[k], 1, 1, column(k), size_);
    return root;
  }

  /// Cholesky with pivots from the diagonal, largest first, until only rounding is left (Higham 2002, section 10.3).
  /// What no step can lower becomes a last row without derivatives, so that the squared error stays what it was.
  [[nodiscard]] Left square_root(const Table<double>& before) {
    const Offset last = size_ - 1;
    std::vector<Table<double>> rows;
    for (Offset row = dof_; row < last; ++row) {
      Offset pivot = -1;
      double largest = rounding;
      for (Offset k = dof_; k < last; ++k) {
        if (!(before[k] > 0.0 && column(k)[k] / before[k] > largest)) continue;
        largest = column(k)[k] / before[k];
        pivot = k;
      }
      if (pivot == -1) break;
      rows.push_back(take_off(pivot));
      for (Offset k = 0; k < size_; ++k) column(k)[pivot] = column(pivot)[k] = 0.0;
    }
    const auto count = static_cast<Eigen::Index>(rows.size());
    Left left;
    left.sqrt_information.setZero(count + 1, last - dof_);
    left.offset.setZero(count + 1);
    for (Eigen::Index row = 0; row < count; ++row) {
      const Table<double>& root = rows[static_cast<std::size_t>(row)];
      for (Offset k = dof_; k < last; ++k) left.sqrt_information(row, k - dof_) = root[k];
      left.offset[row] = root[last];
    }
    left.offset[count] = std::sqrt(std::max(0.0, column(last)[last]));
    return left;
  }

  Offset dof_;
  Key leaves_;
  std::vector<Key> stays_;
  Offset size_;
  Table<double> products_;  ///< [J r]^T [J r], the variable that leaves first, column-major
};

}  // namespace chainslam::detail
