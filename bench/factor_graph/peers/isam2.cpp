#include "factor_graph/peers/isam2.hpp"

#include <gtsam/nonlinear/ISAM2.h>
#include <gtsam/nonlinear/PriorFactor.h>
#include <gtsam/slam/BetweenFactor.h>

#include "factor_graph/peers/gtsam_types.hpp"

namespace chainslam::bench {

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
  state_->new_factors.addPrior(to_gtsam(key), to_gtsam(pose), noise_to_gtsam<Pose::dof>(noise.sqrt_information()));
}

template <class Pose>
void Isam2<Pose>::add_between(Key from, Key to, const Pose& motion, const Noise& noise) {
  using Factor = gtsam::BetweenFactor<typename State::Peer>;
  state_->new_factors.template emplace_shared<Factor>(to_gtsam(from), to_gtsam(to), to_gtsam(motion),
                                                      noise_to_gtsam<Pose::dof>(noise.sqrt_information()));
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
