#include "datasets/ground_check.hpp"

#include <array>
#include <cmath>
#include <cstddef>

namespace chainslam::datasets {

GroundCheck find_ground(const PointCloud<float>& cloud) {
  constexpr double step = 0.25, top = 5;
  constexpr std::size_t steps = 40;  // of 0.25 m, from -5 m to 5 m
  struct Slab {
    std::size_t points = 0;
    double sum = 0;  // of heights
  };
  std::array<Slab, steps> levels{};
  std::size_t all = 0;
  for (const Eigen::Vector3f& p : cloud.positions) {
    const double distance = std::hypot(p.x(), p.y()), height = static_cast<double>(p.z());
    if (!(distance >= 3 && distance <= 30)) continue;
    ++all;
    const double level = (height + top) / step;
    if (!(level >= 0 && level < static_cast<double>(steps))) continue;
    Slab& slab = levels[static_cast<std::size_t>(level)];
    ++slab.points;
    slab.sum += height;
  }
  Slab below, above;
  for (std::size_t i = 0; i + 1 < steps; ++i) {
    const double middle = (static_cast<double>(i) + 1) * step - top;
    const Slab slab{levels[i].points + levels[i + 1].points, levels[i].sum + levels[i + 1].sum};
    Slab& side = middle < 0 ? below : above;
    if (std::abs(middle) >= 0.3 && slab.points > side.points) side = slab;
  }
  const bool is_below = below.points > above.points;
  const Slab& most = is_below ? below : above;
  const Slab& other = is_below ? above : below;
  if (all < 100 || most.points * 10 < all || most.points < 2 * other.points) return {};
  return {.side = is_below ? GroundSide::below : GroundSide::above,
          .height = most.sum / static_cast<double>(most.points),
          .share = static_cast<double>(most.points) / static_cast<double>(all)};
}

}  // namespace chainslam::datasets
