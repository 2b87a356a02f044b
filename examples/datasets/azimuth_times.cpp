#include "datasets/azimuth_times.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace chainslam::datasets {

std::optional<std::vector<float>> times_by_azimuth(const PointCloud<float>& cloud, double period) {
  constexpr float nearest = 0.5F;   // metres from the axis: nearer points say nothing of the azimuth
  constexpr double backward = 0.1;  // turns: lasers of one firing look up to 13 degrees apart
  std::vector<double> turned;       // since the first point, signed
  turned.reserve(cloud.size());
  std::optional<double> last;
  double total = 0, low = 0, high = 0, fall = 0, rise = 0;
  for (const Eigen::Vector3f& p : cloud.positions) {
    const bool usable = p.head<2>().norm() > nearest;  // false for NaN
    if (usable) {
      const double azimuth =
          std::atan2(static_cast<double>(p.y()), static_cast<double>(p.x())) / (2 * std::numbers::pi);
      const double step = last ? azimuth - *last : 0;
      total += step - std::round(step);
      last = azimuth;
      low = std::min(low, total);
      high = std::max(high, total);
      fall = std::max(fall, high - total);
      rise = std::max(rise, total - low);
    }
    turned.push_back(total);
  }
  const bool clockwise = rise < fall;  // seen from above, falling azimuth
  if (std::min(rise, fall) > backward || std::max(rise, fall) < 0.7 || std::max(rise, fall) > 1.3) return std::nullopt;
  std::vector<float> times;
  times.reserve(turned.size());
  for (const double value : turned)
    times.push_back(static_cast<float>(period * std::clamp(clockwise ? -value : value, 0.0, 1.0)));
  return times;
}

}  // namespace chainslam::datasets
