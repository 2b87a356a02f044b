#pragma once

#include <Eigen/Cholesky>
#include <algorithm>
#include <numeric>

#include "chainslam/core/table.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_class.hpp"

// What can be asked of `IncrementalSmoother`, and moves of whole sessions.

namespace chainslam {

/// Between factors among moved variables see no change; the others are linearised anew at their estimate.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::move(std::span<const Key> keys, const Group& motion) {
  for (const Key key : keys) require_known(key);
  begin();
  detail::Table<char> moved(size(), 0);
  for (const Key key : keys) {
    if (moved[key] != 0) continue;
    moved[key] = 1;
    origins_before_.push_back(origins_[key]);
    changes_.push_back({ChangeKind::origin_moved, key, look_[key]});
    origins_[key] = motion * origins_[key];
    estimate(key);
  }
  std::vector<Key> outside;
  for (const Key key : keys) {
    for (Index k = solver_.terms().first(key); k != -1; k = solver_.terms().slot(k).next) {
      const auto slots = solver_.terms().slots(solver_.terms().slot(k).term);
      bool inside = true;
      for (const auto& slot : slots) inside = inside && moved[slot.variable] != 0;
      if (inside && traits(solver_.terms().slot(k).term).left_invariant) continue;
      for (const auto& slot : slots) outside.push_back(slot.variable);
    }
  }
  detail::sort_unique(outside);
  for (const Key key : outside) relinearize_at_estimate(key);
  revision_ += 2;
  components_outdated_ = true;  // what holds a part may see it from elsewhere
}

template <class Group, class... Extra>
Eigen::MatrixXd IncrementalSmoother<Group, Extra...>::covariance(std::span<const Key> keys) const {
  std::vector<Key> free;
  for (const Key key : keys) {
    require_known(key);
    if (solver_.is_eliminated(key)) free.push_back(key);
  }
  // From the coordinates of the linear system to right perturbations of the estimates.
  const auto size_of = [](const auto& list) { return static_cast<Eigen::Index>(list.size()) * dof; };
  Eigen::MatrixXd E = Eigen::MatrixXd::Zero(size_of(free), size_of(keys));
  Eigen::Index row = 0, column = 0;
  for (const Key key : keys) {
    if (row < E.rows() && free[static_cast<std::size_t>(row / dof)] == key) {
      E.template block<dof, dof>(row, column) = at_estimate(key).transpose();
      row += dof;
    }
    column += dof;
  }
  return solver_.inverse_product(free, E);
}

template <class Group, class... Extra>
std::vector<typename Group::Jacobian> IncrementalSmoother<Group, Extra...>::marginals() const {
  const std::vector<double> blocks = solver_.inverse_diagonal();
  std::vector<typename Group::Jacobian> covariances;
  covariances.reserve(static_cast<std::size_t>(size()));
  for (Key key = 0; key < size(); ++key) {
    const Eigen::Map<const typename Group::Jacobian> block(blocks.data() + Offset{key} * dof * dof);
    const typename Group::Jacobian turned = at_estimate(key);
    covariances.push_back(turned * block * turned.transpose());
  }
  return covariances;
}

template <class Group, class... Extra>
template <Factor F>
FactorForecast IncrementalSmoother<Group, Extra...>::what_if(const F& factor) const {
  const auto keys = factor.keys();
  require_keys(keys);
  const Index rows = detail::rows_of(factor);
  const Offset stride = Offset{dof} * static_cast<Offset>(keys.size());
  const std::vector<double> numbers = detail::linearization(factor, estimates_, detail::Kernels::applied);
  std::vector<Key> free;
  Eigen::MatrixXd E(stride, rows);
  for (std::size_t k = 0; k < keys.size(); ++k) {
    if (!solver_.is_eliminated(keys[k])) continue;
    const typename Group::Jacobian turn = at_estimate(keys[k]);
    const auto to = static_cast<Eigen::Index>(free.size()) * dof;
    for (Index row = 0; row < rows; ++row) {
      const double* const of_key = numbers.data() + row * stride + static_cast<Offset>(k) * dof;
      for (int c = 0; c < dof; ++c)
        E(to + c, row) = std::inner_product(of_key, of_key + dof, turn.data() + c * dof, 0.0);
    }
    free.push_back(keys[k]);
  }
  E.conservativeResize(static_cast<Eigen::Index>(free.size()) * dof, rows);
  Eigen::MatrixXd innovation = solver_.inverse_product(free, E);
  innovation.diagonal().array() += 1.0;
  const Eigen::VectorXd residual = Eigen::Map<const Eigen::VectorXd>(numbers.data() + rows * stride, rows);
  return {residual.squaredNorm(), residual.dot(innovation.llt().solve(residual))};
}

}  // namespace chainslam
