#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/timestamp.hpp"

namespace chainslam::datasets {

using Facts = std::vector<std::pair<std::string, std::string>>;

/// A number with so many decimals, without needless zeros at its end.
[[nodiscard]] std::string text_of(double value, int decimals = 3);

/// The times of a sensor's packets, one after the other.
class TimeStatistics {
 public:
  void add(Timestamp time);

  [[nodiscard]] std::size_t count() const { return count_; }
  /// Adds count, rate and span; gaps of more than two and a half usual steps go to `warnings`.
  void report(const std::string& name, Facts& facts, std::vector<std::string>& warnings) const;

 private:
  std::size_t count_ = 0;
  Timestamp first_, last_;
  std::vector<Duration> steps_;
};

/// The points of one cloud or of many.
class CloudStatistics {
 public:
  void add(const PointCloud<float>& cloud);

  void report(Facts& facts, std::vector<std::string>& warnings) const;

 private:
  std::vector<std::size_t> sizes_;
  std::size_t points_ = 0, not_finite_ = 0, at_origin_ = 0;
  Eigen::Vector3f low_ = Eigen::Vector3f::Constant(std::numeric_limits<float>::max());
  Eigen::Vector3f high_ = Eigen::Vector3f::Constant(std::numeric_limits<float>::lowest());
  float farthest_ = 0;
  std::vector<std::string> columns_;
};

}  // namespace chainslam::datasets
