#pragma once

#include <algorithm>
#include <span>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// Variables of one group, and factors between them, one pool for each type of factor.
///
/// Appending is O(1). Priors and between factors are always there; `Extra` adds more types, such as
/// `BetweenFactor<SE3d, Cauchy>` or a user's own model of `Factor`.
template <class Group, class... Extra>
class FactorGraph {
  static_assert(LieGroup<Group>,
                "FactorGraph: Group needs exp, log, adjoint and Jacobians, as in SE3d; see chainslam/lie/concepts.hpp");
  static_assert((Factor<Extra> && ...),
                "FactorGraph: a factor needs keys(), residual(values) and linearize(values); see "
                "chainslam/factor_graph/values.hpp");

 public:
  using Value = Group;                   ///< type of the variables
  using Noise = NoiseModel<Group::dof>;  ///< noise of a factor with a row for each degree of freedom

  /// @returns the new variable's key: 0, 1, ...
  Key add_value(const Group& initial) {
    fixed_.push_back(0);
    return values_.add(initial);
  }

  /// @throws std::invalid_argument if the key is unknown.
  void add_prior(Key key, const Group& mean, const Noise& noise) {
    add(PriorFactor<Group>{key, mean, noise.sqrt_information()});
  }

  /// @param measurement  T_from_to
  /// @throws std::invalid_argument if a key is unknown or both are the same.
  void add_between(Key from, Key to, const Group& measurement, const Noise& noise) {
    add(BetweenFactor<Group>{from, to, measurement, noise.sqrt_information()});
  }

  /// Appends a factor of any of the graph's types.
  /// @throws std::invalid_argument if a key is unknown or repeated.
  template <Factor F>
  void add(const F& factor) {
    const auto keys = factor.keys();
    for (std::size_t i = 0; i < keys.size(); ++i) {
      require_known(keys[i]);
      if (std::find(keys.begin(), keys.begin() + static_cast<std::ptrdiff_t>(i), keys[i]) !=
          keys.begin() + static_cast<std::ptrdiff_t>(i))
        throw std::invalid_argument("FactorGraph: a factor names variable " + std::to_string(keys[i]) + " twice");
    }
    std::get<std::vector<F>>(factors_).push_back(factor);
  }

  /// Keeps a variable as it is in all optimizations, or lets it go again.
  void set_fixed(Key key, bool fixed = true) {
    require_known(key);
    fixed_[static_cast<std::size_t>(key)] = fixed ? 1 : 0;
  }
  /// Whether a variable is kept where it is.
  [[nodiscard]] bool is_fixed(Key key) const { return fixed_[static_cast<std::size_t>(key)] != 0; }

  /// Replaces one variable's value.
  void set_value(Key key, const Group& value) {
    require_known(key);
    values_[key] = value;
  }
  /// Replaces all values.
  /// @throws std::invalid_argument if their number differs.
  void set_values(Values<Group> values) {
    if (values.size() != values_.size()) throw std::invalid_argument("FactorGraph: the number of values differs");
    values_ = std::move(values);
  }

  [[nodiscard]] const Values<Group>& values() const { return values_; }          ///< all values
  [[nodiscard]] const Group& operator[](Key key) const { return values_[key]; }  ///< the value of a variable

  /// All factors of one type.
  template <Factor F>
  [[nodiscard]] std::span<const F> factors() const {
    return std::get<std::vector<F>>(factors_);
  }
  /// All `PriorFactor`s without a kernel.
  [[nodiscard]] std::span<const PriorFactor<Group>> priors() const { return factors<PriorFactor<Group>>(); }
  /// All `BetweenFactor`s without a kernel.
  [[nodiscard]] std::span<const BetweenFactor<Group>> betweens() const { return factors<BetweenFactor<Group>>(); }

  /// Removes the factors of one type for which `remove(factor)` holds; the others keep their order.
  /// @returns how many.
  template <Factor F, std::predicate<const F&> Remove>
  Index remove_factors(Remove&& remove) {
    return to_index(std::erase_if(std::get<std::vector<F>>(factors_), remove));
  }

  /// Calls visit(factor) for each factor, to change it in place; its keys stay.
  template <class Visit>
  void change_factors(Visit&& visit) {
    std::apply([&](auto&... pools) { (std::for_each(pools.begin(), pools.end(), visit), ...); }, factors_);
  }

  /// Calls visit(pool) with each type's `const std::vector<F>&`, in a fixed order.
  template <class Visit>
  void for_each_pool(Visit&& visit) const {
    std::apply([&](const auto&... pools) { (visit(pools), ...); }, factors_);
  }

  /// Calls visit(factor) for each factor, pool by pool.
  template <class Visit>
  void for_each_factor(Visit&& visit) const {
    for_each_pool([&](const auto& pool) {
      for (const auto& factor : pool) visit(factor);
    });
  }

  /// Number of factors.
  [[nodiscard]] Index factor_count() const {
    std::size_t count = 0;
    for_each_pool([&](const auto& pool) { count += pool.size(); });
    return to_index(count);
  }

  /// Sum of the squared whitened residuals (chi^2), through their kernels.
  [[nodiscard]] double cost(const Values<Group>& values) const {
    double sum = 0.0;
    for_each_factor([&](const auto& factor) {
      const double squared = factor.residual(values).squaredNorm();
      if constexpr (RobustFactor<std::remove_cvref_t<decltype(factor)>>) {
        sum += factor.kernel.cost(squared);
      } else {
        sum += squared;
      }
    });
    return sum;
  }
  [[nodiscard]] double cost() const { return cost(values_); }  ///< the same of the graph's own values

 private:
  void require_known(Key key) const {
    if (!values_.contains(key))
      throw std::invalid_argument("FactorGraph: there is no variable " + std::to_string(key) + ", only " +
                                  std::to_string(values_.size()));
  }

  Values<Group> values_;
  std::vector<char> fixed_;
  std::tuple<std::vector<PriorFactor<Group>>, std::vector<BetweenFactor<Group>>, std::vector<Extra>...> factors_;
};

/// Poses T_map_body and what was measured between them.
using PoseGraph = FactorGraph<SE3d>;

}  // namespace chainslam
