#pragma once

#include <concepts>
#include <optional>
#include <utility>

#include "chainslam/map/frame.hpp"

namespace chainslam {

/// Yields the frames of one session, one after the other.
///
/// Laws: `next()` gives frames with strictly ascending times whose poses are finite, all in one `odom` frame that
/// drifts but never jumps because of anything outside of odometry; after the first `nullopt` it only gives `nullopt`.
template <class T>
concept OdometrySource = requires(T& source) {
  { source.next() } -> std::same_as<std::optional<Frame>>;
};

/// Runs an odometry over packets: a source from `next_packet() -> std::optional<Packet>` and an object with
/// `process(const Packet&) -> std::optional<Frame>`, such as `LidarOdometry`.
template <class Odometry, class Packets>
class PacketOdometry {
 public:
  /// @param next_packet  returns an optional packet; nothing at the end.
  PacketOdometry(Odometry odometry, Packets next_packet)
      : odometry_(std::move(odometry)), next_packet_(std::move(next_packet)) {}

  /// The next frame; nothing at the end.
  [[nodiscard]] std::optional<Frame> next() {
    while (const auto packet = next_packet_())
      if (auto frame = odometry_.process(*packet)) return frame;
    return std::nullopt;
  }

  [[nodiscard]] const Odometry& odometry() const { return odometry_; }  ///< the odometry

 private:
  Odometry odometry_;
  Packets next_packet_;
};

}  // namespace chainslam
