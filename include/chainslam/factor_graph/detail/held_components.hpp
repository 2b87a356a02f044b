#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <type_traits>
#include <unordered_map>
#include <utility>
#include <vector>

#include "chainslam/core/jacobi_eigen.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"

namespace chainslam::detail {

/// Whether factors of this type hold their variables in place, as those on one variable do.
template <class F>
inline constexpr bool holds_in_place = [] {
  if constexpr (requires { F::holds_in_place; }) return static_cast<bool>(F::holds_in_place);
  return F::arity == 1;
}();

/// Makes independent columns orthonormal.
inline void orthonormalize(Eigen::MatrixXd& columns) {
  for (Eigen::Index k = 0; k < columns.cols(); ++k) {
    for (Eigen::Index other = 0; other < k; ++other)
      columns.col(k) -= columns.col(other).dot(columns.col(k)) * columns.col(other);
    columns.col(k).normalize();
  }
}

/// The directions that a symmetric positive semi-definite matrix says nothing about, orthonormal: compared on unit
/// diagonal, so that no unit makes another's information look like rounding.
template <int N>
[[nodiscard]] Eigen::MatrixXd null_directions(const Eigen::Matrix<double, N, N>& matrix, double rounding) {
  using Vector = Eigen::Matrix<double, N, 1>;
  const Vector scale = matrix.diagonal().unaryExpr([](double h) { return h > 0.0 ? 1.0 / std::sqrt(h) : 1.0; });
  const Eigen::Matrix<double, N, N> scaled = scale.asDiagonal() * matrix * scale.asDiagonal();
  const auto eigen = jacobi_eigen<double, N>(scaled);
  Eigen::Index count = 0;
  while (count < N && eigen.values[count] <= rounding) ++count;
  Eigen::MatrixXd null = scale.asDiagonal() * eigen.vectors.leftCols(count);
  orthonormalize(null);
  return null;
}

/// Turns right perturbations of a variable into tangents along the map's axes at its place.
template <class Group>
[[nodiscard]] FreePart free_part(Key key, Index variables, Key at, const Group& value, Eigen::MatrixXd directions) {
  FreePart part{key, variables, at, Group::dof, std::move(directions)};
  if constexpr (requires { value.rotation().matrix(), value.translation(); }) {
    const Eigen::MatrixXd R = value.rotation().matrix();
    part.translations = static_cast<int>(R.rows());
    part.directions.topRows(R.rows()).applyOnTheLeft(R);
    if (Group::dof == 2 * R.rows()) part.directions.bottomRows(R.rows()).applyOnTheLeft(R);
  }
  return part;
}

/// The connected parts of a growing graph, and what holds each of them in place. The least key names a part.
template <class Group>
class HeldComponents {
 public:
  using Information = typename Group::Jacobian;

  void clear() {
    parent_.clear();
    held_.clear();
    partial_.clear();
  }
  void add_variable() {
    parent_.push_back(to_index(parent_.size()));
    held_.push_back(0);
  }
  [[nodiscard]] Index size() const { return to_index(parent_.size()); }

  /// Near-constant time by path halving (Tarjan and van Leeuwen 1984).
  [[nodiscard]] Key find(Key key) {
    while (at(key) != key) key = at(key) = at(at(key));
    return key;
  }
  void join(Key a, Key b) {
    a = find(a);
    b = find(b);
    if (a == b) return;
    if (b < a) std::swap(a, b);
    at(b) = a;
    if (held_[static_cast<std::size_t>(b)] != 0) hold(a);
    const auto other = partial_.find(b);
    if (other == partial_.end()) return;
    const Partial partial = other->second;
    partial_.erase(other);
    hold(a, partial);
  }
  template <class Keys>
  void connect(const Keys& keys) {
    for (const Key key : keys) join(*keys.begin(), key);
  }
  /// Joins what a factor ties together, and takes in what it says of a motion of all of that as one body.
  template <Factor F>
  void connect(const F& factor, const Values<Group>& values) {
    const auto keys = factor.keys();
    connect(keys);
    if constexpr (holds_in_place<F>) {
      if (keys.size() == 0 || is_held(*keys.begin())) return;
      hold(*keys.begin(), partial_hold(factor, values));
    }
  }
  /// Says that something holds the part of a variable in place.
  void hold(Key key) {
    key = find(key);
    held_[static_cast<std::size_t>(key)] = 1;
    partial_.erase(key);
  }
  [[nodiscard]] bool is_held(Key key) { return held_[static_cast<std::size_t>(find(key))] != 0; }

  /// The least key of each part that is not held in all directions.
  [[nodiscard]] std::vector<Key> floating() {
    std::vector<Key> keys;
    for (Key key = 0; key < size(); ++key) {
      if (find(key) == key && !is_held(key)) keys.push_back(key);
    }
    return keys;
  }
  /// How those parts can move. Linear in the number of variables.
  [[nodiscard]] std::vector<FreePart> free_parts(const std::vector<Key>& floating, const Values<Group>& values) {
    std::vector<Index> sizes(parent_.size(), 0);
    for (Key key = 0; key < size(); ++key) ++sizes[static_cast<std::size_t>(find(key))];
    std::vector<FreePart> parts;
    for (const Key key : floating) {
      const auto held = partial_.find(key);
      const Index variables = sizes[static_cast<std::size_t>(key)];
      if (held == partial_.end()) {
        parts.push_back(free_part(key, variables, key, values[key], Information::Identity()));
      } else {
        const Partial& partial = held->second;
        parts.push_back(free_part(key, variables, partial.at, partial.value, free_directions(partial.information)));
      }
    }
    return parts;
  }

 private:
  /// What is known of a motion of the whole part from the left, as the right perturbation of one of its variables.
  struct Partial {
    Key at;
    Group value;
    Information information;
  };

  [[nodiscard]] Key& at(Key key) { return parent_[static_cast<std::size_t>(key)]; }

  [[nodiscard]] static Eigen::MatrixXd free_directions(const Information& information) {
    return null_directions<Group::dof>(information, 1e-12);
  }

  void hold(Key key, const Partial& partial) {
    key = find(key);
    if (is_held(key)) return;
    const auto [place, added] = partial_.try_emplace(key, partial);
    if (!added) {
      // exp(xi) x is x exp(Ad(x^-1) xi)
      const Information turn = (partial.value.inverse() * place->second.value).adjoint();
      place->second.information += turn.transpose() * partial.information * turn;
    }
    // What is not a number is left for the numbers to find.
    if (!place->second.information.allFinite() || free_directions(place->second.information).cols() == 0) hold(key);
  }

  template <Factor F>
  [[nodiscard]] static Partial partial_hold(const F& factor, const Values<Group>& values) {
    const auto linearized = factor.linearize(values);
    const auto keys = factor.keys();
    const Group& value = values[*keys.begin()];
    Eigen::Matrix<double, F::rows, Group::dof> sum = linearized.jacobians[0];
    Eigen::Matrix<double, F::rows, Group::dof> size = sum.cwiseAbs();
    for (std::size_t k = 1; k < keys.size(); ++k) {
      const Eigen::Matrix<double, F::rows, Group::dof> more =
          linearized.jacobians[k] * (values[keys[k]].inverse() * value).adjoint();
      sum += more;
      size += more.cwiseAbs();
    }
    sum = (sum.array().abs() < 1e-8 * size.array()).select(0.0, sum);  // rounding where they cancel
    return {*keys.begin(), value, sum.transpose() * sum};
  }

  std::vector<Key> parent_;
  std::vector<char> held_;
  std::unordered_map<Key, Partial> partial_;  ///< of parts that are held in some directions, by their least key
};

/// The connected parts of a graph that neither a fixed variable nor a factor that holds its variables ties down, be it
/// in some directions only.
template <class Graph>
[[nodiscard]] HeldComponents<typename Graph::Value> components_of(const Graph& graph) {
  HeldComponents<typename Graph::Value> components;
  for (Key key = 0; key < graph.values().size(); ++key) components.add_variable();
  graph.for_each_factor([&](const auto& factor) {
    components.connect(factor.keys());
    if constexpr (holds_in_place<std::remove_cvref_t<decltype(factor)>>) components.hold(*factor.keys().begin());
  });
  for (Key key = 0; key < graph.values().size(); ++key) {
    if (graph.is_fixed(key)) components.hold(key);
  }
  return components;
}

/// The least key of each of them.
template <class Graph>
[[nodiscard]] std::vector<Key> floating_components(const Graph& graph) {
  return components_of(graph).floating();
}

}  // namespace chainslam::detail
