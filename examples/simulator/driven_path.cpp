#include "simulator/driven_path.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace chainslam::simulator {

namespace {

Index cell_index(double value, double size) { return static_cast<Index>(std::floor(value / size)); }

/// Road points half a metre apart, each with the body's up axis; standing still adds none.
std::vector<PathSample> walk(const VehicleMotion& motion, double body_height, std::vector<Eigen::Vector3d>& ups) {
  constexpr double tick = 0.005;  // seconds: 0.2 m at 40 m/s
  std::vector<PathSample> samples;
  const auto count = static_cast<std::int64_t>(motion.duration() / tick);
  for (std::int64_t i = 0; i <= count; ++i) {
    const double time = static_cast<double>(i) * tick;
    const SE3d pose = motion.pose(time);
    const Eigen::Vector3d up = pose.rotation() * Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d ground = pose.translation() - body_height * up;
    const double moved = samples.empty() ? 0.0 : (ground - samples.back().ground).head<2>().norm();
    if (!samples.empty() && moved < DrivenPath::spacing) continue;
    const double along = samples.empty() ? 0.0 : samples.back().along + moved;
    samples.push_back({.ground = ground, .direction = {1.0, 0.0}, .slope = {0.0, 0.0}, .along = along, .time = time});
    ups.push_back(up);
  }
  return samples;
}

/// Directions and slopes from the samples around: along the way from the heights, across it from how the body leans.
void lay_slopes(std::vector<PathSample>& samples, const std::vector<Eigen::Vector3d>& ups) {
  constexpr std::size_t around = 4;  // samples: what springs and a rider's balance do averages out
  constexpr double steepest = 0.25;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const std::size_t first = i < around ? 0 : i - around;
    const std::size_t last = std::min(i + around, samples.size() - 1);
    const Eigen::Vector3d run = samples[last].ground - samples[first].ground;
    const double level = run.head<2>().norm();
    if (level > 0.0) samples[i].direction = run.head<2>() / level;
    Eigen::Vector3d up = Eigen::Vector3d::Zero();
    for (std::size_t k = first; k <= last; ++k) up += ups[k];
    const Eigen::Vector2d left = samples[i].left();
    const double across = std::clamp(-up.head<2>().dot(left) / up.z(), -steepest, steepest);
    const double ahead = level > 0.0 ? std::clamp(run.z() / level, -steepest, steepest) : 0.0;
    samples[i].slope = ahead * samples[i].direction + across * left;
  }
}

double distance_to(const Plot& plot, const Eigen::Vector2d& point) {
  const Eigen::Vector2d offset = point - plot.center;
  const Eigen::Vector2d side(-plot.axis.y(), plot.axis.x());
  const Eigen::Vector2d local(std::abs(offset.dot(plot.axis)), std::abs(offset.dot(side)));
  return (local - plot.half).cwiseMax(0.0).norm();
}

}  // namespace

DrivenPath::DrivenPath(const VehicleMotion& motion, double body_height)
    : DrivenPath(std::array{&motion}, body_height) {}

DrivenPath::DrivenPath(std::span<const VehicleMotion* const> motions, double body_height) {
  constexpr double between = 1000.0;  // metres: no drive is a later pass of the one before
  for (const VehicleMotion* motion : motions) {
    std::vector<Eigen::Vector3d> ups;
    std::vector<PathSample> samples = walk(*motion, body_height, ups);
    lay_slopes(samples, ups);
    length_ += samples.back().along;
    const double before = samples_.empty() ? 0.0 : samples_.back().along + between;
    for (PathSample& sample : samples) sample.along += before;
    samples_.insert(samples_.end(), samples.begin(), samples.end());
  }
  for (std::size_t i = 0; i < samples_.size(); ++i) {
    const Eigen::Vector2d p = samples_[i].position();
    cells_[key(cell_index(p.x(), cell), cell_index(p.y(), cell))].push_back(to_index(i));
  }
}

std::uint64_t DrivenPath::key(Index column, Index row) {
  return static_cast<std::uint64_t>(static_cast<std::uint32_t>(column)) << 32 | static_cast<std::uint32_t>(row);
}

template <class Visit>
void DrivenPath::for_each_near(const Eigen::Vector2d& point, double reach, const Visit& visit) const {
  for (Index row = cell_index(point.y() - reach, cell); row <= cell_index(point.y() + reach, cell); ++row)
    for (Index column = cell_index(point.x() - reach, cell); column <= cell_index(point.x() + reach, cell); ++column)
      if (const auto found = cells_.find(key(column, row)); found != cells_.end())
        for (const Index i : found->second) visit(samples_[static_cast<std::size_t>(i)]);
}

double DrivenPath::distance(const Eigen::Vector2d& point, double reach) const {
  double nearest = reach * reach;
  for_each_near(point, reach, [&](const PathSample& sample) {
    nearest = std::min(nearest, (sample.position() - point).squaredNorm());
  });
  return std::sqrt(nearest);
}

bool DrivenPath::is_clear(const Plot& plot, double clearance) const {
  bool clear = true;
  for_each_near(plot.center, plot.radius() + clearance,
                [&](const PathSample& sample) { clear = clear && distance_to(plot, sample.position()) >= clearance; });
  return clear;
}

bool DrivenPath::was_passed_before(std::size_t sample, double reach) const {
  const PathSample& here = samples_[sample];
  const double earlier = here.along - 5.0 * reach;  // the same pass does not count
  bool passed = false;
  for_each_near(here.position(), reach, [&](const PathSample& other) {
    passed = passed || (other.along < earlier && (other.position() - here.position()).norm() < reach);
  });
  return passed;
}

}  // namespace chainslam::simulator
