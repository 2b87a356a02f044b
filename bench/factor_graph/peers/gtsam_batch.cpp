#include "factor_graph/peers/gtsam_batch.hpp"

#include <gtsam/nonlinear/GaussNewtonOptimizer.h>
#include <gtsam/nonlinear/NonlinearFactorGraph.h>
#include <gtsam/nonlinear/PriorFactor.h>
#include <gtsam/slam/BetweenFactor.h>

#include "factor_graph/peers/gtsam_types.hpp"

namespace chainslam::bench {
namespace {

/// `gtsam::BetweenFactor` with the logarithm's Jacobian.
template <class Pose>
class ExactBetween : public gtsam::NoiseModelFactorN<Pose, Pose> {
  using Base = gtsam::NoiseModelFactorN<Pose, Pose>;

 public:
  using Base::evaluateError;

  ExactBetween(gtsam::Key from, gtsam::Key to, const Pose& measured, const gtsam::SharedNoiseModel& noise)
      : Base(noise, from, to), measured_(measured) {}

  gtsam::Vector evaluateError(const Pose& from, const Pose& to, gtsam::OptionalMatrixType of_from,
                              gtsam::OptionalMatrixType of_to) const override {
    const Pose motion = gtsam::traits<Pose>::Between(from, to, of_from, of_to);
    typename gtsam::traits<Pose>::ChartJacobian::Jacobian of_log;
    const gtsam::Vector error = gtsam::traits<Pose>::Logmap(measured_.inverse() * motion, of_log);
    if (of_from) *of_from = of_log * (*of_from);
    if (of_to) *of_to = of_log * (*of_to);
    return error;
  }

 private:
  Pose measured_;
};

}  // namespace

template <class Pose>
struct GtsamBatch<Pose>::State {
  using Peer = decltype(to_gtsam(Pose()));

  gtsam::NonlinearFactorGraph factors{};
  gtsam::Values start{};
};

template <class Pose>
GtsamBatch<Pose>::GtsamBatch(const FactorGraph<Pose>& graph, Jacobians jacobians) : state_(std::make_unique<State>()) {
  using Peer = typename State::Peer;
  for (Key key = 0; key < graph.values().size(); ++key) {
    state_->start.insert(to_gtsam(key), to_gtsam(graph[key]));
    if (!graph.is_fixed(key)) continue;
    const auto held = gtsam::noiseModel::Isotropic::Sigma(Pose::dof, 1e-7);
    state_->factors.addPrior(to_gtsam(key), to_gtsam(graph[key]), held);
  }
  for (const auto& factor : graph.priors()) {
    state_->factors.addPrior(to_gtsam(factor.key), to_gtsam(factor.mean),
                             noise_to_gtsam<Pose::dof>(factor.sqrt_information));
  }
  for (const auto& factor : graph.betweens()) {
    const gtsam::Key from = to_gtsam(factor.from), to = to_gtsam(factor.to);
    const auto noise = noise_to_gtsam<Pose::dof>(factor.sqrt_information);
    if (jacobians == Jacobians::exact) {
      state_->factors.template emplace_shared<ExactBetween<Peer>>(from, to, to_gtsam(factor.measurement), noise);
    } else {
      state_->factors.template emplace_shared<gtsam::BetweenFactor<Peer>>(from, to, to_gtsam(factor.measurement),
                                                                          noise);
    }
  }
}

template <class Pose>
GtsamBatch<Pose>::~GtsamBatch() = default;

template <class Pose>
Values<Pose> GtsamBatch<Pose>::optimized() const {
  const gtsam::Values end = gtsam::GaussNewtonOptimizer(state_->factors, state_->start).optimize();
  Values<Pose> values;
  for (gtsam::Key key = 0; key < end.size(); ++key) values.add(from_gtsam(end.template at<typename State::Peer>(key)));
  return values;
}

template class GtsamBatch<SE3d>;
template class GtsamBatch<SE2d>;

}  // namespace chainslam::bench
