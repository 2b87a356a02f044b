#include <algorithm>
#include <array>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/time_order.hpp"
#include "datasets/dataset.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/imu_conversion.hpp"
#include "datasets/ros_recording.hpp"
#include "datasets/statistics.hpp"
#include "datasets/transform_tree.hpp"

// A recording of ROS messages, one file or a folder of its parts. One LiDAR, one inertial unit and one receiver are
// read: those that the options name, else those that send most in the recording's first three seconds.

namespace chainslam::datasets {
namespace {

constexpr Duration look_ahead = std::chrono::seconds(3);
constexpr std::size_t most_samples = 20'000;    ///< of an IMU that are looked at for their units
constexpr std::size_t most_messages = 100'000;  ///< of the beginning: stamps that stand still must not make it all
constexpr std::size_t most_tries = 10;          ///< scans looked at for the meaning of their time field

/// What a topic's messages came to while reading.
struct Tally {
  std::size_t messages = 0, points = 0, noise = 0, damaged = 0, unstamped = 0, implausible = 0, unplaced = 0;
  std::string first_damage;
};

/// What is known of a topic.
struct Topic {
  MessageKind kind = MessageKind::other;
  std::string type, frame, fields;
  Tally tally;
  // Of a LiDAR:
  std::optional<PointTimeRule> rule{};
  PointTimeStatus times = PointTimeStatus::unusable;
  std::size_t tries = 0;
  std::string sentence;
  std::optional<Duration> clock_difference{};
  // Of an inertial unit:
  std::vector<ImuSample> beginning{};
  std::optional<ImuConversion> convert{};
  // Of a receiver:
  std::optional<double> altitude{};

  [[nodiscard]] SensorKind sensor() const {
    return kind == MessageKind::imu ? SensorKind::imu : kind == MessageKind::fix ? SensorKind::gnss : SensorKind::lidar;
  }
  [[nodiscard]] bool readable() const { return kind > MessageKind::transforms; }
};

using Topics = std::map<std::string, Topic>;

/// Reads a recording's parts one after the other.
class RecordingParts {
 public:
  explicit RecordingParts(std::vector<std::filesystem::path> files) : files_(std::move(files)) {}

  std::optional<RosMessage> next() {
    while (recording_ || file_ < files_.size()) {
      if (!recording_) recording_ = open_recording(files_[file_]);
      if (auto message = recording_->next()) return message;
      for (const std::string& loss : recording_->losses())
        losses_.push_back(files_[file_].filename().string() + ", " + loss);
      recording_.reset();
      ++file_;
    }
    return std::nullopt;
  }

  [[nodiscard]] const std::vector<std::string>& losses() const { return losses_; }  ///< of the parts that are read
  [[nodiscard]] std::string place(const RosMessage& message) const {
    return files_[file_].filename().string() + ", " + std::string(message.unit) + " " + std::to_string(message.at);
  }

 private:
  std::vector<std::filesystem::path> files_;
  std::size_t file_ = 0;
  std::unique_ptr<RosRecording> recording_;
  std::vector<std::string> losses_;
};

class RosDataset final : public Dataset {
 public:
  RosDataset(const std::filesystem::path& path, const DatasetOptions& options)
      : options_(options),
        hints_(options.point_time),
        chosen_{options.imu_topic, options.lidar_topic, options.gnss_topic},
        parts_(recording_files(path)) {
    info_.kind = DatasetKind::ros;
    info_.path = path;
    info_.name = std::filesystem::is_directory(path) ? folder_name(path) : path.stem().string();
    info_.truth = options.truth;
    Topics topics = look(path);
    for (const SensorKind kind : {SensorKind::imu, SensorKind::lidar, SensorKind::gnss}) choose(kind, topics);
    describe(topics);
    find_mounting(topics, options);
    for (auto& [name, topic] : topics) topic.tally = {};  // counted again while reading
    topics_ = std::move(topics);
  }

  std::optional<Packet> next() override {
    for (;;) {
      if (auto packet = order_.pop()) return packet;
      if (ended_) return std::nullopt;
      if (const auto message = parts_.next()) {
        Topic& topic = topic_of(*message);
        if (chosen(topic.sensor()).empty() && topic.readable()) chosen(topic.sensor()) = message->topic->name;
        if (!topic.readable() || chosen(topic.sensor()) != message->topic->name) continue;
        if (auto packet = decode(*message, topic)) order_.push(std::move(*packet));
      } else {
        order_.finish();
        ended_ = true;
        note_losses();
      }
    }
  }

 private:
  std::string& chosen(SensorKind kind) { return chosen_[static_cast<std::size_t>(kind)]; }

  /// Reads the recording's beginning. @throws IoError if there is no message in it.
  Topics look(const std::filesystem::path& path) {
    RecordingParts parts(recording_files(path));
    std::optional<Timestamp> first;
    for (std::size_t messages = 0; messages < most_messages; ++messages) {
      const auto message = parts.next();
      if (!message) break;
      if (!first) first = message->time;
      if (message->time - *first > look_ahead) break;
      Topic& topic = topic_of(*message);
      const auto packet = decode(*message, topic);
      if (!packet) continue;
      if (const auto* sample = std::get_if<ImuSample>(&*packet);
          sample != nullptr && topic.beginning.size() < most_samples)
        topic.beginning.push_back(*sample);
      if (const auto* scan = std::get_if<LidarScan>(&*packet); scan != nullptr && !info_.start)
        info_.start = scan->time;
    }
    if (!first)
      throw_input_error(path.string(), "", parts.losses().empty() ? "a recording without messages" : parts.losses()[0],
                        "record or copy it again");
    return std::move(topics_);
  }

  Topic& topic_of(const RosMessage& message) {
    const auto [entry, added] = topics_.try_emplace(message.topic->name);
    if (added) {
      entry->second.type = message.topic->type;
      entry->second.kind = kind_of_message(message.topic->type);
    }
    ++entry->second.tally.messages;
    return entry->second;
  }

  std::optional<Packet> decode(const RosMessage& message, Topic& topic) {
    try {
      const MessageReader reader(message.data, message.topic->encoding);
      switch (topic.kind) {
        case MessageKind::cloud:
          return scan(decode_point_cloud2(reader), topic, message);
        case MessageKind::livox:
          return scan(decode_livox(reader), topic, message);
        case MessageKind::imu:
          return sample(decode_imu(reader), topic, message);
        case MessageKind::fix:
          return fix(decode_fix(reader), topic, message);
        case MessageKind::transforms:
          if (message.topic->name.ends_with("tf_static")) transforms_.add(reader);
          break;
        case MessageKind::other:
        case MessageKind::raw_packets:
          break;
      }
    } catch (const MessageError& error) {
      if (topic.tally.damaged++ == 0) topic.tally.first_damage = parts_.place(message) + ": " + error.what();
    }
    return std::nullopt;
  }

  /// A message's stamp, or the time of its recording if its driver wrote none.
  static Timestamp stamp_of(const RosHeader& header, Topic& topic, const RosMessage& message) {
    if (topic.frame.empty()) topic.frame = header.frame;
    if (header.stamp > Timestamp()) return header.stamp;
    ++topic.tally.unstamped;
    return message.time;
  }

  std::optional<Packet> scan(RosCloud&& cloud, Topic& topic, const RosMessage& message) {
    const Timestamp stamp = stamp_of(cloud.header, topic, message);
    if (topic.fields.empty()) topic.fields = cloud.fields;
    if (cloud.clock_difference && !topic.clock_difference) topic.clock_difference = cloud.clock_difference;
    topic.tally.points += cloud.points.cloud.size();
    topic.tally.noise += cloud.noise;
    infer_times(cloud, stamp, topic);
    LidarScan scan{.time = stamp, .end = stamp, .cloud = std::move(cloud.points.cloud)};
    if (!topic.rule || scan.cloud.empty() || cloud.points.times.size() != scan.cloud.size()) return scan;
    PointTimes times;
    try {
      times = apply_point_time(*topic.rule, cloud.points.times, stamp);
    } catch (const std::invalid_argument&) {
      ++topic.tally.unplaced;
      return std::nullopt;
    }
    if (!times.plausible || !is_recorded_time(times.time)) {
      ++topic.tally.implausible;
      return std::nullopt;
    }
    scan.time = times.time;
    scan.end = times.end;
    scan.cloud.time_offsets = std::move(times.offsets);
    return scan;
  }

  /// The first scans may be cut short, or empty: some are looked at until one says what its times mean.
  void infer_times(const RosCloud& cloud, Timestamp stamp, Topic& topic) const {
    if (topic.rule || topic.tries >= most_tries || cloud.points.cloud.empty()) return;
    ++topic.tries;
    if (cloud.rule) {
      topic.rule = cloud.rule;
      topic.times = PointTimeStatus::inferred;
      topic.sentence = "time per point: ns from the time base";
      return;
    }
    if (cloud.points.time_field.empty()) {
      topic.times = PointTimeStatus::absent;
      topic.sentence = "no time per point";
      topic.tries = most_tries;
      return;
    }
    const PointTimeInference inference = infer_point_time(cloud.points.times, stamp, hints_);
    topic.times = inference.status;
    topic.sentence = "field " + cloud.points.time_field + ": " + inference.sentence;
    if (inference.status == PointTimeStatus::inferred) topic.rule = inference.rule;
  }

  static std::optional<Packet> sample(RosImu&& imu, Topic& topic, const RosMessage& message) {
    imu.sample.time = stamp_of(imu.header, topic, message);
    return topic.convert ? (*topic.convert)(imu.sample) : imu.sample;
  }

  static std::optional<Packet> fix(RosFix&& fix, Topic& topic, const RosMessage& message) {
    const Timestamp time = stamp_of(fix.header, topic, message);
    const bool flat = !is_finite(fix.position.altitude);
    if (!flat) topic.altitude = fix.position.altitude;
    if (flat && topic.altitude) fix.position.altitude = *topic.altitude;
    if (fix.status < 0 || !plausible(fix.position)) {
      ++topic.tally.unplaced;
      return std::nullopt;
    }
    GnssDeviation deviation = fix.deviation.value_or(GnssDeviation{.horizontal = 3, .vertical = 6});
    if (flat) deviation.vertical = 50;
    return make_fix(time, fix.position, deviation, quality(fix, deviation, flat));
  }

  static GnssQuality quality(const RosFix& fix, const GnssDeviation& deviation, bool flat) {
    if (flat) return GnssQuality::two_dimensional;
    if (fix.status == 0) return GnssQuality::three_dimensional;
    if (fix.status == 1) return GnssQuality::differential;
    return deviation.horizontal < 0.1 ? GnssQuality::rtk_fixed : GnssQuality::rtk_float;
  }

  /// The topic of a kind that sends most, unless the options name one.
  void choose(SensorKind kind, const Topics& topics) {
    if (!chosen(kind).empty()) return;
    std::size_t most = 0;
    for (const auto& [name, topic] : topics) {
      const std::size_t size =
          kind == SensorKind::lidar ? topic.tally.points : topic.tally.messages - topic.tally.damaged;
      if (!topic.readable() || topic.sensor() != kind || size <= most) continue;
      most = size;
      chosen(kind) = name;
    }
  }

  void describe(Topics& topics) {
    std::string others;
    for (auto& [name, topic] : topics) {
      if (topic.kind == MessageKind::raw_packets)
        info_.warnings.push_back(name + " holds a sensor's raw packets (" + topic.type +
                                 "): let its driver make points of them first");
      if (!topic.readable()) {
        if (topic.kind == MessageKind::transforms && name.ends_with("tf_static")) continue;
        others += (others.empty() ? "" : ", ") + name + " (" + topic.type + ")";
        continue;
      }
      const bool used = chosen(topic.sensor()) == name;
      if (used) prepare(topic);
      info_.sensors.push_back({name, topic.sensor(), std::nullopt, remark(topic, used)});
    }
    if (!others.empty()) info_.notes.push_back("topics that are not read: " + others);
  }

  /// Where the LiDAR sits on the inertial unit: as given, or as /tf_static states it at the start.
  void find_mounting(const Topics& topics, const DatasetOptions& options) {
    const auto lidar = topics.find(chosen(SensorKind::lidar)), imu = topics.find(chosen(SensorKind::imu));
    if (lidar == topics.end() || imu == topics.end()) return set_extrinsic(options, std::nullopt, false, info_);
    const std::string frames = imu->second.frame + " to " + lidar->second.frame;
    auto stated = find_extrinsic({info_.path, info_.path.parent_path()});
    if (const auto T = transforms_.between(imu->second.frame, lidar->second.frame)) {
      if (!stated) stated = {*T, frames + ", as /tf_static states it"};
      if (const auto gnss = topics.find(chosen(SensorKind::gnss)); gnss != topics.end())
        if (const auto T_body_antenna = transforms_.between(imu->second.frame, gnss->second.frame))
          info_.p_body_antenna = T_body_antenna->translation();
    } else if (!stated) {
      info_.notes.push_back("no /tf_static leads from " + frames);
    }
    set_extrinsic(options, stated, true, info_);
  }

  std::string remark(const Topic& topic, bool used) {
    std::string text = topic.type + (topic.frame.empty() ? "" : ", frame " + topic.frame);
    if (!topic.fields.empty()) text += ", fields " + topic.fields;
    if (!used) text += "; not used: another topic of its kind is read";
    return text;
  }

  /// What the beginning says of a topic that will be read.
  void prepare(Topic& topic) {
    if (topic.sensor() == SensorKind::lidar) {
      info_.motion_corrected = !topic.rule;
      const bool clear = topic.times == PointTimeStatus::inferred || topic.times == PointTimeStatus::absent;
      (clear ? info_.notes : info_.warnings)
          .push_back(topic.sentence + (topic.rule ? "" : "; scans are taken as snapshots") +
                     (clear ? "" : point_time_settings));
      if (topic.clock_difference)
        info_.warnings.push_back("the LiDAR's own clock is " + text_of(to_seconds(*topic.clock_difference)) +
                                 " s from its messages' stamps, which are used");
    }
    if (topic.kind != MessageKind::imu) return;
    topic.convert.emplace(options_, topic.beginning, info_);
    topic.beginning = {};
  }

  void note_losses() {
    for (const std::string& loss : parts_.losses()) info_.warnings.push_back(loss);
    for (const auto& [name, topic] : topics_) {
      const auto note = [&, &topic_name = name](std::size_t count, const std::string& what) {
        if (count > 0) info_.warnings.push_back(topic_name + ": " + std::to_string(count) + " " + what);
      };
      note(topic.tally.damaged, "messages that are damaged are left out; the first, " + topic.tally.first_damage);
      note(topic.tally.unstamped, "messages without a stamp take the time of their recording");
      note(topic.tally.implausible, "scans whose points span too long a time are left out");
      note(topic.tally.unplaced,
           topic.kind == MessageKind::fix ? "messages without a fix" : "scans without a usable time are left out");
      if (topic.tally.noise > 0)
        info_.notes.push_back(name + ": " + std::to_string(topic.tally.noise) +
                              " points left out that the sensor marks as noise");
    }
    for (const SensorKind kind : {SensorKind::imu, SensorKind::lidar, SensorKind::gnss})
      if (const std::string& name = chosen(kind); !name.empty() && !topics_.contains(name))
        info_.warnings.push_back("no messages on " + name);
    if (chosen(SensorKind::lidar).empty()) info_.warnings.emplace_back("no scans: no PointCloud2 or Livox CustomMsg");
    const TimeOrderReport& report = order_.report();
    const auto count = [&](const std::array<std::size_t, 3>& counts, const char* what) {
      std::size_t sum = 0;
      for (const std::size_t part : counts) sum += part;
      if (sum > 0) info_.warnings.push_back(std::to_string(sum) + what);
    };
    count(report.repeated, " packets have the very time of the one before");
    count(report.backward_jumps, " times a clock was set back");
    if (report.hurried > 0)
      info_.warnings.push_back(std::to_string(report.hurried) +
                               " packets were not put in order: their times stand still");
    count(report.late, " packets dropped that were recorded far too late");
  }

  DatasetOptions options_;
  PointTimeHints hints_;
  std::array<std::string, 3> chosen_;  ///< topics to read, by `SensorKind`
  RecordingParts parts_;
  TransformTree transforms_;
  Topics topics_;
  TimeOrder order_{TimeOrderOptions{.delay = std::chrono::seconds(1)}};
  bool ended_ = false;
};

}  // namespace

std::unique_ptr<Dataset> open_ros(const std::filesystem::path& path, const DatasetOptions& options) {
  return std::make_unique<RosDataset>(path, options);
}

}  // namespace chainslam::datasets
