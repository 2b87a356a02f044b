#include "datasets/ground_check.hpp"

#include <array>
#include <cmath>
#include <cstddef>

namespace chainslam::datasets {

GroundCheck find_ground(const PointCloud<float>& cloud) {
  constexpr double step = 0.25, top = 5;
  constexpr std::size_t steps = 40;  // of 0.25 m, from -5 m to 5 m
  std::array<std::size_t, steps> levels{};
  std::size_t all = 0;
  for (const Eigen::Vector3f& p : cloud.positions) {
    const double distance = std::hypot(p.x(), p.y());
    if (!(distance >= 3 && distance <= 30)) continue;
    ++all;
    const double level = (static_cast<double>(p.z()) + top) / step;
    if (level >= 0 && level < static_cast<double>(steps)) ++levels[static_cast<std::size_t>(level)];
  }
  struct Slab {
    std::size_t points = 0;
    double height = 0;
  } below, above;
  for (std::size_t i = 0; i + 1 < steps; ++i) {
    const double height = (static_cast<double>(i) + 1) * step - top;
    const std::size_t points = levels[i] + levels[i + 1];
    Slab& side = height < 0 ? below : above;
    if (std::abs(height) >= 0.3 && points > side.points) side = {points, height};
  }
  const bool is_below = below.points > above.points;
  const Slab& most = is_below ? below : above;
  const Slab& other = is_below ? above : below;
  if (all < 100 || most.points * 10 < all || most.points < 2 * other.points) return {};
  return {.side = is_below ? GroundSide::below : GroundSide::above,
          .height = most.height,
          .share = static_cast<double>(most.points) / static_cast<double>(all)};
}

}  // namespace chainslam::datasets
