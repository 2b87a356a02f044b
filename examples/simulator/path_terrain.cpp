#include "simulator/path_terrain.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace chainslam::simulator {

namespace {

constexpr double road_reach = 14.0;      // metres: how far a sample of the path says what the road is like
constexpr double distance_reach = 60.0;  // metres
constexpr double most_samples = 64e6;    // of the ground

std::size_t place_of(Index column, Index row, Index columns) {
  return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) + static_cast<std::size_t>(column);
}

/// Fills in what has little weight from a grid of half the resolution, which is filled in the same way.
void push_and_pull(std::vector<float>& values, std::vector<float>& weights, Index columns, Index rows) {
  if (columns <= 2 && rows <= 2) return;
  const Index half_columns = (columns + 1) / 2, half_rows = (rows + 1) / 2;
  std::vector<float> sums(static_cast<std::size_t>(half_columns) * static_cast<std::size_t>(half_rows), 0.0F);
  std::vector<float> totals = sums;
  for (Index row = 0; row < rows; ++row)
    for (Index column = 0; column < columns; ++column) {
      const std::size_t fine = place_of(column, row, columns), coarse = place_of(column / 2, row / 2, half_columns);
      sums[coarse] += std::min(1.0F, weights[fine]) * values[fine];
      totals[coarse] += std::min(1.0F, weights[fine]);
    }
  for (std::size_t i = 0; i < sums.size(); ++i) sums[i] = totals[i] > 0.0F ? sums[i] / totals[i] : 0.0F;
  push_and_pull(sums, totals, half_columns, half_rows);
  for (Index row = 0; row < rows; ++row)
    for (Index column = 0; column < columns; ++column) {
      const float x = 0.5F * static_cast<float>(column) - 0.25F, y = 0.5F * static_cast<float>(row) - 0.25F;
      const Index left = std::clamp(static_cast<Index>(std::floor(x)), Index{0}, std::max(Index{0}, half_columns - 2));
      const Index low = std::clamp(static_cast<Index>(std::floor(y)), Index{0}, std::max(Index{0}, half_rows - 2));
      const float u = std::clamp(x - static_cast<float>(left), 0.0F, 1.0F);
      const float v = std::clamp(y - static_cast<float>(low), 0.0F, 1.0F);
      const Index right = std::min(left + 1, half_columns - 1), high = std::min(low + 1, half_rows - 1);
      const float filled =
          (1 - v) * ((1 - u) * sums[place_of(left, low, half_columns)] + u * sums[place_of(right, low, half_columns)]) +
          v * ((1 - u) * sums[place_of(left, high, half_columns)] + u * sums[place_of(right, high, half_columns)]);
      const std::size_t fine = place_of(column, row, columns);
      const float own = std::min(1.0F, weights[fine]);
      values[fine] = own * values[fine] + (1.0F - own) * filled;
      weights[fine] = 1.0F;
    }
}

double smooth_step(double x) {
  const double t = std::clamp(x, 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

}  // namespace

PathTerrain::PathTerrain(const DrivenPath& path, const GroundOptions& options, const Rng& rng)
    : options_(options), relief_(options.steepness, rng.fork(0)) {
  Eigen::AlignedBox2d area;
  for (const PathSample& sample : path.samples()) area.extend(sample.position());
  origin_ = (area.min().array() - options.border).floor();
  const Eigen::Vector2d size = (area.max().array() + options.border).ceil().matrix() - origin_;
  for (int doubled = 0; size.prod() / (options_.spacing * options_.spacing) > most_samples; ++doubled) {
    if (doubled == 1) throw std::invalid_argument("PathTerrain: the trajectory spreads over too large an area");
    options_.spacing *= 2.0;
  }
  columns_ = static_cast<Index>(size.x()) + 1;
  rows_ = static_cast<Index>(size.y()) + 1;
  const std::size_t samples = place_of(0, rows_, columns_);
  heights_.assign(samples, 0.0F);
  distances_.assign(samples, static_cast<float>(distance_reach));
  std::vector<float> weights(samples, 0.0F);
  lay_road(path, weights);
  for (std::size_t i = 0; i < samples; ++i)
    if (weights[i] > 0.0F) heights_[i] /= weights[i];
  // A place at the edge of the road's reach, 1e-4 of the weight of one on it, is still the road's by a half.
  for (float& weight : weights) weight *= 2e3F;
  push_and_pull(heights_, weights, columns_, rows_);
}

void PathTerrain::lay_road(const DrivenPath& path, std::vector<float>& weights) {
  for (std::size_t i = 0; i < path.samples().size(); ++i) {
    const PathSample& sample = path.samples()[i];
    const double reach = i % 8 == 0 ? distance_reach : road_reach;  // what is far needs no half metres
    const Eigen::Vector2d center = sample.position() - origin_;
    const auto from = [&](double value) { return std::max(Index{0}, static_cast<Index>(std::ceil(value - reach))); };
    const auto to = [&](double value, Index count) {
      return std::min(count - 1, static_cast<Index>(std::floor(value + reach)));
    };
    for (Index row = from(center.y()); row <= to(center.y(), rows_); ++row)
      for (Index column = from(center.x()); column <= to(center.x(), columns_); ++column) {
        const Eigen::Vector2d offset = Eigen::Vector2d(column, row) - center;
        const double squared = offset.squaredNorm();
        const std::size_t place = place_of(column, row, columns_);
        distances_[place] = std::min(distances_[place], static_cast<float>(std::sqrt(squared)));
        const double left = 1.0 - squared / (road_reach * road_reach);
        if (left <= 0.0) continue;
        const double weight = left * left / ((squared + 0.25) * (squared + 0.25));
        weights[place] += static_cast<float>(weight);
        heights_[place] += static_cast<float>(weight * (sample.ground.z() + sample.slope.dot(offset)));
      }
  }
}

double PathTerrain::interpolate(const std::vector<float>& values, const Eigen::Vector2d& position) const {
  const Eigen::Vector2d local = position - origin_;
  const Index column = std::clamp(static_cast<Index>(std::floor(local.x())), Index{0}, columns_ - 2);
  const Index row = std::clamp(static_cast<Index>(std::floor(local.y())), Index{0}, rows_ - 2);
  const double u = std::clamp(local.x() - column, 0.0, 1.0), v = std::clamp(local.y() - row, 0.0, 1.0);
  const auto value = [&](Index x, Index y) {
    return static_cast<double>(values[place_of(column + x, row + y, columns_)]);
  };
  return (1 - v) * ((1 - u) * value(0, 0) + u * value(1, 0)) + v * ((1 - u) * value(0, 1) + u * value(1, 1));
}

double PathTerrain::height(const Eigen::Vector2d& position) const { return interpolate(heights_, position); }

double PathTerrain::distance(const Eigen::Vector2d& position) const { return interpolate(distances_, position); }

double PathTerrain::surface(const Eigen::Vector2d& position) const {
  const double off_road = distance(position) - options_.half_road;
  const double away = smooth_step((off_road - options_.pavement) / 30.0);
  return height(position) + (off_road > 0.0 ? options_.kerb : 0.0) + away * relief_.height(position);
}

HeightField PathTerrain::lay_ground(Rng rng) const {
  HeightField ground;
  ground.origin = origin_.cast<float>();
  ground.spacing = static_cast<float>(options_.spacing);
  ground.columns = static_cast<Index>((columns_ - 1) / options_.spacing) + 1;
  ground.rows = static_cast<Index>((rows_ - 1) / options_.spacing) + 1;
  const std::size_t samples = ground.at(0, ground.rows);
  ground.heights.reserve(samples);
  ground.materials.reserve(samples);
  for (Index row = 0; row < ground.rows; ++row)
    for (Index column = 0; column < ground.columns; ++column) {
      const Eigen::Vector2d position = origin_ + options_.spacing * Eigen::Vector2d(column, row);
      const double off_road = distance(position) - options_.half_road;
      const bool paved = off_road < options_.pavement;
      const double unevenness = rng.uniform(-1.0, 1.0) * (off_road < 0.0 ? 0.006 : paved ? 0.01 : 0.05);
      ground.heights.push_back(static_cast<float>(surface(position) + unevenness));
      ground.materials.push_back(off_road < 0.0 ? Material::road : paved ? Material::pavement : Material::lawn);
    }
  return ground;
}

}  // namespace chainslam::simulator
