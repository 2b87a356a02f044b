#pragma once

#include <array>
#include <cstddef>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "odometry/outcome.hpp"

namespace chainslam::bench {

/// A Markdown table: a row for each drive and variant of it, a column for each odometry.
class DriveTable {
 public:
  explicit DriveTable(std::string title) : title_(std::move(title)) {}

  /// What all odometries came to: `lidar`, `fast_lio2`, `lidar_inertial`.
  void add(const std::string& drive, const std::string& variant, const std::array<Outcome, 3>& outcomes) {
    Row row{drive, variant, outcomes};
    std::fputs(line(row).c_str(), stderr);  // as it comes: the whole takes minutes
    rows_.push_back(std::move(row));
  }

  /// @param with_mean  adds a row with the mean of the relative errors.
  [[nodiscard]] std::string markdown(bool with_mean = false) const {
    if (rows_.empty()) return {};
    std::string text = "## " + title_ + "\n\n| drive | variant | `lidar` | `fast_lio2` | `lidar_inertial` |\n" +
                       "|---|---|---|---|---|\n";
    for (const Row& row : rows_) text += line(row);
    if (with_mean) text += mean_line();
    return text + '\n';
  }

 private:
  struct Row {
    std::string drive, variant;
    std::array<Outcome, 3> outcomes;
  };

  [[nodiscard]] static std::string line(const Row& row) {
    std::string text = "| " + row.drive + " | " + row.variant + " |";
    for (const Outcome& outcome : row.outcomes) text += ' ' + cell(outcome) + " |";
    return text + '\n';
  }

  /// With so many decimals, but what is absurdly large with three digits.
  [[nodiscard]] static std::string number(double value, int decimals) {
    char text[64];
    std::snprintf(text, sizeof text, value < 1e4 ? "%.*f" : "%.*g", value < 1e4 ? decimals : 3, value);
    return text;
  }

  [[nodiscard]] static std::string cell(const Outcome& outcome) {
    std::string text = "poses not finite";
    if (outcome.ape)
      text = number(*outcome.ape, 3) + " m";
    else if (outcome.finite)
      text = "path " + number(outcome.path, 1) + " m";
    if (outcome.kitti) text += ", " + number(*outcome.kitti, 2) + " %";
    if (outcome.lost > 0) text += ", **" + std::to_string(outcome.lost) + " lost**";
    return text + ", " + number(outcome.milliseconds, 1) + " ms";
  }

  [[nodiscard]] std::string mean_line() const {
    std::string text = "| mean | |";
    for (std::size_t i = 0; i < 3; ++i) {
      double sum = 0;
      int count = 0;
      for (const Row& row : rows_)
        if (const auto& kitti = row.outcomes[i].kitti) {
          sum += *kitti;
          ++count;
        }
      text += count > 0 ? ' ' + number(sum / count, 2) + " % |" : " – |";
    }
    return text + '\n';
  }

  std::string title_;
  std::vector<Row> rows_;
};

}  // namespace chainslam::bench
