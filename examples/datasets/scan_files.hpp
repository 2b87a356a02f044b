#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "datasets/dataset.hpp"
#include "datasets/merged_streams.hpp"

namespace chainslam::datasets {

/// The files that could not be read, and were left out.
class LeftOut {
 public:
  void add(const IoError& error) {
    const IoError::Report& report = error.report();
    if (count_++ == 0) first_ = report.path + (report.place.empty() ? "" : ", " + report.place) + ": " + report.found;
  }

  /// How many there are, and the first's place and damage; empty if there is none.
  [[nodiscard]] std::string sentence() const {
    if (count_ == 0) return {};
    if (count_ == 1) return "1 file cannot be read and is left out: " + first_;
    return std::to_string(count_) + " files cannot be read and are left out; the first, " + first_;
  }

 private:
  std::size_t count_ = 0;
  std::string first_;
};

/// A data set that keeps a file for each scan and tables of its other sensors, taken apart.
struct ScanFiles {
  DatasetInfo info;
  std::size_t scans = 0;
  std::function<LidarScan(std::size_t)> read;       ///< a scan by its number; @throws IoError if its file is damaged
  std::vector<MergedStreams::Stream> others{};      ///< of the other sensors
  std::function<Trajectory()> truth{};              ///< T_map_body; if empty, `info.truth` is a TUM file or empty
  std::vector<std::function<std::string()>> end{};  ///< asked at the end what was left out on the way; may be empty
};

/// What all such data sets begin with: kind, folder and its name, the LiDAR with its number of scans, first and last
/// time of them.
[[nodiscard]] ScanFiles scans_of(DatasetKind kind, const std::filesystem::path& path, SensorInfo lidar, Timestamp start,
                                 Timestamp end);

/// Reads such a data set in time order. Scans whose files are damaged are left out, which is said at the end with the
/// first one's place.
[[nodiscard]] std::unique_ptr<Dataset> dataset_of(ScanFiles parts);

/// Gives a scan's points their times. @param stamp  from which relative times count.
/// @param times  of each point, as stored. @throws IoError naming the file if no sweep has such times.
void set_point_times(LidarScan& scan, const PointTimeRule& rule, std::span<const double> times, Timestamp stamp,
                     const std::filesystem::path& file);

/// Sets where the truth comes from: a file that the options name, or else `file`, unless empty, which `read` reads.
void set_truth(ScanFiles& parts, const DatasetOptions& options, const std::filesystem::path& file,
               std::function<Trajectory()> read);

/// Adds the samples of an IMU from a table, converted to m/s^2, rad/s and the scans' clock as the options say, or as
/// the numbers of the first minutes look. Rows whose time is ahead of the next row's are left out, which is said at the
/// end.
///
/// @param open  opens the table at its start: the returned function gives its samples in their order.
void add_imu(ScanFiles& parts, const DatasetOptions& options, const std::string& name,
             const std::function<std::function<std::optional<ImuSample>()>()>& open);

}  // namespace chainslam::datasets
