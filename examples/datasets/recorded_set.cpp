#include <cstdint>
#include <deque>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/io/detail/input_stream.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/pcd.hpp"
#include "datasets/files.hpp"
#include "datasets/odometry_recording.hpp"
#include "datasets/recorded_rows.hpp"

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

/// A number from 0 to `greatest`, which settings of keyframes are.
double number_in(const nlohmann::json& json, const char* key, double greatest) {
  const double value = json.at(key).get<double>();
  if (!(value >= 0 && value <= greatest)) throw std::out_of_range(std::string(key) + " = " + std::to_string(value));
  return value;
}

std::int64_t count_in(const nlohmann::json& json, const char* key) {
  const std::int64_t count = json.at(key).get<std::int64_t>();
  if (count < 0) throw std::out_of_range(std::string(key) + " = " + std::to_string(count));
  return count;
}

RecordingInfo info_of(const nlohmann::json& json) {
  RecordingInfo info;
  info.session = json.at("session").get<std::string>();
  info.odometry = json.at("odometry").get<std::string>();
  info.source = json.at("source").get<std::string>();
  info.truth_frame = json.at("truth_frame").get<std::string>();
  info.scans = count_in(json, "scans");
  info.frames = count_in(json, "frames");
  info.lost_frames = count_in(json, "lost_frames");
  const nlohmann::json& keyframes = json.at("keyframes");
  info.keyframes = {.distance = number_in(keyframes, "distance", 1e6),
                    .angle = number_in(keyframes, "angle", 100),
                    .scan_voxel = number_in(keyframes, "scan_voxel", 1e3),
                    .scan_step = number_in(keyframes, "scan_step", 1e3)};
  info.notes = json.at("notes").get<std::vector<std::string>>();
  return info;
}

RecordingInfo read_info(const fs::path& path) {
  auto file = detail::input_stream(path);
  const nlohmann::json json = nlohmann::json::parse(file, nullptr, false);
  if (!json.is_object() || json.value("format", nlohmann::json()) != recording_format)
    throw_input_error(
        path.string(), "", "no description of recorded odometry",
        "record it again with `chainslam odometry`; without this file the folder is a plain keyframe set");
  try {
    if (const int version = json.at("version").get<int>(); version != recording_version)
      throw_input_error(path.string(), "version", std::to_string(version),
                        "this program reads version " + std::to_string(recording_version) +
                            ": record the odometry again, or use the program that wrote it");
    return info_of(json);
  } catch (const nlohmann::json::exception& error) {
    throw_input_error(path.string(), "", error.what(), "the file was changed: record the odometry again");
  } catch (const std::out_of_range& error) {
    throw_input_error(path.string(), "", error.what(), "the file was changed: record the odometry again");
  }
}

/// The columns that one version wrote, and how its rows are read.
template <class Row>
struct TableLayout {
  std::string head;
  Row (*read)(LineFields&);
};

/// A table with a first line that names its columns, row by row, one of them read ahead.
template <class Row>
class RecordedTable {
 public:
  RecordedTable(const fs::path& path, const std::vector<TableLayout<Row>>& known) : file_(path) {
    const auto line = file_.read_line();
    for (const TableLayout<Row>& layout : known)
      if (line && std::string(*line) + '\n' == layout.head) read_ = layout.read;
    if (read_ == nullptr)
      file_.fail("line 1", line ? "other columns" : "an empty file",
                 "record the odometry again: this table is not of this version");
    advance();
  }

  [[nodiscard]] const std::optional<Row>& row() const { return row_; }
  [[nodiscard]] const InputFile& file() const { return file_; }
  void advance() {
    row_.reset();
    const auto line = file_.read_line();
    if (!line) return;
    LineFields fields(file_, *line, ',');
    row_ = read_(fields);
  }

 private:
  InputFile file_;
  Row (*read_)(LineFields&) = nullptr;
  std::optional<Row> row_;
};

class RecordedSet final : public Dataset {
 public:
  RecordedSet(const fs::path& folder, const DatasetOptions& options)
      : recording_(read_info(folder / recording_description)),
        intensities_(options.recorded_intensities || !(recording_.keyframes.scan_step > 0)),
        scans_(files_in(folder / "Scans", {".pcd"})),
        frames_(folder / "frames.csv",
                {{frame_table_head(), read_frame_row}, {earlier_frame_table_head(), read_earlier_frame_row}}) {
    info_.kind = DatasetKind::keyframes;
    info_.path = folder;
    info_.name = recording_.session;
    info_.truth = options.truth;
    if (info_.truth.empty() && fs::is_regular_file(folder / "truth.tum")) info_.truth = folder / "truth.tum";
    info_.truth_frame = recording_.truth_frame;
    info_.source = recording_.source;
    info_.T_body_lidar = options.T_body_lidar.value_or(SE3d());
    info_.motion_corrected = info_.has_odometry = true;
    info_.keyframes = recording_.keyframes;
    if (frames_.row()) info_.start = frames_.row()->frame.time;
    info_.sensors.push_back({"frames.csv", SensorKind::lidar, static_cast<std::size_t>(recording_.frames),
                             "odometry " + recording_.odometry + ", scans of " + std::to_string(scans_.size()) +
                                 " keyframes, corrected for motion"});
    if (fs::is_regular_file(folder / "fixes.csv")) {
      fixes_.emplace(folder / "fixes.csv", std::vector<TableLayout<FixRow>>{{fix_table_head(), read_fix_row}});
      info_.sensors.push_back({"fixes.csv", SensorKind::gnss, std::nullopt, "recorded with the odometry"});
    }
    info_.notes = recording_.notes;
    info_.notes.push_back("odometry: " + std::to_string(recording_.frames) + " frames of " +
                          std::to_string(recording_.scans) + " scans, " + std::to_string(recording_.lost_frames) +
                          " of them lost");
  }

  /// Scans of keyframes, and fixes, for whoever takes a recording for a data set without odometry.
  std::optional<Packet> next() override {
    while (waiting_.empty()) {
      std::optional<Frame> frame = next_frame();
      for (const GnssFix& fix : take_fixes()) waiting_.push_back(fix);
      if (frame && !frame->cloud.empty())
        waiting_.push_back(LidarScan{.time = frame->time, .end = frame->time, .cloud = std::move(frame->cloud)});
      if (!frame && waiting_.empty()) return std::nullopt;
    }
    Packet packet = std::move(waiting_.front());
    waiting_.pop_front();
    return packet;
  }

  std::optional<Frame> next_frame() override {
    const std::optional<FrameRow> row = frames_.row();
    collect_fixes(row ? given_ : std::numeric_limits<std::int64_t>::max());
    if (!row) {
      check_end();
      return std::nullopt;
    }
    Frame frame{.time = row->frame.time,
                .T_odom_body = row->frame.T_odom_body,
                .covariance = row->frame.covariance.matrix(),
                .cloud = {},
                .health = row->frame.health};
    if (row->frame.delta_velocity) frame.delta_velocity = row->frame.delta_velocity->cast<double>();
    if (row->keyframe >= 0) frame.cloud = scan_of(row->keyframe);
    ++given_;
    frames_.advance();
    return frame;
  }

  std::vector<GnssFix> take_fixes() override { return std::exchange(passed_, {}); }

 private:
  void collect_fixes(std::int64_t frames) {
    for (; fixes_ && fixes_->row() && fixes_->row()->frames_before <= frames; fixes_->advance())
      passed_.push_back(fixes_->row()->fix);
  }

  PointCloud<float> scan_of(std::int64_t keyframe) {
    if (keyframe != next_keyframe_ || keyframe >= static_cast<std::int64_t>(scans_.size()))
      frames_.file().fail(
          frames_.file().place_of_line() + ", field keyframe", std::to_string(keyframe),
          "keyframes are numbered from 0 on, and each has its scan in Scans/: copy the recording again");
    ++next_keyframe_;
    PointCloud<float> scan = read_pcd(scans_[static_cast<std::size_t>(keyframe)]);
    if (!intensities_) scan.intensities = {};
    return scan;
  }

  /// @throws IoError if the recording lost its end.
  void check_end() const {
    if (given_ == recording_.frames && next_keyframe_ == static_cast<std::int64_t>(scans_.size())) return;
    frames_.file().fail("",
                        std::to_string(given_) + " frames and " + std::to_string(next_keyframe_) + " keyframes, not " +
                            std::to_string(recording_.frames) + " and " + std::to_string(scans_.size()),
                        "the recording was cut short or mixed with another: copy it again");
  }

  RecordingInfo recording_;
  bool intensities_;  ///< whether scans are given with them: rounded points of a map have none
  std::vector<fs::path> scans_;
  RecordedTable<FrameRow> frames_;
  std::optional<RecordedTable<FixRow>> fixes_;
  std::int64_t given_ = 0, next_keyframe_ = 0;
  std::vector<GnssFix> passed_;
  std::deque<Packet> waiting_;
};

}  // namespace

bool is_recorded_odometry(const fs::path& folder) {
  return fs::is_regular_file(folder / recording_description) && fs::is_regular_file(folder / "frames.csv");
}

std::unique_ptr<Dataset> open_recorded_odometry(const fs::path& folder, const DatasetOptions& options) {
  return std::make_unique<RecordedSet>(folder, options);
}

}  // namespace chainslam::datasets
