#pragma once

#include <algorithm>
#include <array>
#include <span>
#include <vector>

#include <iterator>
#include <stdexcept>
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"

// What can be asked of `IncrementalSmoother`, and moves of whole sessions.

namespace chainslam {

/// Between factors among moved variables see no change; the others are relinearized at their estimate.
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
  ++losses_;
  // What holds a part may see it from elsewhere, unless it is one prior.
  const auto held_by_prior = [&](Key key) {
    const Index holder = components_.holder(key);
    return holder >= 0 && solver_.terms().slots(holder).size() == 1;
  };
  for (const Key key : keys) components_outdated_ = components_outdated_ || !held_by_prior(key);
}

template <class Group, class... Extra>
std::vector<Key> IncrementalSmoother<Group, Extra...>::find_all_floating() {
  components_.clear();
  for (Key key = 0; key < size(); ++key) components_.add_variable();
  // First what is connected: then one prior is enough for a part, and the others need not be looked at.
  const detail::Table<Index> terms = pools_.terms();
  for (const Index term : terms) {
    list_keys(term, keys_);
    components_.connect(keys_);
  }
  for (Key key = 0; key < size(); ++key) {
    if (solver_.is_fixed(key)) components_.hold(key);
  }
  for (const Index term : terms) hold(term);
  std::vector<Key> floating = components_.floating();
  components_outdated_ = !floating.empty();
  return floating;
}

/// Tells `components_` what a factor ties together, and holds.
template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::tie(Index term) {
  list_keys(term, keys_);
  components_.connect(keys_);
  hold(term);
}

template <class Group, class... Extra>
void IncrementalSmoother<Group, Extra...>::hold(Index term) {
  if (!traits(term).holds_in_place) return;
  list_keys(term, keys_);
  if (keys_.empty() || components_.is_held(keys_.front())) return;
  const auto place = pools_.place(term);
  numbers_.resize(solver_.terms().size(term));
  pools_.pool(place.type).linearize(place.slot, origins_, detail::Kernels::left_out, numbers_.data());
  components_.hold(keys_, solver_.terms().rows(term), numbers_.data(), origins_, term);
}

template <class Group, class... Extra>
double IncrementalSmoother<Group, Extra...>::current_cost() {
  const auto terms_at = [&](Key key, auto&& visit) {
    for (Index k = solver_.terms().first(key); k != -1; k = solver_.terms().slot(k).next)
      visit(solver_.terms().slot(k).term);
  };
  return costs_.sum([&] { return pools_.terms(); }, terms_at,
                    [&](Index term) { return pools_.cost(term, estimates_); });
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
  Eigen::MatrixXd found(E.cols(), E.cols());
  solver_.inverse_product(free, E.data(), to_index(E.cols()), found.data());
  return found;
}

template <class Group, class... Extra>
typename Group::Jacobian IncrementalSmoother<Group, Extra...>::relative_covariance(Key from, Key to) const {
  using Jacobian = typename Group::Jacobian;
  require_known(from);
  require_known(to);
  Jacobian covariance = zeros<Jacobian>();
  if (from == to) return covariance;
  std::array<Key, 2> free{};
  Eigen::Matrix<double, 2 * dof, dof> E = zeros<Eigen::Matrix<double, 2 * dof, dof>>();
  std::size_t count = 0;
  const auto add = [&](Key key, const Jacobian& by_key) {
    if (!solver_.is_eliminated(key)) return;
    set_block(E, static_cast<int>(count) * dof, 0, transposed(product(by_key, at_estimate(key))));
    free[count++] = key;
  };
  add(from, negative(((*this)[to].inverse() * (*this)[from]).adjoint()));
  add(to, identity<Jacobian>());
  if (count == 1) {
    const Jacobian only = block_of<dof, dof>(E, 0, 0);
    solver_.inverse_product(std::span(free).first(1), only.data(), dof, covariance.data());
  } else if (count == 2) {
    solver_.inverse_product(free, E.data(), dof, covariance.data());
  }
  return covariance;
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
  require_keys(factor.keys());
  return {factor.residual(estimates_).squaredNorm(), rise_with(std::span<const F>(&factor, 1)).change};
}

template <class Group, class... Extra>
template <Factor F>
JointForecast IncrementalSmoother<Group, Extra...>::rise_with(std::span<const F> factors) const {
  return forecast(factors, 1.0);
}

template <class Group, class... Extra>
template <Factor F>
JointForecast IncrementalSmoother<Group, Extra...>::fall_without(std::span<const F> factors) const {
  return forecast(factors, -1.0);
}

template <class Group, class... Extra>
template <Factor F>
JointForecast IncrementalSmoother<Group, Extra...>::forecast(std::span<const F> factors, double sign) const {
  detail::Table<Key> keys;
  for (const F& factor : factors) {
    for (const Key key : factor.keys()) {
      require_known(key);
      if (detail::place_of(keys.all(), key) == keys.size()) keys.push_back(key);
    }
  }
  detail::Table<double> jacobian, residual;
  for (const F& factor : factors) {
    const Offset rows = detail::rows_of(factor), own_keys = to_index(factor.keys().size());
    const std::vector<double> numbers = detail::linearization(factor, estimates_, detail::Kernels::applied);
    residual.append(std::span(numbers).subspan(static_cast<std::size_t>(rows * own_keys * dof)));
    for (Offset row = 0; row < rows; ++row) {
      const Offset begin = jacobian.size();
      jacobian.resize(begin + keys.size() * dof, 0.0);
      const double* from = numbers.data() + row * own_keys * dof;
      for (const Key key : factor.keys()) {
        std::copy_n(from, dof, jacobian.data() + begin + detail::place_of(keys.all(), key) * dof);
        from += dof;
      }
    }
  }
  return forecast(keys.all(), jacobian.all(), residual.all(), sign);
}

template <class Group, class... Extra>
JointForecast IncrementalSmoother<Group, Extra...>::forecast(std::span<const Key> keys,
                                                             std::span<const double> jacobian,
                                                             std::span<double> residual, double sign) const {
  detail::Table<Key> free;
  for (const Key key : keys)
    if (solver_.is_eliminated(key)) free.push_back(key);
  detail::Table<double> E;
  const Index rows = to_index(residual.size());
  const double* of_key = jacobian.data();
  for (Index row = 0; row < rows; ++row) {
    for (const Key key : keys) {
      const Tangent at_estimate_of_key = matrix_of<Tangent>(of_key);
      of_key += dof;
      if (!solver_.is_eliminated(key)) continue;
      const Tangent at_origin = transposed_product(at_estimate(key), at_estimate_of_key);
      E.append(std::span(at_origin.data(), dof));
    }
  }
  detail::Table<double> innovation(Offset{rows} * rows, 0.0);
  solver_.inverse_product(free.all(), E.data(), rows, innovation.data());
  for (double& entry : innovation) entry *= sign;
  for (Index row = 0; row < rows; ++row) innovation[Offset{row} * (rows + 1)] += 1.0;
  const double most = eigenvalue_bound(innovation.data(), rows);
  const double change = squared_mahalanobis(innovation.data(), residual.data(), rows);
  return {change, sign > 0.0 ? 1.0 / most : inverse_eigenvalue_bound(innovation.data(), rows)};
}

template <class Group, class... Extra>
template <class Archive>
void IncrementalSmoother<Group, Extra...>::visit_options(SmootherOptions& options, Archive&& archive) {
  archive(options.linear_tolerance, options.nonlinear_tolerance, options.patience, options.first_look,
          options.longest_step, options.least_error, options.largest_relinearization, options.late_variables,
          options.forgotten_share, options.lag);
}

template <class Group, class... Extra>
std::vector<std::byte> IncrementalSmoother<Group, Extra...>::save() const {
  if (open_) throw std::invalid_argument("IncrementalSmoother: changes wait for update; update or undo before saving");
  ByteSink out = detail::begin_state({dof, Pools::fingerprint()});
  detail::StateWriter write(out);
  SmootherOptions options = options_;
  visit_options(options, write);
  out.put(static_cast<std::uint64_t>(size()));
  for (const Group& origin : origins_) write(origin);
  out.put_list(look_);
  out.put_list(marginalized_);
  waiting_.save(out);
  out.put_list(far_);
  out.put_list(off_);
  out.put(waiting_gap_);
  std::vector<std::vector<Index>> released(static_cast<std::size_t>(Pools::types));
  for (const Change& change : changes_) {
    if (change.kind != ChangeKind::factor_removed) continue;
    const auto place = pools_.place(change.id);
    released[static_cast<std::size_t>(place.type)].push_back(place.slot);
  }
  pools_.save(out, released);
  solver_.save(out);
  return detail::end_state(std::move(out));
}

template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...> IncrementalSmoother<Group, Extra...>::load(std::span<const std::byte> bytes,
                                                                                const std::string& name) {
  ByteSource in = detail::check_state(bytes, {dof, Pools::fingerprint()}, name);
  detail::StateReader read(in);
  SmootherOptions options;
  visit_options(options, read);
  IncrementalSmoother smoother(options);
  const auto count = in.take<std::uint64_t>();
  for (std::uint64_t k = 0; k < count; ++k) {
    Group origin;
    read(origin);
    smoother.origins_.add(origin);
    smoother.estimates_.add(origin);
  }
  in.take_list(smoother.look_);
  in.take_list(smoother.marginalized_);
  smoother.waiting_.load(in, smoother.size());
  in.take_list(smoother.far_);
  in.take_list(smoother.off_);
  smoother.waiting_gap_ = in.take<double>();
  smoother.pools_.load(in);
  smoother.solver_.load(in);
  smoother.estimate_all();
  smoother.touched_.assign(smoother.solver_.terms().count(), 0);
  smoother.components_outdated_ = true;
  smoother.revision_ = 2;
  return smoother;
}

}  // namespace chainslam
