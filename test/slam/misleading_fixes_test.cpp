#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/slam/back_end.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "datasets/dataset.hpp"
#include "mapper/presets.hpp"
#include "support/drive_run.hpp"
#include "support/real_data.hpp"
#include "support/real_drives.hpp"
#include "support/real_matrix.hpp"

// Sessions of real scans whose fixes say that they are of one place: of different places they must not be joined by the
// mapper's default settings, and of one place they must.

using namespace chainslam;

namespace {

using MisledKeyframes = std::vector<Keyframe>;

/// Keyframes of frames, as the mapper picks them.
/// @param next_frame  yields `std::optional<Frame>`, nothing after the last one.
template <class NextFrame>
MisledKeyframes picked(const NextFrame& next_frame) {
  KeyframeSelector selector;
  MisledKeyframes keyframes;
  while (const std::optional<Frame> frame = next_frame())
    if (std::optional<Keyframe> keyframe = selector(*frame)) keyframes.push_back(std::move(*keyframe));
  return keyframes;
}

MisledKeyframes recorded_keyframes(const std::filesystem::path& folder) {
  const auto dataset = datasets::open_dataset(folder);
  return picked([&] { return dataset->next_frame(); });
}

/// Runs odometry over scans. @param next_packet  yields `std::optional<Packet>`, nothing after the last one.
template <class NextPacket>
MisledKeyframes followed_keyframes(NextPacket&& next_packet) {
  LidarOdometry<> odometry;
  return picked([&]() -> std::optional<Frame> {
    while (const std::optional<Packet> packet = next_packet())
      if (std::optional<Frame> frame = odometry.process(*packet)) return frame;
    return std::nullopt;
  });
}

/// @param begin, end  of its scans.
MisledKeyframes range_image_keyframes(const std::filesystem::path& folder, std::size_t begin, std::size_t end) {
  const auto dataset = datasets::open_dataset(folder);
  std::size_t scans = 0;
  return followed_keyframes([&]() -> std::optional<Packet> {
    while (std::optional<Packet> packet = dataset->next()) {
      if (!std::holds_alternative<LidarScan>(*packet) || scans++ < begin) continue;
      return scans <= end ? packet : std::nullopt;
    }
    return std::nullopt;
  });
}

/// Metres along the path up to each keyframe.
std::vector<double> travelled_by(const MisledKeyframes& keyframes) {
  std::vector<SE3d> poses;
  for (const Keyframe& keyframe : keyframes) poses.push_back(keyframe.T_odom_body);
  return path_lengths(poses);
}

/// Fixes along one straight road, as far from its start as the path is long; past its length it begins again.
MisledKeyframes with_fixes(MisledKeyframes keyframes, double length_of_road) {
  const std::vector<double> travelled = travelled_by(keyframes);
  for (std::size_t i = 0; i < keyframes.size(); ++i)
    keyframes[i].gnss = GnssFix{.time = keyframes[i].time,
                                .position_ecef = {6378137, std::fmod(travelled[i], length_of_road), 0},
                                .quality = GnssQuality::three_dimensional};
  return keyframes;
}

struct Joining {
  std::shared_ptr<const SlamMap> map;
  Index merges = 0;
  std::size_t refused = 0;      ///< attempts to join the sessions
  std::size_t unconfirmed = 0;  ///< of these, those that a second place would have confirmed
};

/// Maps two sessions by the mapper's defaults, the second with fixes as if it followed the first.
Joining joined(const MisledKeyframes& first, const MisledKeyframes& second) {
  using Closer = LoopCloser<ProximityCandidates, mapper::ClosureRegistration, mapper::ClosureNoise>;
  using Merger = MapMerger<GnssCandidates, mapper::MergeRegistration>;
  const mapper::BackEndParts parts;
  BackEnd<Closer, ChainedCloser, Merger> back_end(
      parts.back_end, Closer(parts.closures, parts.candidates, parts.registration, parts.noise),
      ChainedCloser(parts.chain), Merger(parts.merge, GnssCandidates(parts.gnss), parts.merging), parts.outliers);
  const double length_of_road = travelled_by(first).back();
  for (const MisledKeyframes* session : {&first, &second}) {
    back_end.begin_session({});
    for (const Keyframe& keyframe : with_fixes(*session, length_of_road)) back_end.add(keyframe);
  }
  Joining result{.map = back_end.finish(), .merges = back_end.counts().merges};
  for (const LoopClosure& tried : result.map->refusals) {
    if (tried.kind != ClosureKind::merge) continue;
    ++result.refused;
    result.unconfirmed += tried.verdict == ClosureVerdict::unconfirmed ? 1 : 0;
  }
  return result;
}

void check_apart(const std::string& what, const MisledKeyframes& first, const MisledKeyframes& second) {
  CAPTURE(what);
  REQUIRE(std::min(first.size(), second.size()) > 1);
  const Joining result = joined(first, second);
  MESSAGE(what, ": ", result.refused, " attempts refused, of which ", result.unconfirmed,
          " for want of a second place, ", result.merges, " merges");
  CHECK(static_cast<double>(result.refused) >= travelled_by(second).back() / 10);
  CHECK(result.merges == 0);
  CHECK(result.map->sessions[1].frame == SessionId{1});
}

}  // namespace

TEST_SUITE("slam with misleading fixes") {
  TEST_CASE("a walk and a drive elsewhere are not joined to a street that they were never in") {
    const auto street_folder = test::real_data("muehlburger_tor/muehlburger_tor");
    const auto walk_folder = test::real_data("hku_square_two_sessions/session1");
    const auto drive_folder = test::real_data("durlacher_tor/durlacher_tor");
    if (!street_folder || !walk_folder || !drive_folder) return;
    const MisledKeyframes street = range_image_keyframes(*street_folder, 270, 390);
    MisledKeyframes walk = recorded_keyframes(*walk_folder);
    walk.resize(walk.size() / 2);
    check_apart("Durlacher Tor on Muehlburger Tor", street, range_image_keyframes(*drive_folder, 0, 52));
    check_apart("HKU on Muehlburger Tor", street, walk);
  }

  TEST_CASE("streets of two cities are not joined") {
    const auto campus_folder = test::real_data("mulran_kaist03_keyframes/kaist03");
    auto drive = test::kitti00_first101();
    if (!campus_folder || !drive) return;
    drive->scans.resize(60);
    const MisledKeyframes campus = recorded_keyframes(*campus_folder);
    const MisledKeyframes street = followed_keyframes(test::packets_of(*drive));
    check_apart("KITTI on MulRan", campus, street);
    check_apart("MulRan on KITTI", street, campus);
  }

  TEST_CASE("two walks round one courtyard are joined where they were") {
    const auto folder = test::real_data("hku_square_two_sessions");
    if (!folder) return;
    const MisledKeyframes first = recorded_keyframes(*folder / "session1");
    MisledKeyframes second = recorded_keyframes(*folder / "session2");
    second.resize(second.size() / 3);
    const Joining result = joined(first, second);
    REQUIRE(result.merges == 1);
    const auto& keyframes = result.map->keyframes;
    const auto merge = std::ranges::find(result.map->closures, ClosureKind::merge, &LoopClosure::kind);
    REQUIRE(merge != result.map->closures.end());
    const Keyframe &from = keyframes[static_cast<std::size_t>(merge->from.value)],
                   &to = keyframes[static_cast<std::size_t>(merge->to.value)];
    const SE3d T_first_second = test::read_matrix(*folder / "T_session1_session2.txt");
    const SE3d expected = from.T_odom_body.inverse() * T_first_second * to.T_odom_body;
    const SE3d off = expected.inverse() * (from.T_map_body.inverse() * to.T_map_body);
    const double degrees = off.rotation().log().norm() * 180 / std::numbers::pi;
    MESSAGE("HKU 2 on HKU 1: ", off.translation().norm(), " m, ", degrees, " deg off after ", result.refused,
            " refusals");
    CHECK(off.translation().norm() < 0.2);
    CHECK(degrees < 1);
  }
}
