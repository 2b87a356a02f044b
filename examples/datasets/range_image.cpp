#include "datasets/range_image.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>

#include "chainslam/io/input_file.hpp"
#include "datasets/dataset.hpp"
#include "datasets/files.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/merged_streams.hpp"
#include "datasets/scan_files.hpp"

namespace chainslam::datasets {
namespace {

constexpr double radians_per_degree = std::numbers::pi / 180;

/// When each image's sweep began and ended.
struct SweepTimes {
  std::vector<Timestamp> start, end;
  std::string note;
};

/// One row of an INS/GPS record.
struct InsRecord {
  Timestamp time;
  GeodeticPosition position;
};

/// Reads `timestamp;satellites;lat;lon;alt;...`; lines that do not start with a date are headers.
std::vector<InsRecord> read_ins(const std::filesystem::path& path) {
  InputFile file(path);
  std::vector<InsRecord> records;
  while (const auto line = file.read_line()) {
    LineFields fields(file, *line, ';');
    if (!fields.more()) continue;
    const auto time = parse_date_time(fields.text("timestamp"));
    if (!time) {
      if (records.empty()) continue;
      fields.fail("timestamp", "no date and time", "write YYYY-MM-DD hh:mm:ss.nnn");
    }
    if (!records.empty() && *time <= records.back().time)
      fields.fail("timestamp", "a time that is not later than the one before it", "records come in the order of time");
    static_cast<void>(fields.number("satellites"));
    InsRecord record{.time = *time, .position = {}};
    record.position.latitude_deg = fields.number("lat");
    record.position.longitude_deg = fields.number("long");
    record.position.altitude = fields.number("alt");
    if (!plausible(record.position)) fields.fail("lat", "a place that is not on the globe", "write degrees and metres");
    records.push_back(record);
  }
  return records;
}

/// The usual time from one scan to the next.
Duration usual_step(const std::vector<Timestamp>& stamps) {
  std::vector<Duration> steps;
  for (std::size_t i = 1; i < stamps.size(); ++i) steps.push_back(stamps[i] - stamps[i - 1]);
  if (steps.empty()) return std::chrono::milliseconds(100);
  std::ranges::nth_element(steps, steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2));
  return steps[steps.size() / 2];
}

/// Stamps that lie in the middle of their sweeps, as the driver of this sensor wrote them.
SweepTimes around(const std::vector<Timestamp>& stamps) {
  SweepTimes times;
  const Duration half = std::min<Duration>(usual_step(stamps), std::chrono::seconds(1)) / 2;
  for (const Timestamp stamp : stamps) {
    times.start.push_back(stamp - half);
    times.end.push_back(stamp + half);
  }
  times.note = "no start and end of sweeps is stated: stamps are taken as their middle, the usual step as their length";
  return times;
}

class RangeImages final : public Dataset {
 public:
  RangeImages(const std::filesystem::path& path, const DatasetOptions& options) {
    const std::filesystem::path data = path / "data";
    images_ = files_in(std::filesystem::is_directory(data) ? data : path, {".png"});
    if (const auto mask = std::ranges::find(images_, "mask.png", [](const auto& p) { return p.filename(); });
        mask != images_.end()) {
      mask_ = read_gray_png(*mask);
      images_.erase(mask);
    }
    if (images_.empty()) throw_input_error(path.string(), "", "no range images", "put them into the folder data");
    geometry_ = read_range_image_geometry(
        std::filesystem::exists(path / "velodyne_config.txt") ? path / "velodyne_config.txt" : path / "img.cfg");
    const std::filesystem::path ins = path / "imu.cfg";
    if (std::filesystem::exists(ins)) ins_ = read_ins(ins);
    times_ = sweep_times(path);
    if (times_.start.size() != images_.size() || times_.end.size() != images_.size())
      throw_input_error(path.string(), "",
                        std::to_string(images_.size()) + " images, but " + std::to_string(times_.start.size()) +
                            " start and " + std::to_string(times_.end.size()) + " end times",
                        "give one line of each time file for each image");
    describe(path, options);
    streams_.add([this] { return next_scan(); });
    if (!ins_.empty()) streams_.add([this] { return next_fix(); });
  }

  std::optional<Packet> next() override {
    auto packet = streams_.next();
    if (std::string loss = lost_.sentence(); !packet && !std::exchange(noted_, true) && !loss.empty())
      info_.warnings.push_back(std::move(loss));
    return packet;
  }

 private:
  SweepTimes sweep_times(const std::filesystem::path& path) const {
    if (std::filesystem::exists(path / "timestamps_start.txt"))
      return {read_stamps(path / "timestamps_start.txt"), read_stamps(path / "timestamps_end.txt"), ""};
    if (std::filesystem::exists(path / "timestamps.txt")) return around(read_stamps(path / "timestamps.txt"));
    std::vector<Timestamp> stamps;
    for (const InsRecord& record : ins_) stamps.push_back(record.time);
    return around(stamps);
  }

  void describe(const std::filesystem::path& path, const DatasetOptions& options) {
    info_.kind = DatasetKind::range_images;
    info_.path = path;
    info_.name = folder_name(path);
    info_.truth = options.truth;
    info_.T_body_lidar = options.T_body_lidar.value_or(SE3d());
    info_.start = times_.start.front();
    info_.end = times_.end.back();
    info_.sensors.push_back(
        {"range images", SensorKind::lidar, images_.size(),
         std::to_string(geometry_.width) + " columns, " + std::to_string(geometry_.height) + " rings"});
    if (!times_.note.empty()) info_.notes.push_back(times_.note);
    info_.notes.emplace_back("times of points by column, from a sweep's start to its end");
    if (ins_.empty()) return;
    info_.sensors.push_back(
        {"imu.cfg", SensorKind::gnss, ins_.size(), "latitude, longitude, altitude; 1 m and 2 m assumed"});
    info_.notes.emplace_back("imu.cfg: its angles, rates and velocities are not named rightly and are not read");
  }

  std::optional<Packet> next_scan() {
    std::optional<GrayImage> read;
    for (; image_ < images_.size() && !read; image_ += read ? 0 : 1) try {
        read = read_gray_png(images_[image_]);
      } catch (const IoError& error) {
        lost_.add(error);
      }
    if (!read) return std::nullopt;
    const GrayImage& image = *read;
    const auto fits = [&](const GrayImage& i) { return i.width == geometry_.width && i.height == geometry_.height; };
    if (!fits(image) || (mask_ && !fits(*mask_)))
      throw_input_error(images_[image_].string(), "",
                        "an image of " + std::to_string(image.width) + " x " + std::to_string(image.height) + " pixels",
                        "its configuration and its mask must have the same size");
    LidarScan scan =
        scan_of_range_image(image, geometry_, times_.start[image_], times_.end[image_], mask_ ? &*mask_ : nullptr);
    ++image_;
    return scan;
  }

  std::optional<Packet> next_fix() {
    if (fix_ == ins_.size()) return std::nullopt;
    const InsRecord& record = ins_[fix_++];
    return make_fix(record.time, record.position, {.horizontal = 1, .vertical = 2}, GnssQuality::differential);
  }

  std::vector<std::filesystem::path> images_;
  RangeImageGeometry geometry_;
  SweepTimes times_;
  std::optional<GrayImage> mask_;
  std::vector<InsRecord> ins_;
  MergedStreams streams_;
  std::size_t image_ = 0;
  std::size_t fix_ = 0;
  LeftOut lost_;
  bool noted_ = false;
};

}  // namespace

RangeImageGeometry read_range_image_geometry(const std::filesystem::path& path) {
  InputFile file(path);
  std::vector<double> numbers;
  while (const auto line = file.read_line()) {
    std::string text(*line);
    std::ranges::replace(text, ';', ' ');
    LineFields fields(file, text);
    if (!fields.more() || text.starts_with('#')) continue;
    numbers.clear();
    while (fields.more()) numbers.push_back(fields.number("geometry"));
  }
  const auto fail = [&] {
    file.fail(file.place_of_line(), std::to_string(numbers.size()) + " numbers that are no geometry",
              "write: [multiplier] width height first_azimuth last_azimuth, then one angle for each row");
  };
  // With a multiplier in front there is one number more than rows ask for.
  const auto rows_fit = [&](std::size_t before) {
    if (numbers.size() < before + 2) return false;
    const double rows = numbers[before - 3];
    const auto angles = static_cast<double>(numbers.size() - before);
    return numbers[before - 4] >= 1 && numbers[before - 4] <= 65536 && rows >= 1 && rows <= 4096 &&
           (angles == rows || angles == 2);
  };
  const std::size_t before = rows_fit(5) ? 5 : 4;
  if (!rows_fit(before)) fail();
  RangeImageGeometry geometry;
  if (before == 5) geometry.units_per_metre = numbers[0];
  geometry.width = static_cast<int>(numbers[before - 4]);
  geometry.height = static_cast<int>(numbers[before - 3]);
  geometry.first_azimuth_deg = numbers[before - 2];
  geometry.last_azimuth_deg = numbers[before - 1];
  geometry.row_angles_deg.assign(numbers.begin() + static_cast<std::ptrdiff_t>(before), numbers.end());
  if (!(geometry.units_per_metre > 0)) fail();
  if (geometry.row_angles_deg.size() == 2 && geometry.height != 2) {
    const double first = numbers[before], last = numbers[before + 1];
    geometry.row_angles_deg.clear();
    for (int row = 0; row < geometry.height; ++row)
      geometry.row_angles_deg.push_back(first + (last - first) * row / std::max(geometry.height - 1, 1));
  }
  return geometry;
}

LidarScan scan_of_range_image(const GrayImage& image, const RangeImageGeometry& geometry, Timestamp start,
                              Timestamp end, const GrayImage* mask) {
  LidarScan scan{.time = start, .end = std::max(start, end), .cloud = {}};
  const double sweep = to_seconds(scan.end - start);
  for (int column = 0; column < image.width; ++column) {
    const double part = (column + 0.5) / image.width;
    const double azimuth = radians_per_degree * (geometry.first_azimuth_deg +
                                                 part * (geometry.last_azimuth_deg - geometry.first_azimuth_deg));
    for (int row = 0; row < image.height; ++row) {
      const std::uint16_t value = image.at(row, column);
      if (value == 0 || (mask != nullptr && mask->at(row, column) == 0)) continue;
      const double range = value / geometry.units_per_metre;
      const double down = radians_per_degree * geometry.row_angles_deg[static_cast<std::size_t>(row)];
      const Eigen::Vector3d point(range * std::cos(down) * std::cos(azimuth),
                                  range * std::cos(down) * std::sin(azimuth), -range * std::sin(down));
      scan.cloud.positions.push_back(point.cast<float>());
      scan.cloud.time_offsets.push_back(static_cast<float>(part * sweep));
    }
  }
  return scan;
}

std::unique_ptr<Dataset> open_range_images(const std::filesystem::path& path, const DatasetOptions& options) {
  return std::make_unique<RangeImages>(path, options);
}

}  // namespace chainslam::datasets
