#include "factor_graph/peers/isam2.hpp"

#include <gtsam/geometry/Pose2.h>
#include <gtsam/geometry/Pose3.h>
#include <gtsam/linear/NoiseModel.h>
#include <gtsam/nonlinear/ISAM2.h>
#include <gtsam/nonlinear/PriorFactor.h>
#include <gtsam/slam/BetweenFactor.h>

#include "chainslam/lie/se2.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam::bench {
namespace {

gtsam::Pose3 to_gtsam(const SE3d& pose) { return gtsam::Pose3(pose.matrix()); }
gtsam::Pose2 to_gtsam(const SE2d& pose) {
  return gtsam::Pose2(pose.translation().x(), pose.translation().y(), pose.rotation().angle());
}
SE3d from_gtsam(const gtsam::Pose3& pose) {
  return SE3d(SO3d::from_matrix(pose.rotation().matrix()), pose.translation());
}
SE2d from_gtsam(const gtsam::Pose2& pose) { return SE2d(SO2d::from_angle(pose.theta()), pose.translation()); }

/// GTSAM has the rotation before the translation in three dimensions, behind it in two.
template <int Dof>
gtsam::SharedNoiseModel to_gtsam(const NoiseModel<Dof>& noise) {
  const Eigen::Matrix<double, Dof, Dof> root = noise.sqrt_information();
  gtsam::Matrix reordered = root;
  if constexpr (Dof == 6) {
    reordered.leftCols(3) = root.template rightCols<3>();
    reordered.rightCols(3) = root.template leftCols<3>();
    // Rows may come in any order: in this one, a diagonal stays a diagonal.
    const gtsam::Matrix columns = reordered;
    reordered.topRows(3) = columns.bottomRows(3);
    reordered.bottomRows(3) = columns.topRows(3);
  }
  return gtsam::noiseModel::Gaussian::SqrtInformation(reordered);
}

gtsam::Key to_gtsam(Key key) { return static_cast<gtsam::Key>(key); }

}  // namespace

template <class Pose>
struct Isam2<Pose>::State {
  using Peer = decltype(to_gtsam(Pose()));

  gtsam::ISAM2 isam;
  gtsam::NonlinearFactorGraph new_factors{};
  gtsam::Values new_values{};
  Index size = 0;
};

template <class Pose>
Isam2<Pose>::Isam2(double relinearize_threshold) {
  gtsam::ISAM2Params parameters;
  parameters.relinearizeThreshold = relinearize_threshold;
  parameters.relinearizeSkip = 1;
  state_ = std::make_unique<State>(State{.isam = gtsam::ISAM2(parameters)});
}

template <class Pose>
Isam2<Pose>::~Isam2() = default;

template <class Pose>
Index Isam2<Pose>::size() const {
  return state_->size;
}

template <class Pose>
Pose Isam2<Pose>::operator[](Key key) const {
  return from_gtsam(state_->isam.template calculateEstimate<typename State::Peer>(to_gtsam(key)));
}

template <class Pose>
void Isam2<Pose>::add_value(const Pose& guess) {
  state_->new_values.insert(to_gtsam(state_->size++), to_gtsam(guess));
}

template <class Pose>
void Isam2<Pose>::add_prior(Key key, const Pose& pose, const Noise& noise) {
  state_->new_factors.addPrior(to_gtsam(key), to_gtsam(pose), to_gtsam(noise));
}

template <class Pose>
void Isam2<Pose>::add_between(Key from, Key to, const Pose& motion, const Noise& noise) {
  using Factor = gtsam::BetweenFactor<typename State::Peer>;
  state_->new_factors.template emplace_shared<Factor>(to_gtsam(from), to_gtsam(to), to_gtsam(motion), to_gtsam(noise));
}

template <class Pose>
void Isam2<Pose>::update() {
  state_->isam.update(state_->new_factors, state_->new_values);
  state_->new_factors.resize(0);
  state_->new_values.clear();
}

template <class Pose>
Index Isam2<Pose>::read_all() const {
  return static_cast<Index>(state_->isam.calculateEstimate().size());
}

template <class Pose>
double Isam2<Pose>::cost() const {
  return 2.0 * state_->isam.getFactorsUnsafe().error(state_->isam.calculateEstimate());
}

template class Isam2<SE3d>;
template class Isam2<SE2d>;

}  // namespace chainslam::bench
