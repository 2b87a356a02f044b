#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// R A, for what a factor whitens: a residual or a Jacobian.
template <int Dof, int Columns>
[[nodiscard]] Eigen::Matrix<double, Dof, Columns> whitened(const SqrtInformation<Dof>& sqrt_information,
                                                           const Eigen::Matrix<double, Dof, Columns>& A) {
  Eigen::Matrix<double, Dof, Dof> root;  // aligned, as `product` asks for, which factors do not keep it
  std::copy_n(sqrt_information.data(), Dof * Dof, root.data());
  return product(root, A);
}

/// Gaussian noise of a residual of `Dof` rows, kept as square-root information: the whitened residual is R r.
///
/// Every way in refuses what is not a number, not symmetric, or negative, with std::invalid_argument. Rows as the
/// residual's: for SE(3) [translation; rotation].
template <int Dof>
class NoiseModel {
 public:
  using Matrix = Eigen::Matrix<double, Dof, Dof>;  ///< covariance or information, `Dof` x `Dof`
  using Vector = Eigen::Matrix<double, Dof, 1>;    ///< one number for each row

  /// @param covariance  symmetric, positive definite.
  [[nodiscard]] static NoiseModel from_covariance(const Matrix& covariance) {
    require_symmetric(covariance, "covariance");
    // Scaled to unit diagonal, so that 1e-12 rad^2 beside 1e4 m^2 is not taken for singular.
    for (int i = 0; i < Dof; ++i)
      if (!(covariance(i, i) > 0.0)) refuse("covariance", "is not positive definite");
    Matrix scale = zeros<Matrix>(), correlation;
    for (int i = 0; i < Dof; ++i) scale(i, i) = 1.0 / std::sqrt(covariance(i, i));
    for (int j = 0; j < Dof; ++j)
      for (int i = 0; i < Dof; ++i) correlation(i, j) = scale(i, i) * covariance(i, j) * scale(j, j);
    const Matrix L = cholesky(correlation);
    for (int i = 0; i < Dof; ++i)
      if (!(L(i, i) > 0.0)) refuse("covariance", "is not positive definite");
    return NoiseModel(transposed(solved_right(scale, L)), "covariance");
  }

  /// @param information  symmetric, positive semi-definite: directions without information are allowed.
  [[nodiscard]] static NoiseModel from_information(const Matrix& information) {
    require_symmetric(information, "information");
    return NoiseModel(semi_definite_root(information), "information");
  }

  /// @param root  any R with R^T R = information.
  [[nodiscard]] static NoiseModel from_sqrt_information(const Matrix& root) {
    return NoiseModel(root, "square-root information");
  }

  /// @param sigmas  standard deviations, > 0; infinity for a direction without information. (0: see `Constrained`.)
  [[nodiscard]] static NoiseModel from_sigmas(const Vector& sigmas) {
    for (const double sigma : sigmas) {
      if (!(sigma > 0.0)) refuse("sigmas", "must be positive; a residual that must be zero is a Constrained factor's");
    }
    Matrix root = zeros<Matrix>();
    for (int k = 0; k < Dof; ++k) root(k, k) = 1.0 / sigmas[k];
    return NoiseModel(root, "sigmas");
  }

  /// The same standard deviation in all directions.
  [[nodiscard]] static NoiseModel from_sigma(double sigma) {
    Vector sigmas;
    std::fill_n(sigmas.data(), Dof, sigma);
    return from_sigmas(sigmas);
  }

  /// R, upper triangular or as given.
  [[nodiscard]] const SqrtInformation<Dof>& sqrt_information() const { return sqrt_information_; }
  [[nodiscard]] Matrix information() const { return sqrt_information_.transpose() * sqrt_information_; }  ///< R^T R

 private:
  NoiseModel(const Matrix& root, const char* origin) {
    require_finite(root, origin);
    std::copy_n(root.data(), Dof * Dof, sqrt_information_.data());
  }

  static void require_finite(const Matrix& matrix, const char* name) {
    for (int k = 0; k < Dof * Dof; ++k)
      if (!std::isfinite(matrix.data()[k])) refuse(name, "is not finite");
  }

  /// Of the sizes of all entries.
  [[nodiscard]] static double largest(const Matrix& matrix) {
    double size = 0;
    for (int k = 0; k < Dof * Dof; ++k) size = std::max(size, std::abs(matrix.data()[k]));
    return size;
  }

  static void require_symmetric(const Matrix& matrix, const char* name) {
    require_finite(matrix, name);
    constexpr double digits = 1e-6;  // files state six and more
    if (largest(difference_of(matrix, transposed(matrix))) > digits * largest(matrix)) refuse(name, "is not symmetric");
  }

  /// Cholesky with pivots from the diagonal, largest first, which stops where only rounding is left (Higham 2002,
  /// section 10.3). Works on unit diagonal, so that no unit makes another's information look like rounding.
  [[nodiscard]] static Matrix semi_definite_root(const Matrix& information) {
    constexpr double rounding = 1e-12;
    Vector scale, inverse;
    for (int i = 0; i < Dof; ++i) {
      if (information(i, i) < 0.0) refuse("information", "has a negative diagonal");
      scale[i] = std::sqrt(information(i, i));
      inverse[i] = scale[i] > 0.0 ? 1.0 / scale[i] : 1.0;
    }
    Matrix rest, root = zeros<Matrix>();
    for (int j = 0; j < Dof; ++j)
      for (int i = 0; i < Dof; ++i) rest(i, j) = inverse[i] * information(i, j) * inverse[j];
    for (int k = 0; k < Dof; ++k) {
      int pivot = 0;
      for (int i = 1; i < Dof; ++i)
        if (rest(i, i) > rest(pivot, pivot)) pivot = i;
      if (!(rest(pivot, pivot) > rounding)) break;
      const double divisor = std::sqrt(rest(pivot, pivot));
      for (int j = 0; j < Dof; ++j) root(k, j) = rest(pivot, j) / divisor;
      for (int j = 0; j < Dof; ++j)
        for (int i = 0; i < Dof; ++i) rest(i, j) -= root(k, i) * root(k, j);
    }
    if (largest(rest) > rounding) refuse("information", "has a negative direction");
    for (int j = 0; j < Dof; ++j)
      for (int i = 0; i < Dof; ++i) root(i, j) *= scale[j];
    return root;
  }

  [[noreturn]] [[gnu::cold]] [[gnu::noinline]] static void refuse(const char* name, const char* why) {
    throw std::invalid_argument(std::string("NoiseModel: ") + name + " " + why);
  }

  SqrtInformation<Dof> sqrt_information_;
};

}  // namespace chainslam
