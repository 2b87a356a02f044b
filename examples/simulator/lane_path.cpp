#include "simulator/lane_path.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace chainslam::simulator {

namespace {

constexpr double sample_distance = 0.1;  // metres

Eigen::Vector2d right_of(const Eigen::Vector2d& direction) { return {direction.y(), -direction.x()}; }

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// Start, the points where the lanes of successive streets meet, and end.
std::vector<Eigen::Vector2d> lane_corners(const StreetGrid& streets, const Route& route, double lane) {
  std::vector<Eigen::Vector2d> nodes;
  for (const Crossing& crossing : route) nodes.push_back(streets.position(crossing));
  nodes.front() = 0.5 * (nodes[0] + nodes[1]);
  nodes.back() = 0.5 * (nodes[nodes.size() - 2] + nodes.back());

  std::vector<Eigen::Vector2d> corners;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const Eigen::Vector2d before =
        (nodes[std::max<std::size_t>(i, 1)] - nodes[std::max<std::size_t>(i, 1) - 1]).normalized();
    const std::size_t next = std::min(i + 1, nodes.size() - 1);
    const Eigen::Vector2d after = (nodes[next] - nodes[next - 1]).normalized();
    const double cosine = before.dot(after);
    if (cosine < -0.9) throw std::invalid_argument("follow_lane: the route turns back on itself");
    corners.emplace_back(nodes[i] + lane / (1.0 + cosine) * (right_of(before) + right_of(after)));
  }
  return corners;
}

void sample_line(const Eigen::Vector2d& from, const Eigen::Vector2d& to, std::vector<Eigen::Vector2d>& points) {
  const int count = std::max(1, static_cast<int>((to - from).norm() / sample_distance));
  for (int i = 0; i < count; ++i) points.emplace_back(from + static_cast<double>(i) / count * (to - from));
}

/// An arc that is tangent to both streets at a corner; `from` is where it begins.
void sample_arc(const Eigen::Vector2d& from, const Eigen::Vector2d& direction, double turn, double radius,
                std::vector<Eigen::Vector2d>& points) {
  const double side = turn > 0.0 ? 1.0 : -1.0;
  const Eigen::Vector2d left(-direction.y(), direction.x());
  const int count = std::max(1, static_cast<int>(std::abs(turn) * radius / sample_distance));
  for (int i = 0; i < count; ++i) {
    const double angle = std::abs(turn) * i / count;
    points.emplace_back(from + radius * (std::sin(angle) * direction + side * (1.0 - std::cos(angle)) * left));
  }
}

std::vector<Eigen::Vector2d> round_corners(const std::vector<Eigen::Vector2d>& corners, const CornerRadii& radii) {
  constexpr double sharp = 0.4;  // radians; less is a bend
  std::vector<Eigen::Vector2d> points;
  Eigen::Vector2d start = corners.front();
  for (std::size_t i = 1; i + 1 < corners.size(); ++i) {
    const Eigen::Vector2d before = (corners[i] - corners[i - 1]).normalized();
    const Eigen::Vector2d after = (corners[i + 1] - corners[i]).normalized();
    const double turn = std::atan2(cross(before, after), before.dot(after));
    const double radius = std::abs(turn) < sharp ? radii.bend : turn > 0.0 ? radii.left : radii.right;
    const double tangent = radius * std::tan(0.5 * std::abs(turn));
    const Eigen::Vector2d begin = corners[i] - tangent * before;
    sample_line(start, begin, points);
    sample_arc(begin, before, turn, radius, points);
    start = corners[i] + tangent * after;
  }
  sample_line(start, corners.back(), points);
  points.push_back(corners.back());
  return points;
}

/// Draws what passes through the stretch towards its line, gently.
void squeeze(const NarrowStretch& stretch, std::vector<Eigen::Vector2d>& points) {
  constexpr double approach = 12.0;  // metres
  constexpr double kept = 0.15;      // of the distance to the line
  const double length = (stretch.to - stretch.from).norm();
  const Eigen::Vector2d along = (stretch.to - stretch.from) / length;
  for (Eigen::Vector2d& point : points) {
    const double u = along.dot(point - stretch.from);
    const double off = cross(along, point - stretch.from);
    const double outside = std::max({0.0, -u, u - length}) / approach;
    if (outside >= 1.0 || std::abs(off) > stretch.reach) continue;
    const double ease = outside * outside * (3.0 - 2.0 * outside);
    const double factor = kept + (1.0 - kept) * ease;
    point += (factor - 1.0) * off * Eigen::Vector2d(-along.y(), along.x());
  }
}

/// Means over a window that narrows towards the ends, which stay where they are.
std::vector<Eigen::Vector2d> smoothed(const std::vector<Eigen::Vector2d>& points, std::size_t half_window) {
  std::vector<Eigen::Vector2d> sums{Eigen::Vector2d::Zero()};
  for (const Eigen::Vector2d& point : points) sums.emplace_back(sums.back() + point);
  std::vector<Eigen::Vector2d> result(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::size_t half = std::min({half_window, i, points.size() - 1 - i});
    result[i] = (sums[i + half + 1] - sums[i - half]) / static_cast<double>(2 * half + 1);
  }
  return result;
}

}  // namespace

LanePath follow_lane(const StreetGrid& streets, const Route& route, const LaneOptions& options) {
  if (route.size() < 3) throw std::invalid_argument("follow_lane: a route needs at least three crossings");
  LanePath path{.positions = round_corners(lane_corners(streets, route, options.lane), options.radii),
                .distances = {0.0},
                .headings = {},
                .curvatures = {}};
  for (const NarrowStretch& stretch : options.narrow) squeeze(stretch, path.positions);
  for (int pass = 0; pass < 3; ++pass) path.positions = smoothed(path.positions, 12);

  const std::size_t count = path.positions.size();
  for (std::size_t i = 1; i < count; ++i)
    path.distances.push_back(path.distances.back() + (path.positions[i] - path.positions[i - 1]).norm());
  for (std::size_t i = 0; i < count; ++i) {
    const Eigen::Vector2d chord = path.positions[std::min(i + 1, count - 1)] - path.positions[i == 0 ? 0 : i - 1];
    const double heading = std::atan2(chord.y(), chord.x());
    const double previous = i == 0 ? heading : path.headings.back();
    path.headings.push_back(previous + std::remainder(heading - previous, 2.0 * std::numbers::pi));
  }
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t low = i < 5 ? 0 : i - 5;
    const std::size_t high = std::min(i + 5, count - 1);
    path.curvatures.push_back((path.headings[high] - path.headings[low]) /
                              (path.distances[high] - path.distances[low]));
  }
  return path;
}

}  // namespace chainslam::simulator
