#include "simulator/street_grid.hpp"

#include <stdexcept>

namespace chainslam::simulator {

namespace {

/// Places of `count` lines, irregularly spaced, their middle at zero.
std::vector<double> line_places(Index count, const StreetOptions& options, Rng& rng) {
  std::vector<double> places{0.0};
  for (Index i = 1; i < count; ++i)
    places.push_back(places.back() +
                     options.block * rng.uniform(1.0 - options.irregularity, 1.0 + options.irregularity));
  const double middle = 0.5 * places.back();
  for (double& place : places) place -= middle;
  return places;
}

}  // namespace

StreetGrid::StreetGrid(const StreetOptions& options, Rng rng) : options_(options) {
  if (options.columns < 2 || options.rows < 2)
    throw std::invalid_argument("StreetGrid: a town needs at least 2 x 2 crossings");
  const std::vector<double> x = line_places(options.columns, options, rng);
  const std::vector<double> y = line_places(options.rows, options, rng);
  for (const double north : y)
    for (const double east : x) {
      const double dx = rng.uniform(-options.jitter, options.jitter);
      const double dy = rng.uniform(-options.jitter, options.jitter);
      crossings_.emplace_back(east + dx, north + dy);
    }
}

Eigen::Vector2d StreetGrid::position(Crossing crossing) const {
  if (crossing.column < 0 || crossing.column >= options_.columns || crossing.row < 0 || crossing.row >= options_.rows)
    throw std::invalid_argument("StreetGrid: no such crossing");
  return crossings_[static_cast<std::size_t>(crossing.row * options_.columns + crossing.column)];
}

std::vector<Street> StreetGrid::streets() const {
  std::vector<Street> streets;
  for (Index row = 0; row < options_.rows; ++row)
    for (Index column = 0; column < options_.columns; ++column) {
      const Eigen::Vector2d here = position({column, row});
      if (column + 1 < options_.columns) streets.push_back({here, position({column + 1, row})});
      if (row + 1 < options_.rows) streets.push_back({here, position({column, row + 1})});
    }
  return streets;
}

}  // namespace chainslam::simulator
