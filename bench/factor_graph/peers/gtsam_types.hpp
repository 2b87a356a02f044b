#pragma once

#include <gtsam/geometry/Pose2.h>
#include <gtsam/geometry/Pose3.h>
#include <gtsam/linear/NoiseModel.h>

#include <Eigen/QR>

#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/se2.hpp"
#include "chainslam/lie/se3.hpp"

// Between our types and GTSAM's. For adapters alone.

namespace chainslam::bench {

inline gtsam::Pose3 to_gtsam(const SE3d& pose) { return gtsam::Pose3(pose.matrix()); }
inline gtsam::Pose2 to_gtsam(const SE2d& pose) {
  return gtsam::Pose2(pose.translation().x(), pose.translation().y(), pose.rotation().angle());
}
inline SE3d from_gtsam(const gtsam::Pose3& pose) {
  return SE3d(SO3d::from_matrix(pose.rotation().matrix()), pose.translation());
}
inline SE2d from_gtsam(const gtsam::Pose2& pose) { return SE2d(SO2d::from_angle(pose.theta()), pose.translation()); }

/// GTSAM has the rotation before the translation in three dimensions, behind it in two; and the root has to be upper
/// triangular there: of others, what lies below the diagonal may go unseen.
template <int Dof>
gtsam::SharedNoiseModel noise_to_gtsam(const Eigen::Matrix<double, Dof, Dof>& root) {
  Eigen::Matrix<double, Dof, Dof> reordered = root;
  if constexpr (Dof == 6) {
    reordered.template leftCols<3>() = root.template rightCols<3>();
    reordered.template rightCols<3>() = root.template leftCols<3>();
  }
  const Eigen::HouseholderQR<Eigen::Matrix<double, Dof, Dof>> qr(reordered);
  gtsam::Matrix triangular = qr.matrixQR().template triangularView<Eigen::Upper>();
  for (Eigen::Index row = 0; row < Dof; ++row) {
    if (triangular(row, row) < 0.0) triangular.row(row) *= -1.0;
  }
  return gtsam::noiseModel::Gaussian::SqrtInformation(triangular);
}

inline gtsam::Key to_gtsam(Key key) { return static_cast<gtsam::Key>(key); }

}  // namespace chainslam::bench
