#pragma once

#include <cstddef>
#include <exception>
#include <functional>
#include <optional>
#include <stop_token>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/core/channel.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam::datasets {

/// Reads packets on a thread of its own while others are worked on: up to four scans ahead of who takes them.
class ReadAhead {
 public:
  /// @param read  gives the next packet, nothing at the end. Called on the reading thread, while the object lives.
  /// @param scans  after how many it reads no further; 0: never.
  explicit ReadAhead(std::function<std::optional<Packet>()> read, Index scans = 0)
      : read_(std::move(read)), scans_(scans), thread_([this](const std::stop_token& stop) { run(stop); }) {}

  /// The next packet, nothing after the last. @throws what reading it has thrown.
  [[nodiscard]] std::optional<Packet> next() {
    while (next_ == taken_.size()) {
      std::optional<Packets> packets = read_ahead_.pop();
      if (!packets && failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
      if (!packets) return std::nullopt;
      taken_ = std::move(*packets);
      next_ = 0;
    }
    return std::move(taken_[next_++]);
  }

 private:
  using Packets = std::vector<Packet>;

  void run(const std::stop_token& stop) {
    for (bool more = true; more;) {
      Packets packets;
      try {
        more = read_to_scan(packets, stop);
      } catch (...) {
        failure_ = std::current_exception();
        more = false;
      }
      if (!read_ahead_.push(std::move(packets), stop)) break;
    }
    read_ahead_.close();
  }

  /// @returns whether there may be more.
  bool read_to_scan(Packets& packets, const std::stop_token& stop) {
    constexpr std::size_t most = 1000;  // where scans are far apart
    while (!stop.stop_requested() && packets.size() < most) {
      std::optional<Packet> packet = read_();
      if (!packet) return false;
      packets.push_back(std::move(*packet));
      if (std::holds_alternative<LidarScan>(packets.back())) return ++read_scans_ != scans_;
    }
    return !stop.stop_requested();
  }

  std::function<std::optional<Packet>()> read_;
  const Index scans_;
  Index read_scans_ = 0;
  Channel<Packets> read_ahead_{2};  // besides those being read and those being taken
  std::exception_ptr failure_;      ///< of reading, once the channel is closed
  Packets taken_;                   ///< from the channel,
  std::size_t next_ = 0;            ///< and which of them comes next
  std::jthread thread_;             ///< last: it stops before what it uses goes
};

}  // namespace chainslam::datasets
