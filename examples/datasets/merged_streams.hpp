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
/// GNSS. A packet that is earlier than its own file's last is dropped and counted, and so is one that is ahead of its
/// file's next although that runs on from the one before: one wrong time would else cost all packets after it.
class MergedStreams {
 public:
  using Stream = std::function<std::optional<Packet>()>;

  void add(Stream stream) { streams_.push_back({.stream = std::move(stream)}); }

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
    Stream stream{};
    std::optional<Packet> packet{}, ahead{};  ///< that comes out next, and the one after it
    std::optional<Timestamp> last{};
    bool ended = false;  ///< nothing is ahead

    [[nodiscard]] bool runs_on(Timestamp time) const { return !last || time >= *last; }
    void read() {
      if (!ended) ahead = stream();
      ended = !ahead;
    }
  };

  void fill(Head& head) {
    if (!head.packet && !head.ahead) head.read();
    while (!head.packet && head.ahead) {
      Packet packet = *std::exchange(head.ahead, std::nullopt);
      head.read();
      const Timestamp time = available_at(packet);
      const bool too_early = !head.runs_on(time);
      if (too_early || (head.ahead && available_at(*head.ahead) < time && head.runs_on(available_at(*head.ahead)))) {
        ++dropped_;
        continue;
      }
      head.last = time;
      head.packet = std::move(packet);
    }
  }

  std::vector<Head> streams_;
  std::size_t dropped_ = 0;
};

}  // namespace chainslam::datasets
