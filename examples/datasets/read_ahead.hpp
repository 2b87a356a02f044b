#pragma once

#include <cstddef>
#include <exception>
#include <functional>
#include <optional>
#include <stop_token>
#include <thread>
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
  explicit ReadAhead(std::function<std::optional<Packet>()> read, Index scans = 0);

  /// The next packet, nothing after the last. @throws what reading it has thrown.
  [[nodiscard]] std::optional<Packet> next();

 private:
  using Packets = std::vector<Packet>;

  void run(const std::stop_token& stop);
  /// Up to the next scan. @returns whether there may be more.
  bool read_to_scan(Packets& packets, const std::stop_token& stop);

  std::function<std::optional<Packet>()> read_;
  const Index scans_;
  Index read_scans_ = 0;
  Channel<Packets> read_ahead_{2};  // another is being read, and one is being taken
  std::exception_ptr failure_;      ///< of reading, once the channel is closed
  Packets taken_;                   ///< from the channel,
  std::size_t next_ = 0;            ///< and which of them comes next
  std::jthread thread_;             ///< last: it stops before what it uses goes
};

}  // namespace chainslam::datasets
