#include "datasets/scan_files.hpp"

#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "datasets/files.hpp"
#include "datasets/imu_conversion.hpp"

namespace chainslam::datasets {
namespace {

class ScanFileSet final : public Dataset {
 public:
  explicit ScanFileSet(ScanFiles parts) : parts_(std::move(parts)) {
    info_ = parts_.info;
    streams_.add([this] { return next_scan(); });
    for (auto& stream : parts_.others) streams_.add(std::move(stream));
  }

  std::optional<Packet> next() override {
    auto packet = streams_.next();
    if (!packet) note_losses();
    return packet;
  }

  std::optional<Trajectory> truth() const override { return parts_.truth ? parts_.truth() : Dataset::truth(); }

 private:
  std::optional<Packet> next_scan() {
    while (scan_ < parts_.scans) try {
        return parts_.read(scan_++);
      } catch (const IoError& error) {
        lost_.add(error);
      }
    return std::nullopt;
  }

  void note_losses() {
    if (std::exchange(noted_, true)) return;
    if (std::string loss = lost_.sentence(); !loss.empty()) info_.warnings.push_back(std::move(loss));
    for (const auto& ask : parts_.end)
      if (std::string loss = ask(); !loss.empty()) info_.warnings.push_back(std::move(loss));
    if (streams_.dropped() > 0)
      info_.warnings.push_back(std::to_string(streams_.dropped()) + " packets dropped that went back in time");
  }

  ScanFiles parts_;
  MergedStreams streams_;
  std::size_t scan_ = 0;
  LeftOut lost_;
  bool noted_ = false;
};

}  // namespace

ScanFiles scans_of(DatasetKind kind, const std::filesystem::path& path, SensorInfo lidar, Timestamp start,
                   Timestamp end) {
  ScanFiles parts;
  parts.scans = lidar.count.value_or(0);
  parts.info.kind = kind;
  parts.info.path = path;
  parts.info.name = folder_name(path);
  parts.info.start = start;
  parts.info.end = end;
  parts.info.sensors.push_back(std::move(lidar));
  return parts;
}

std::unique_ptr<Dataset> dataset_of(ScanFiles parts) { return std::make_unique<ScanFileSet>(std::move(parts)); }

void set_point_times(LidarScan& scan, const PointTimeRule& rule, std::span<const double> times, Timestamp stamp,
                     const std::filesystem::path& file) {
  const auto fail = [&](const std::string& found) {
    throw_input_error(file.string(), "", found, "the file is damaged or of another kind");
  };
  PointTimes of_points;
  try {
    of_points = apply_point_time(rule, times, stamp);
  } catch (const std::invalid_argument&) {
    fail("points of no time between the years 1678 and 2261");
  }
  if (!is_recorded_time(of_points.time)) fail("points of no time between the years 1824 and 2115");
  if (!of_points.plausible)
    fail("points that span " + std::to_string(to_seconds(of_points.end - of_points.time)) + " s");
  scan.time = of_points.time;
  scan.end = of_points.end;
  scan.cloud.time_offsets = std::move(of_points.offsets);
}

void set_truth(ScanFiles& parts, const DatasetOptions& options, const std::filesystem::path& file,
               std::function<Trajectory()> read) {
  parts.info.truth = options.truth.empty() ? file : options.truth;
  if (options.truth.empty() && !file.empty()) parts.truth = std::move(read);
}

void add_imu(ScanFiles& parts, const DatasetOptions& options, const std::string& name,
             const std::function<std::function<std::optional<ImuSample>()>()>& open) {
  constexpr std::size_t most = 20'000;  // samples that say what the units are
  std::vector<ImuSample> beginning;
  for (const auto read = open(); beginning.size() < most;) {
    const auto sample = read();
    if (!sample) break;
    beginning.push_back(*sample);
  }
  const ImuConversion convert(options, beginning, parts.info);
  parts.info.sensors.push_back({name, SensorKind::imu, std::nullopt, ""});
  const auto samples = std::make_shared<TimesThatRunOn>(open());
  parts.others.push_back([samples, convert]() -> std::optional<Packet> {
    const auto sample = samples->next();
    return sample ? std::optional<Packet>(convert(*sample)) : std::nullopt;
  });
  parts.end.push_back([samples, name] {
    return samples->dropped() > 0 ? std::to_string(samples->dropped()) + " rows of " + name +
                                        " left out whose time is ahead of the next row's"
                                  : std::string();
  });
}

}  // namespace chainslam::datasets
