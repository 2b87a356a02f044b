#include "chainslam/slam/keyframe_selector.hpp"

#include <doctest/doctest.h>

using namespace chainslam;

namespace {

Frame frame_at(double x, double yaw, FrameStatus status = FrameStatus::good) {
  Frame frame;
  frame.time = Timestamp::from_seconds(x);
  frame.T_odom_body = SE3d(SO3d::exp({0, 0, yaw}), {x, 0, 0});
  frame.health.status = status;
  frame.cloud.positions = {{1, 1, 1}, {1.1F, 1.1F, 1.1F}, {5, 5, 5}};
  return frame;
}

}  // namespace

TEST_SUITE("slam/keyframe_selector") {
  TEST_CASE("the first frame, then one for each stretch or turn since the last picked") {
    KeyframeSelector select({.distance = 3, .angle = 0.2});
    CHECK(select(frame_at(0, 0)).has_value());
    CHECK_FALSE(select(frame_at(2.9, 0)).has_value());
    CHECK(select(frame_at(3.0, 0)).has_value());
    CHECK_FALSE(select(frame_at(5.9, 0)).has_value());
    CHECK_FALSE(select(frame_at(5.9, 0.19)).has_value());
    CHECK(select(frame_at(5.9, 0.21)).has_value());
    CHECK_FALSE(select(frame_at(5.9, 0.1)).has_value());
    CHECK(select(frame_at(2.0, 0.21)).has_value());  // backwards counts too
  }

  TEST_CASE("lost frames are never picked, degenerate ones are") {
    KeyframeSelector select;
    CHECK_FALSE(select(frame_at(0, 0, FrameStatus::lost)).has_value());
    CHECK(select(frame_at(1, 0, FrameStatus::degenerate)).has_value());
    CHECK_FALSE(select(frame_at(9, 0, FrameStatus::lost)).has_value());
    CHECK(select(frame_at(9, 0)).has_value());
  }

  TEST_CASE("frames without a scan, as recordings have them, are never picked") {
    KeyframeSelector select;
    Frame bare = frame_at(0, 0);
    bare.cloud = {};
    CHECK_FALSE(select(bare).has_value());
    CHECK(select(frame_at(0.1, 0)).has_value());
  }

  TEST_CASE("distance 0 takes every frame; the scan is thinned, or kept whole at voxel 0") {
    KeyframeSelector all({.distance = 0, .scan_voxel = 0});
    CHECK(all(frame_at(0, 0))->cloud.size() == 3);
    CHECK(all(frame_at(0, 0)).has_value());
    KeyframeSelector thinned({.distance = 0, .scan_voxel = 0.4});
    const auto keyframe = thinned(frame_at(7, 0.1));
    CHECK(keyframe->cloud.size() == 2);
    CHECK(keyframe->time == Timestamp::from_seconds(7));
    CHECK(keyframe->T_odom_body == frame_at(7, 0.1).T_odom_body);
    CHECK_FALSE(keyframe->id.valid());
  }
}
