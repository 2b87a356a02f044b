#pragma once

#include <cstddef>
#include <span>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/slam/gravity_measurement.hpp"
#include "chainslam/slam/map_graph.hpp"
#include "chainslam/slam/slam_map.hpp"

// How `MapGraph` makes its smoother from a map.

namespace chainslam {

template <class Outliers>
void MapGraph<Outliers>::remeasure() {
  const auto pose = [&](KeyframeId id) { return map_.keyframes[static_cast<std::size_t>(id.value)].T_map_body; };
  for (OdometryMeasurement& step : map_.odometry) step.T_from_to = pose(step.from).inverse() * pose(step.to);
  for (LoopClosure& closure : map_.closures) closure.T_from_to = pose(closure.from).inverse() * pose(closure.to);
  rebuild();
}

template <class Outliers>
void MapGraph<Outliers>::hold_upright() {
  if constexpr (decides) {
    const Change change(*this);
    for (const SessionId id : factors_->hold_upright(map_)) {
      Session& frame = map_.sessions[static_cast<std::size_t>(id.value)];
      frame.prior_sqrt_information = leaning_anchor(frame.prior, options_.anchor, options_.gravity.start_deviation);
      if (factors_->smoother().contains(priors_[id.value])) factors_->smoother().remove(priors_[id.value]);
      add_prior(frame);
    }
  }
}

template <class Outliers>
void MapGraph<Outliers>::rebuild() {
  factors_.emplace(options_, outliers_);
  for (const Keyframe& one : map_.keyframes) factors_->wait(one);
  priors_.assign(to_index(map_.sessions.size()), {});
  add_to_smoother(0, 0, 0, 0);
}

template <class Outliers>
void MapGraph<Outliers>::add_to_smoother(Index sessions, Index keyframes, Index odometry, Index closures) {
  const auto from = [](const auto& list, Index first) {
    return std::span(list).subspan(static_cast<std::size_t>(first));
  };
  for (const Keyframe& keyframe : from(map_.keyframes, keyframes)) factors_->smoother().add_value(keyframe.T_map_body);
  for (const Session& session : from(map_.sessions, sessions)) add_prior(session);
  for (const OdometryMeasurement& step : from(map_.odometry, odometry)) factors_->add(step);
  for (Index i = closures; i < to_index(map_.closures.size()); ++i) factors_->add_closure(map_, i);
}

template <class Outliers>
void MapGraph<Outliers>::add_prior(const Session& session) {
  if (session.keyframes == 0 || session.prior_sqrt_information.isZero(0)) return;
  priors_[session.id.value] = factors_->smoother().add(
      PriorFactor<SE3d>{session.first_keyframe, session.prior, session.prior_sqrt_information});
}

}  // namespace chainslam
