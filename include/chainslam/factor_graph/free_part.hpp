#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <numeric>
#include <string>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam {

/// A part of a graph with unconstrained directions, and which these are.
struct FreePart {
  Key key = 0;           ///< its least variable
  Index variables = 0;   ///< how many move
  Key at = 0;            ///< one of them, whose motions `directions` are
  int translations = 0;  ///< rows of `directions` that translate; the others rotate
  /// A column for each independent motion, orthonormal: tangents along the map's axes, at the place of `at`.
  Eigen::MatrixXd directions;
};

namespace detail {

[[nodiscard]] inline std::string axis_name(const FreePart& part, int axis) {
  constexpr std::array<const char*, 3> along{"x", "y", "z"};
  constexpr std::array<const char*, 3> about{"roll", "pitch", "yaw"};
  const int rotations = static_cast<int>(part.directions.rows()) - part.translations;
  if (axis < part.translations)
    return axis < 3 ? along[static_cast<std::size_t>(axis)] : "coordinate " + std::to_string(axis);
  return rotations == 1 ? "heading" : about[static_cast<std::size_t>(axis - part.translations) % 3];
}

/// "(0.6 0 -0.8; 0 0 0.1)"
[[nodiscard]] inline std::string direction_text(const FreePart& part, const double* direction) {
  std::string text = "(";
  for (Eigen::Index k = 0; k < part.directions.rows(); ++k) {
    std::array<char, 32> number{};
    std::snprintf(number.data(), number.size(), "%.2g", std::abs(direction[k]) < 1e-6 ? 0.0 : direction[k]);
    text += (k == 0 ? "" : k == part.translations ? "; " : " ") + std::string(number.data());
  }
  return text + ")";
}

}  // namespace detail

/// In words: "variable 17 (312 variables) is free in translation and yaw (4 directions)". Motions along no axis are
/// written as tangents, [translation; rotation].
[[nodiscard]] inline std::string describe(const FreePart& part) {
  constexpr double rounding = 1e-6;
  const auto rows = part.directions.rows();
  std::string text;
  const auto append = [&](const std::string& more) { text += (text.empty() ? "" : ", ") + more; };
  const auto motions = part.directions.cols();
  Eigen::MatrixXd rest = part.directions;
  const auto dot = [&](const double* a, const double* b) { return std::inner_product(a, a + rows, b, 0.0); };
  const auto name_axes = [&](Eigen::Index begin, Eigen::Index end, const char* all) {
    std::string names;
    Eigen::Index count = 0;
    for (Eigen::Index axis = begin; axis < end; ++axis) {
      double along = 0.0;  // how much of the axis the motions cover
      for (Eigen::Index k = 0; k < motions; ++k) along += part.directions(axis, k) * part.directions(axis, k);
      if (along < 1.0 - rounding) continue;
      for (Eigen::Index k = 0; k < motions; ++k) rest(axis, k) = 0.0;
      names += (count++ == 0 ? "" : ", ") + detail::axis_name(part, static_cast<int>(axis));
    }
    if (count > 0) append(count == end - begin && count > 1 ? all : names);
  };
  name_axes(0, part.translations, "translation");
  name_axes(part.translations, rows, "rotation");
  for (Eigen::Index k = 0; k < motions; ++k) {  // what is left, orthonormal again
    double* const direction = rest.data() + k * rows;
    for (const double* other = rest.data(); other != direction; other += rows) {
      const double along = dot(other, direction);
      for (Eigen::Index row = 0; row < rows; ++row) direction[row] -= along * other[row];
    }
    const double length = std::sqrt(dot(direction, direction));
    for (Eigen::Index row = 0; row < rows; ++row) direction[row] = length < rounding ? 0.0 : direction[row] / length;
    if (length >= rounding) append(detail::direction_text(part, direction));
  }
  const std::string of = part.variables == 1 ? "" : " (" + std::to_string(part.variables) + " variables)";
  const std::string place = part.at == part.key ? "" : ", as seen at variable " + std::to_string(part.at);
  return "variable " + std::to_string(part.key) + of + " is free in " + text + " (" + std::to_string(motions) +
         (motions == 1 ? " direction" : " directions") + place + ")";
}

}  // namespace chainslam
