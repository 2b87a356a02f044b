#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cassert>
#include <concepts>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/concepts.hpp"

namespace chainslam {

/// Names a factor of an `IncrementalSmoother` for as long as it is there, and never another one after it.
struct FactorId {
  Index type = -1;        ///< which of the smoother's types of factors
  Index slot = -1;        ///< place in its pool
  Index generation = -1;  ///< how often the place was used before

  friend bool operator==(const FactorId&, const FactorId&) = default;  ///< whether all members are equal
};

/// Names a variable of a factor graph: its place in `Values`, in the order of adding, from 0.
using Key = Index;

/// The values of a factor graph's variables, all of one type, by key.
template <Manifold Group>
class Values {
 public:
  /// @returns the new variable's key.
  Key add(const Group& value) {
    const Key key = to_index(values_.size(), "number of variables");
    values_.push_back(value);
    return key;
  }

  /// Removes the variable that was added last.
  void drop_last() {
    assert(!values_.empty());
    values_.pop_back();
  }

  /// The value of a variable.
  [[nodiscard]] const Group& operator[](Key key) const {
    assert(contains(key));
    return values_[static_cast<std::size_t>(key)];
  }
  /// The value of a variable.
  [[nodiscard]] Group& operator[](Key key) {
    assert(contains(key));
    return values_[static_cast<std::size_t>(key)];
  }

  [[nodiscard]] bool contains(Key key) const { return key >= 0 && key < size(); }  ///< whether there is such a variable
  [[nodiscard]] Index size() const { return static_cast<Index>(values_.size()); }  ///< number of variables
  /// The first value; values come in the order of their keys.
  [[nodiscard]] auto begin() const { return values_.begin(); }
  [[nodiscard]] auto end() const { return values_.end(); }              ///< behind the last value
  [[nodiscard]] std::span<const Group> all() const { return values_; }  ///< all values, in the order of their keys

  friend bool operator==(const Values&, const Values&) = default;  ///< whether all members are equal

 private:
  std::vector<Group> values_;
};

namespace detail {

/// Ascending, each once.
inline void sort_unique(std::vector<Key>& keys) {
  std::sort(keys.data(), keys.data() + keys.size());  // by pointers, as all lists of indices
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
}

/// Where a key is in a short list; its size if it is not there.
[[nodiscard]] inline Index place_of(std::span<const Key> keys, Key key) {
  return static_cast<Index>(std::find(keys.data(), keys.data() + keys.size(), key) - keys.data());
}

}  // namespace detail

/// One thing for each of a factor's variables: in an array, or in a vector where their number is known only when the
/// program runs (`arity` is `std::dynamic_extent`, `rows` then `Eigen::Dynamic`).
template <class T, std::size_t Arity>
using PerVariable = std::conditional_t<Arity == std::dynamic_extent, std::vector<T>, std::array<T, Arity>>;

/// A factor's whitened residual and its derivatives with respect to right perturbations of its variables.
template <int Rows, int Dof, std::size_t Arity>
struct LinearizedFactor {
  Eigen::Matrix<double, Rows, 1> residual;                         ///< whitened
  PerVariable<Eigen::Matrix<double, Rows, Dof>, Arity> jacobians;  ///< one for each variable, `Rows` x `Dof`
};

/// A term of the cost: the squared length of a residual that depends on `arity` variables of type `Value`.
///
/// Laws:
/// - `keys()` are `arity` different variables;
/// - `residual(values)` has `rows` rows and is whitened: its covariance is the identity;
/// - `linearize(values)` gives that residual and its derivatives with respect to d in `values[key].retract(d)`;
/// - a member `kernel`, if there is one, models `RobustCost`: the term is then `kernel.cost(squared length)`;
/// - `F::visit_members(self, visit)`, if a graph of it is saved or appended, calls visit(members...), those of type
/// `Key`
///   or `std::vector<Key>` being its keys.
template <class F>
concept Factor = requires(const F& factor, const Values<typename F::Value>& values) {
  { factor.keys() } -> std::convertible_to<PerVariable<Key, F::arity>>;
  { factor.residual(values) } -> std::convertible_to<Eigen::Matrix<double, F::rows, 1>>;
  { factor.linearize(values) } -> std::same_as<LinearizedFactor<F::rows, F::Value::dof, F::arity>>;
};

/// A factor with a robust kernel.
template <class F>
concept RobustFactor = Factor<F> && requires(const F& factor) {
  requires RobustCost<std::remove_cvref_t<decltype(factor.kernel)>>;
};

}  // namespace chainslam
