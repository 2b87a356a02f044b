#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <vector>

namespace chainslam {

/// Heights of the ground over the xy-plane, from points of which the lowest lie on it.
///
/// A cell's own height is that of its third lowest point: two may be reflections from below. The ground rises by at
/// most `slope` from cell to cell, so that cells with walls or treetops alone, and cells without points, take theirs
/// from around. Of floors one above the other it is the lowest.
class GroundHeights {
 public:
  /// An empty rectangle. @param lower  its corner with the smallest x and y, metres.
  GroundHeights(const Eigen::Vector2d& lower, const Eigen::Vector2d& upper, double cell, double slope)
      : lower_(lower),
        cell_(cell),
        slope_(slope),
        width_(static_cast<std::size_t>((upper.x() - lower.x()) / cell) + 1),
        height_(static_cast<std::size_t>((upper.y() - lower.y()) / cell) + 1),
        lowest_(width_ * height_, Lowest{none, none, none}) {}

  /// Takes a point inside of the rectangle.
  void add(const Eigen::Vector3d& point) {
    float z = static_cast<float>(point.z());
    for (float& kept : lowest_[index(point.x(), point.y())])
      if (z < kept) std::swap(z, kept);
  }

  /// To be called once all points are there.
  void settle() {
    heights_.resize(lowest_.size());
    for (std::size_t i = 0; i < lowest_.size(); ++i) heights_[i] = lowest_[i][2];
    lowest_ = {};
    for (std::size_t y = 0; y < height_; ++y)
      for (std::size_t x = 0; x < width_; ++x) bound(x, y, -1);
    for (std::size_t y = height_; y-- > 0;)
      for (std::size_t x = width_; x-- > 0;) bound(x, y, +1);
  }

  /// The ground's height at a place in the rectangle, metres; infinite if no cell has points enough.
  [[nodiscard]] double at(double x, double y) const { return static_cast<double>(heights_[index(x, y)]); }

 private:
  using Lowest = std::array<float, 3>;
  static constexpr float none = std::numeric_limits<float>::infinity();

  [[nodiscard]] std::size_t index(double x, double y) const {
    const auto along = [&](double offset, std::size_t cells) {
      return std::min(static_cast<std::size_t>(std::max(offset / cell_, 0.0)), cells - 1);
    };
    return along(y - lower_.y(), height_) * width_ + along(x - lower_.x(), width_);
  }

  /// Lowers a cell to what its neighbours in the row before (or behind) and the one beside it allow: two passes over
  /// all give the lower envelope, as in the chamfer distance transform (Borgefors 1986).
  void bound(std::size_t x, std::size_t y, int step) {
    float& height = heights_[y * width_ + x];
    const auto by = [&](int dx, int dy) {
      const std::size_t there_x = x + static_cast<std::size_t>(dx), there_y = y + static_cast<std::size_t>(dy);
      if (there_x >= width_ || there_y >= height_) return;  // also what is below 0, which wraps around
      const double rise = slope_ * cell_ * (dx != 0 && dy != 0 ? std::numbers::sqrt2 : 1.0);
      height = std::min(height, heights_[there_y * width_ + there_x] + static_cast<float>(rise));
    };
    by(step, 0);
    for (const int dx : {-1, 0, 1}) by(dx, step);
  }

  Eigen::Vector2d lower_;
  double cell_, slope_;
  std::size_t width_, height_;
  std::vector<Lowest> lowest_;
  std::vector<float> heights_;
};

}  // namespace chainslam
