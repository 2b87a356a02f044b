#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <optional>
#include <span>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// When a gap is one, and for how long packets are sorted.
struct TimeOrderOptions {
  Duration delay = std::chrono::milliseconds(200);   ///< of data time, that a packet waits for earlier ones
  std::size_t capacity = 100'000;                    ///< packets waiting; past it the earliest goes without waiting
  std::size_t scan_capacity = 256;                   ///< the same for scans, which are large: stamps may stand still
  Duration backward_jump = std::chrono::seconds(1);  ///< a sensor's step back by more is its clock set again
  /// A sensor's step forward by more is reported as a gap: imu, lidar, gnss.
  std::array<Duration, 3> gap = {std::chrono::milliseconds(300), std::chrono::seconds(1), std::chrono::seconds(10)};
  std::size_t kept_breaks = 100;  ///< breaks kept one by one; all are counted
};

/// A place where one sensor's time does not run on as it should.
struct TimeBreak {
  /// What is wrong with the times.
  enum class Kind { gap, backward_jump };
  Kind kind = Kind::gap;                ///< what is wrong
  SensorKind sensor = SensorKind::imu;  ///< whose packets they are
  Index number = 0;                     ///< of the sensor among those of its kind
  Timestamp before;                     ///< latest time the sensor had stated
  Timestamp after;                      ///< time it stated next
};

/// What `TimeOrder` met so far. Arrays count by `SensorKind`.
struct TimeOrderReport {
  std::array<std::size_t, 3> received{};   ///< packets that came, by `SensorKind`
  std::array<std::size_t, 3> delivered{};  ///< packets that were passed on, by `SensorKind`
  std::array<std::size_t, 3> late{};       ///< dropped: something later had already been delivered
  std::array<std::size_t, 3> reordered{};  ///< came after a later one of the same sensor, and were put in place
  std::array<std::size_t, 3> repeated{};   ///< had the very time of the same sensor's latest; delivered all the same
  std::array<std::size_t, 3> gaps{};       ///< gaps, by `SensorKind`
  std::array<std::size_t, 3> backward_jumps{};  ///< jumps back in time, by `SensorKind`
  std::size_t hurried = 0;                      ///< delivered before their delay because the buffer was full
  std::vector<TimeBreak> breaks;                ///< the first `kept_breaks` gaps and jumps
};

/// Merges the packets of several sensors into the order of `available_at`: a scan counts at its end.
///
/// A packet is delivered once another is `delay` newer, so a sensor may lag behind the others by that much. Equal times
/// come out as IMU, LiDAR, GNSS, then as they came in: the order depends on nothing but the input. What comes later
/// than something already delivered is dropped and counted. When a sensor's clock is set back, all that waits is
/// delivered and the order restarts at the new time; packets that other sensors still stamp by the old clock may
/// then drop as late.
class TimeOrder {
 public:
  explicit TimeOrder(TimeOrderOptions options = {}) : options_(options) {}  ///< starts without packets

  /// Takes a packet of the `number`-th sensor of its kind.
  /// @throws std::invalid_argument after `finish`, or if a scan ends before it begins.
  void push(Packet packet, Index number = 0) {
    if (finished_) throw std::invalid_argument("TimeOrder: no packet may follow finish()");
    if (const auto* scan = std::get_if<LidarScan>(&packet); scan != nullptr && scan->end < scan->time)
      throw std::invalid_argument("TimeOrder: a scan must not end before it begins");
    const Timestamp time = available_at(packet);
    const SensorKind kind = sensor_kind(packet);
    ++count(report_.received, kind);
    watch(kind, number, time);
    if (delivered_ && *delivered_ > std::pair(epoch_, time)) {
      ++count(report_.late, kind);
      return;
    }
    if (!newest_ || time > *newest_) newest_ = time;
    if (kind == SensorKind::lidar) ++scans_;
    waiting_.push_back({epoch_, time, kind, arrivals_++, std::move(packet)});
    std::push_heap(waiting_.begin(), waiting_.end(), Later{});
  }

  /// The next packet in the order of time, once nothing earlier is waited for.
  [[nodiscard]] std::optional<Packet> pop() {
    if (waiting_.empty()) return std::nullopt;
    const Waiting& first = waiting_.front();
    const bool certain = finished_ || first.epoch < epoch_ || *newest_ - first.time >= options_.delay;
    const bool full = waiting_.size() > options_.capacity || scans_ > options_.scan_capacity;
    if (!certain && !full) return std::nullopt;
    if (!certain) ++report_.hurried;
    std::pop_heap(waiting_.begin(), waiting_.end(), Later{});
    Waiting next = std::move(waiting_.back());
    waiting_.pop_back();
    if (next.kind == SensorKind::lidar) --scans_;
    delivered_ = std::pair(next.epoch, next.time);
    ++count(report_.delivered, next.kind);
    return std::move(next.packet);
  }

  /// Says that no packet will follow: all that waits may be popped.
  void finish() { finished_ = true; }

  [[nodiscard]] std::size_t waiting() const { return waiting_.size(); }    ///< packets that wait to be sorted
  [[nodiscard]] const TimeOrderReport& report() const { return report_; }  ///< what was seen so far

 private:
  struct Waiting {
    Index epoch;
    Timestamp time;
    SensorKind kind;
    std::size_t arrival;
    Packet packet;
  };
  struct Later {
    bool operator()(const Waiting& a, const Waiting& b) const {
      return std::tie(a.epoch, a.time, a.kind, a.arrival) > std::tie(b.epoch, b.time, b.kind, b.arrival);
    }
  };
  struct Sensor {
    SensorKind kind;
    Index number;
    Timestamp newest;
  };

  static std::size_t& count(std::array<std::size_t, 3>& counts, SensorKind kind) {
    return counts[static_cast<std::size_t>(kind)];
  }

  /// Compares a packet's time with what its sensor last stated.
  void watch(SensorKind kind, Index number, Timestamp time) {
    const auto sensor = std::find_if(sensors_.begin(), sensors_.end(),
                                     [&](const Sensor& s) { return s.kind == kind && s.number == number; });
    if (sensor == sensors_.end()) {
      sensors_.push_back({kind, number, time});
      return;
    }
    const Duration step = time - sensor->newest;
    if (step < -options_.backward_jump) {
      note({TimeBreak::Kind::backward_jump, kind, number, sensor->newest, time}, report_.backward_jumps);
      begin_epoch();
      sensor->newest = time;
    } else if (step < Duration::zero()) {
      if (!delivered_ || *delivered_ <= std::pair(epoch_, time)) ++count(report_.reordered, kind);
    } else if (step == Duration::zero()) {
      ++count(report_.repeated, kind);
    } else {
      if (step > options_.gap[static_cast<std::size_t>(kind)])
        note({TimeBreak::Kind::gap, kind, number, sensor->newest, time}, report_.gaps);
      sensor->newest = time;
    }
  }

  void note(const TimeBreak& found, std::array<std::size_t, 3>& counts) {
    ++count(counts, found.sensor);
    if (report_.breaks.size() < options_.kept_breaks) report_.breaks.push_back(found);
  }

  void begin_epoch() {
    ++epoch_;
    newest_.reset();
  }

  TimeOrderOptions options_;
  TimeOrderReport report_;
  std::vector<Waiting> waiting_;  ///< a heap, earliest first
  std::vector<Sensor> sensors_;
  std::optional<Timestamp> newest_;                       ///< of this epoch
  std::optional<std::pair<Index, Timestamp>> delivered_;  ///< epoch and time of the latest delivery
  Index epoch_ = 0;                                       ///< grows when a clock is set back
  std::size_t arrivals_ = 0;
  std::size_t scans_ = 0;  ///< that wait
  bool finished_ = false;
};

}  // namespace chainslam
