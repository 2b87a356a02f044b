#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::bench {

using ScanPtr = std::shared_ptr<const PointCloud<float>>;

/// A drive as the mapper's front end has it, and where its keyframes were.
struct KnownDrive {
  std::string name{};
  std::string sensor{};
  std::string place{};  ///< drives of the same place have their truths in one frame
  bool real = true;
  std::vector<Keyframe> keyframes{};  ///< T_map_body is odometry's; clouds downsampled as the mapper does
  std::vector<ScanPtr> full{};        ///< scans that were not downsampled; none where they are not kept
  std::vector<SE3d> truth{};          ///< T_place_body, for each keyframe
};

/// Which keyframes are picked of a drive.
struct Picking {
  double distance = KeyframeOptions{}.distance;  ///< metres
  std::size_t full_every = 4;                    ///< of the keyframes, one in so many keeps its whole scan
};

/// T_place_body at a time, where it is known; no function: odometry's own pose counts, which over the few metres
/// between two keyframes that are compared is off by centimetres.
using TruthAt = std::function<std::optional<SE3d>(Timestamp)>;

/// Takes frames of odometry and keeps those that become keyframes.
class DriveRecorder {
 public:
  DriveRecorder(KnownDrive drive, const Picking& picking, TruthAt truth)
      : drive_(std::move(drive)),
        picking_(picking),
        selector_(KeyframeOptions{.distance = picking.distance}),
        truth_(std::move(truth)) {}

  void add(const Frame& frame) {
    std::optional<Keyframe> keyframe = selector_(frame);
    if (!keyframe) return;
    const std::optional<SE3d> truth = truth_ ? truth_(keyframe->time) : keyframe->T_odom_body;
    if (!truth) return;
    const std::size_t at = drive_.keyframes.size();
    keyframe->id = KeyframeId{to_index(at)};
    keyframe->session = SessionId{0};
    keyframe->T_map_body = keyframe->T_odom_body;
    const bool whole = picking_.full_every > 0 && at % picking_.full_every == 0;
    drive_.full.push_back(whole ? std::make_shared<const PointCloud<float>>(frame.cloud) : nullptr);
    drive_.keyframes.push_back(std::move(*keyframe));
    drive_.truth.push_back(*truth);
  }

  [[nodiscard]] KnownDrive finish() { return std::move(drive_); }

 private:
  KnownDrive drive_;
  Picking picking_;
  KeyframeSelector selector_;
  TruthAt truth_;
};

/// Runs odometry over packets.
/// @param next_packet  yields `std::optional<Packet>`, nothing after the last one.
template <class NextPacket>
[[nodiscard]] KnownDrive follow(KnownDrive drive, const SE3d& T_body_lidar, const Picking& picking, TruthAt truth,
                                NextPacket&& next_packet) {
  LidarOdometry<>::Options options;
  options.T_body_lidar = T_body_lidar;
  LidarOdometry<> odometry(options);
  DriveRecorder recorder(std::move(drive), picking, std::move(truth));
  while (const std::optional<Packet> packet = next_packet())
    if (const std::optional<Frame> frame = odometry.process(*packet)) recorder.add(*frame);
  return recorder.finish();
}

/// Every second keyframe, from the first or the second one on: of a drive that passes each place once, one half is the
/// map in which scans of the other are sought. Keyframes have to be picked at half the mapper's distance.
[[nodiscard]] inline KnownDrive half_of(const KnownDrive& drive, std::size_t first) {
  KnownDrive half{.name = drive.name + (first == 0 ? " even" : " odd"),
                  .sensor = drive.sensor,
                  .place = drive.place,
                  .real = drive.real};
  for (std::size_t i = first; i < drive.keyframes.size(); i += 2) {
    half.keyframes.push_back(drive.keyframes[i]);
    half.keyframes.back().id = KeyframeId{to_index(half.keyframes.size() - 1)};
    half.full.push_back(drive.full[i]);
    half.truth.push_back(drive.truth[i]);
  }
  return half;
}

}  // namespace chainslam::bench
