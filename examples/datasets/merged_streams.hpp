#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <optional>
#include <tuple>
#include <utility>
#include <vector>

#include "chainslam/sensor/packet.hpp"

namespace chainslam::datasets {

/// Merges the packets of several files into time order, holding one packet of each. Equal times come out as IMU, LiDAR,
/// GNSS. A packet that is earlier than its own file's last is dropped and counted.
class MergedStreams {
 public:
  using Stream = std::function<std::optional<Packet>()>;

  void add(Stream stream) { streams_.push_back({std::move(stream), std::nullopt, std::nullopt, false}); }

  [[nodiscard]] std::optional<Packet> next() {
    for (Head& head : streams_) fill(head);
    const auto first = std::ranges::min_element(streams_, [](const Head& a, const Head& b) {
      if (!a.packet || !b.packet) return a.packet.has_value() && !b.packet.has_value();
      return std::tuple(available_at(*a.packet), sensor_kind(*a.packet)) <
             std::tuple(available_at(*b.packet), sensor_kind(*b.packet));
    });
    if (first == streams_.end()) return std::nullopt;
    return std::exchange(first->packet, std::nullopt);
  }

  [[nodiscard]] std::size_t dropped() const { return dropped_; }  ///< packets that went back in time

 private:
  struct Head {
    Stream stream;
    std::optional<Packet> packet;
    std::optional<Timestamp> last;
    bool ended = false;
  };

  void fill(Head& head) {
    while (!head.packet && !head.ended) {
      head.packet = head.stream();
      head.ended = !head.packet;
      if (head.ended) return;
      const Timestamp time = available_at(*head.packet);
      if (head.last && time < *head.last) {
        head.packet.reset();
        ++dropped_;
      } else {
        head.last = time;
      }
    }
  }

  std::vector<Head> streams_;
  std::size_t dropped_ = 0;
};

}  // namespace chainslam::datasets
