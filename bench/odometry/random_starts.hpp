#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "odometry/outcome.hpp"
#include "support/semi_real_drives.hpp"

namespace chainslam::bench {

/// The default odometry against LiDAR odometry, both started at random times of the semi-real drives: at any speed, in
/// turns, where IMU measurements are missing.
class RandomStarts {
 public:
  static constexpr Index scans = 200;  ///< of each start: 20 s

  RandomStarts(int starts, std::uint64_t seed) : seed_(seed) {
    Rng rng(seed);
    for (int i = 0; i < starts; ++i) fractions_.push_back(rng.uniform());
    std::ranges::sort(fractions_);
  }

  /// @param drives  the number of scans of each drive. Every time of all of them is as likely.
  /// @returns the first scans of this drive's starts, in order.
  [[nodiscard]] std::vector<Index> of_drive(std::size_t drive, const std::vector<Index>& drives) const {
    double before = 0, all = 0;
    for (std::size_t i = 0; i < drives.size(); ++i) {
      const auto possible = static_cast<double>(drives[i] - scans + 1);
      if (i < drive) before += possible;
      all += possible;
    }
    std::vector<Index> first;
    for (const double fraction : fractions_) {
      const double at = fraction * all - before;
      if (at >= 0 && at < static_cast<double>(drives[drive] - scans + 1)) first.push_back(static_cast<Index>(at));
    }
    return first;
  }

  void run(const std::string& name, const simulator::RecordedDrive& semi_real, Index first) {
    const test::Drive drive = test::part_of(semi_real, first, scans);
    auto packets = test::packets_of(drive);
    const auto [lidar, inertial] = outcomes_of<LidarSource, LidarInertialSource>(drive, packets);
    const double span = to_seconds(drive.scans.front().time - semi_real.epoch());
    starts_.push_back({name, first, span, lidar, inertial});
    std::fputs(line(starts_.back()).c_str(), stderr);  // as it comes
  }

  [[nodiscard]] std::string markdown() const {
    if (starts_.empty()) return {};
    std::vector<double> of_lidar, of_inertial;
    std::string worse;
    std::size_t good = 0;
    std::int64_t lost[2] = {0, 0};
    for (const Start& start : starts_) {
      of_lidar.push_back(error(start.lidar));
      of_inertial.push_back(error(start.inertial));
      lost[0] += start.lidar.lost;
      lost[1] += start.inertial.lost;
      if (no_worse(start))
        ++good;
      else
        worse += line(start);
    }
    char text[600];
    std::snprintf(
        text, sizeof text,
        "## Started at random times: simulated scans, real IMU\n\n%zu starts at random times of the semi-real "
        "drives (seed %llu), %.0f s each. By APE, `lidar_inertial` is no worse than `lidar` in %zu, where 2 cm or "
        "5 %%, the larger, are allowed.\n\n| | median | mean | largest | scans lost |\n|---|---|---|---|---|\n",
        starts_.size(), static_cast<unsigned long long>(seed_), 0.1 * static_cast<double>(scans), good);
    std::string table = text + row("`lidar`", of_lidar, lost[0]) + row("`lidar_inertial`", of_inertial, lost[1]) + '\n';
    if (!worse.empty())
      table += "Worse:\n\n| drive | started | `lidar` | `lidar_inertial` |\n|---|---|---|---|\n" + worse + '\n';
    return table;
  }

 private:
  struct Start {
    std::string drive;
    Index scan;
    double time;  ///< seconds from the drive's first scan
    Outcome lidar, inertial;
  };

  [[nodiscard]] static double error(const Outcome& outcome) { return outcome.ape.value_or(1e9); }

  [[nodiscard]] static bool no_worse(const Start& start) {
    return test::no_worse(error(start.inertial), error(start.lidar)) && start.inertial.lost <= start.lidar.lost;
  }

  [[nodiscard]] static std::string line(const Start& start) {
    char text[200];
    std::snprintf(text, sizeof text, "| %s | scan %lld, %.1f s | %.3f m, %lld lost | %.3f m, %lld lost |\n",
                  start.drive.c_str(), static_cast<long long>(start.scan), start.time, error(start.lidar),
                  static_cast<long long>(start.lidar.lost), error(start.inertial),
                  static_cast<long long>(start.inertial.lost));
    return text;
  }

  [[nodiscard]] static std::string row(const char* name, std::vector<double> errors, std::int64_t lost) {
    std::ranges::sort(errors);
    double sum = 0;
    for (const double error : errors) sum += error;
    char text[200];
    std::snprintf(text, sizeof text, "| %s | %.3f m | %.3f m | %.3f m | %lld |\n", name, errors[errors.size() / 2],
                  sum / static_cast<double>(errors.size()), errors.back(), static_cast<long long>(lost));
    return text;
  }

  std::uint64_t seed_;
  std::vector<double> fractions_;
  std::vector<Start> starts_;
};

}  // namespace chainslam::bench
