#include "simulator/terrain.hpp"

#include <cmath>
#include <numbers>

namespace chainslam::simulator {

Terrain::Terrain(double steepness, Rng rng) {
  for (Wave& wave : waves_) {
    const double direction = rng.uniform(0.0, 2.0 * std::numbers::pi);
    const double number = 2.0 * std::numbers::pi / rng.uniform(90.0, 260.0);
    wave.number = number * Eigen::Vector2d(std::cos(direction), std::sin(direction));
    wave.phase = rng.uniform(0.0, 2.0 * std::numbers::pi);
    wave.amplitude = steepness / number * rng.uniform(0.7, 1.3);
  }
}

double Terrain::height(const Eigen::Vector2d& position) const {
  double sum = 0.0;
  for (const Wave& wave : waves_) sum += wave.amplitude * std::sin(wave.number.dot(position) + wave.phase);
  return sum;
}

Eigen::Vector2d Terrain::slope(const Eigen::Vector2d& position) const {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  for (const Wave& wave : waves_)
    sum += wave.amplitude * std::cos(wave.number.dot(position) + wave.phase) * wave.number;
  return sum;
}

}  // namespace chainslam::simulator
