#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/linearization.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"

namespace chainslam::detail {

/// Makes independent columns orthonormal.
inline void orthonormalize(Eigen::MatrixXd& columns) {
  const Eigen::Index rows = columns.rows();
  const auto dot = [&](const double* a, const double* b) { return std::inner_product(a, a + rows, b, 0.0); };
  for (Eigen::Index k = 0; k < columns.cols(); ++k) {
    double* const column = columns.data() + k * rows;
    for (const double* other = columns.data(); other != column; other += rows) {
      const double along = dot(other, column);
      for (Eigen::Index row = 0; row < rows; ++row) column[row] -= along * other[row];
    }
    const double length = std::sqrt(dot(column, column));
    if (length > 0.0) std::transform(column, column + rows, column, [&](double x) { return x / length; });
  }
}

/// The eigenvectors of the least eigenvalues of a symmetric matrix, up to `largest`, each row times `scale`;
/// orthonormal.
template <int N>
[[nodiscard]] Eigen::MatrixXd least_directions(const Eigen::Matrix<double, N, N>& matrix, double largest,
                                               const Eigen::Matrix<double, N, 1>& scale) {
  const auto eigen = jacobi_eigen<double, N>(matrix);
  Eigen::Index count = 0;
  while (count < N && eigen.values[count] <= largest) ++count;
  Eigen::MatrixXd directions(N, count);
  for (Eigen::Index k = 0; k < N * count; ++k) directions.data()[k] = scale[k % N] * eigen.vectors.data()[k];
  orthonormalize(directions);
  return directions;
}

/// The directions that a symmetric positive semi-definite matrix says nothing about, orthonormal: compared on unit
/// diagonal, so that no unit makes another's information look like rounding.
template <int N>
[[nodiscard]] Eigen::MatrixXd null_directions(const Eigen::Matrix<double, N, N>& matrix, double rounding) {
  Eigen::Matrix<double, N, 1> scale;
  for (int k = 0; k < N; ++k) scale[k] = matrix(k, k) > 0.0 ? 1.0 / std::sqrt(matrix(k, k)) : 1.0;
  Eigen::Matrix<double, N, N> scaled;
  for (int column = 0; column < N; ++column) {
    for (int row = 0; row < N; ++row) scaled(row, column) = scale[row] * matrix(row, column) * scale[column];
  }
  return least_directions<N>(scaled, rounding, scale);
}

/// Turns right perturbations of a variable into tangents along the map's axes at its place.
template <class Group>
[[nodiscard]] FreePart free_part(Key key, Index variables, Key at, const Group& value, Eigen::MatrixXd directions) {
  FreePart part{key, variables, at, Group::dof, std::move(directions)};
  if constexpr (requires { value.rotation().matrix(), value.translation(); }) {
    const auto R = value.rotation().matrix();
    constexpr int axes = decltype(R)::RowsAtCompileTime;
    part.translations = axes;
    const auto turn = [&](double* vector) {
      const auto before = matrix_of<Eigen::Matrix<double, axes, 1>>(vector);
      for (int row = 0; row < axes; ++row) {
        vector[row] = 0.0;
        for (int k = 0; k < axes; ++k) vector[row] += R(row, k) * before[k];
      }
    };
    for (Eigen::Index k = 0; k < part.directions.cols(); ++k) {
      double* const direction = part.directions.data() + k * Group::dof;
      turn(direction);
      if constexpr (Group::dof == 2 * axes) turn(direction + axes);
    }
  }
  return part;
}

/// The connected parts of a growing graph, and what holds each of them in place. The least key names a part.
template <class Group>
class HeldComponents {
 public:
  static constexpr std::size_t dof = Group::dof;
  using Information = typename Group::Jacobian;

  /// In place of the number of the one factor that holds a part.
  static constexpr Index nothing = -1, several = -2;

  void clear() {
    parent_.clear();
    holder_.clear();
    partial_of_.clear();
    partial_.clear();
  }
  void add_variable() {
    parent_.push_back(to_index(parent_.size()));
    holder_.push_back(nothing);
    partial_of_.push_back(-1);
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
    if (holder_[b] != nothing) hold(a, holder_[b]);
    const Index other = partial_of_[b];
    if (other == -1) return;
    const Partial partial = partial_[other];
    drop_partial(b);
    hold(a, partial, several);
  }
  template <class Keys>
  void connect(const Keys& keys) {
    for (const Key key : keys) join(*keys.begin(), key);
  }
  /// Takes in what a factor says of a motion of all its variables, which are connected, as one body.
  /// @param numbers  as `write_linearization` writes them.
  /// @param holder   the factor's number.
  void hold(std::span<const Key> keys, Index rows, const double* numbers, const Values<Group>& values, Index holder) {
    hold(keys.front(), partial_hold(keys, rows, numbers, values), holder);
  }
  /// Says that something holds the part of a variable in place. The first that does is its holder.
  void hold(Key key, Index holder = several) {
    key = find(key);
    if (holder_[key] == nothing) holder_[key] = holder;
    drop_partial(key);
  }
  [[nodiscard]] bool is_held(Key key) { return holder(key) != nothing; }
  /// The number of the one factor that alone holds the part of a variable, if there is one; else `nothing` or
  /// `several`.
  [[nodiscard]] Index holder(Key key) { return holder_[find(key)]; }

  /// The least key of each part that is not held in all directions.
  [[nodiscard]] std::vector<Key> floating() {
    std::vector<Key> keys;
    for (Key key = 0; key < size(); ++key) {
      if (find(key) == key && !is_held(key)) keys.push_back(key);
    }
    return keys;
  }
  /// How those parts can move. Linear in the number of variables.
  [[nodiscard]] [[gnu::cold]] std::vector<FreePart> free_parts(const std::vector<Key>& floating,
                                                               const Values<Group>& values) {
    Table<Index> sizes(parent_.size(), 0);
    for (Key key = 0; key < size(); ++key) ++sizes[find(key)];
    std::vector<FreePart> parts;
    for (const Key key : floating) {
      const Index held = partial_of_[key];
      const Partial partial = held == -1 ? Partial{key, key, values[key], zeros<Information>()} : partial_[held];
      parts.push_back(free_part(key, sizes[key], partial.at, partial.value, free_directions(partial.information)));
    }
    return parts;
  }

 private:
  /// What is known of a motion of the whole part from the left, as the right perturbation of one of its variables.
  struct Partial {
    Key part;  ///< its least key
    Key at;
    Group value;
    Information information;
  };

  [[nodiscard]] Key& at(Key key) { return parent_[key]; }

  [[nodiscard]] static Eigen::MatrixXd free_directions(const Information& information) {
    return null_directions<Group::dof>(information, 1e-12);
  }

  /// @param holder  the number of the factor that says so, `several` if it is not one.
  void hold(Key key, const Partial& partial, Index holder) {
    key = find(key);
    if (is_held(key)) return;
    if (partial_of_[key] == -1) {
      partial_of_[key] = static_cast<Index>(partial_.size());
      partial_.push_back(partial);
      partial_.back().part = key;
    } else {
      holder = several;
      // exp(xi) x is x exp(Ad(x^-1) xi)
      Partial& known = partial_[partial_of_[key]];
      const Information turn = (partial.value.inverse() * known.value).adjoint();
      known.information = sum_of(known.information, transposed_product(turn, product(partial.information, turn)));
    }
    // What is not a number is left for the numbers to find.
    const Information& information = partial_[partial_of_[key]].information;
    bool finite = true;
    for (std::size_t k = 0; k < dof * dof; ++k) finite = finite && std::isfinite(information.data()[k]);
    if (!finite || free_directions(information).cols() == 0) hold(key, holder);
  }
  /// The last takes its place.
  void drop_partial(Key key) {
    const Index place = std::exchange(partial_of_[key], -1);
    if (place == -1) return;
    if (place + 1 < partial_.size()) {
      partial_[place] = partial_.back();
      partial_of_[partial_.back().part] = place;
    }
    partial_.pop_back();
  }

  [[nodiscard]] static Partial partial_hold(std::span<const Key> keys, Index rows, const double* numbers,
                                            const Values<Group>& values) {
    const Group& value = values[keys.front()];
    Table<Information> turns;  // of each variable, as a motion of the first one turns it
    for (const Key key : keys) turns.push_back((values[key].inverse() * value).adjoint());
    Partial partial{-1, keys.front(), value, zeros<Information>()};
    for (Index row = 0; row < rows; ++row) {
      std::array<double, dof> sum{}, size{};
      for (const Information& turn : turns) {
        for (std::size_t column = 0; column < dof; ++column) {
          const double* const of_column = turn.data() + column * dof;
          const double part = std::inner_product(numbers, numbers + dof, of_column, 0.0);
          sum[column] += part;
          size[column] += std::abs(part);
        }
        numbers += dof;
      }
      for (std::size_t k = 0; k < dof; ++k) {
        if (std::abs(sum[k]) < 1e-8 * size[k]) sum[k] = 0.0;  // rounding where they cancel
      }
      for (std::size_t k = 0; k < dof * dof; ++k) partial.information.data()[k] += sum[k % dof] * sum[k / dof];
    }
    return partial;
  }

  Table<Key> parent_;
  Table<Index> holder_;      ///< of each part's least key
  Table<Index> partial_of_;  ///< of each part's least key: its place in `partial_`, or -1
  Table<Partial> partial_;   ///< of parts that are held in some directions
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
