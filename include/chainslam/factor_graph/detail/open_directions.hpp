#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/held_components.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/sparse/concepts.hpp"

namespace chainslam::detail {

/// Finds the motions that factors leave open although they tie all together, once a factorization has failed.
///
/// Variables whose pivots are bad are held by springs as stiff as their own factors, one after another, until the
/// factorization succeeds. What then resists a motion of such a variable by its spring alone is open; the others move
/// as the solution of a pull along it says.
/// @tparam System  linearized factors, with `size`, `key`, `diagonal`, `factorize` and `solve`, as `SpringedSystem`.
template <class System>
class OpenDirections {
  static constexpr int Dof = System::dof;

 public:
  using Matrix = Eigen::Matrix<double, Dof, Dof>;
  using Vector = Eigen::Matrix<double, Dof, 1>;

  /// How variables can move together.
  struct Open {
    Index column;                ///< of the one whose motions `directions` are
    Eigen::MatrixXd directions;  ///< orthonormal
    Index least = -1;            ///< the first column that moves along
    Index moving = 0;            ///< how many do
  };

  explicit OpenDirections(System& system) : system_(system), damping_(row(system.size()), 0.0), diagonal_(damping_) {
    system_.diagonal(diagonal_);
  }

  /// Calls `found(part)` for each.
  template <class Found>
  [[gnu::cold]] void find(Found&& found) {
    Table<Index> held;
    for (;;) {
      const FactorizationResult result = system_.factorize(damping_);
      if (result.ok()) break;
      if (held.size() == most_parts || damping_[row(result.block_column)] != 0.0) return;
      held.push_back(result.block_column);
      for (std::size_t k = 0; k < Dof; ++k) {
        const double stiffness = diagonal_[row(result.block_column) + k];
        damping_[row(result.block_column) + k] = stiffness > 0.0 ? stiffness : 1.0;
      }
    }
    for (const Index column : held) {
      Open open{column, directions_at(column)};
      if (open.directions.cols() == 0) continue;
      find_moving(open);
      found(std::move(open));
    }
  }

 private:
  static constexpr Offset most_parts = 16;
  static constexpr double rounding = 1e-11;  ///< of a variable's information

  [[nodiscard]] static std::size_t row(Index column) { return static_cast<std::size_t>(Offset{column} * Dof); }

  [[nodiscard]] [[gnu::cold]] Eigen::MatrixXd directions_at(Index column) {
    // In units of the springs: 1 where nothing else resists.
    Vector root, inverse;
    for (int k = 0; k < Dof; ++k) {
      root[k] = std::sqrt(damping_[row(column) + static_cast<std::size_t>(k)]);
      inverse[k] = 1.0 / root[k];
    }
    Matrix give;
    for (int k = 0; k < Dof; ++k) {
      auto pull = zeros<Vector>();
      pull[k] = root[k];
      const std::vector<double> moved = system_.solve(column, pull.data());
      for (int r = 0; r < Dof; ++r) give(r, k) = root[r] * moved[row(column) + static_cast<std::size_t>(r)];
    }
    Matrix resists;
    for (int c = 0; c < Dof; ++c) {
      for (int r = 0; r < Dof; ++r) resists(r, c) = (r == c ? 1.0 : 0.0) - 0.5 * (give(r, c) + give(c, r));
    }
    return least_directions<Dof>(resists, rounding, inverse);
  }

  /// The variables that move along.
  [[gnu::cold]] void find_moving(Open& open) {
    std::vector<double> moved(damping_.size(), 0.0);
    for (Eigen::Index k = 0; k < open.directions.cols(); ++k) {
      Vector pull;
      for (int r = 0; r < Dof; ++r)
        pull[r] = damping_[row(open.column) + static_cast<std::size_t>(r)] * open.directions(r, k);
      const std::vector<double> step = system_.solve(open.column, pull.data());
      for (std::size_t i = 0; i < step.size(); ++i) moved[i] += std::abs(step[i]);
    }
    for (Index other = system_.size() - 1; other >= 0; --other) {
      const double* const of_other = moved.data() + row(other);
      if (*std::max_element(of_other, of_other + Dof) < 1e-6) continue;
      ++open.moving;
      open.least = other;
    }
  }

  System& system_;
  std::vector<double> damping_;
  std::vector<double> diagonal_;
};

/// In terms of a graph's variables.
template <class System, class Group>
[[nodiscard]] std::vector<FreePart> open_parts(System&& system, const Values<Group>& values) {
  std::vector<FreePart> parts;
  using Directions = OpenDirections<std::remove_cvref_t<System>>;
  Directions(system).find([&](typename Directions::Open&& open) {
    const Key at = system.key(open.column);
    const Key least = open.least == -1 ? -1 : system.key(open.least);
    parts.push_back(free_part(least, open.moving, at, values[at], std::move(open.directions)));
  });
  return parts;
}

}  // namespace chainslam::detail
