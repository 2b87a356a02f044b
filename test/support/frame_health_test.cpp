#include "support/frame_health.hpp"

#include <doctest/doctest.h>

#include <string>
#include <vector>

#include "support/summary.hpp"

namespace chainslam::support {
namespace {

/// Ten frames a second and two metres apart, all good.
std::vector<FrameRecord> frames_at_10_hz(int count) {
  std::vector<FrameRecord> frames;
  for (int i = 0; i < count; ++i) {
    FrameRecord frame;
    frame.session = SessionId{0};
    frame.time = Timestamp::from_seconds(100 + 0.1 * i);
    frame.T_odom_body = SE3d(SO3d(), {2.0 * i, 0, 0});
    frame.health.imu_use = ImuUse::all;
    frames.push_back(frame);
  }
  return frames;
}

SessionSummary session_of(const std::vector<FrameRecord>& frames, const char* name = "drive") {
  SessionSummary session{.name = name, .scans = to_index(frames.size()), .frames = to_index(frames.size())};
  session.health = health_of(frames);
  session.lost_frames = session.health.lost;
  return session;
}

bool mentions(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

}  // namespace

TEST_SUITE("support/frame_health") {
  TEST_CASE("lost frames are joined over pauses of less than a second, with begin, end, scans, way and restarts") {
    auto frames = frames_at_10_hz(100);
    for (const std::size_t i : {20U, 21U, 30U, 50U}) frames[i].health.status = FrameStatus::lost;
    frames[30].health.map_restarted = true;
    const SessionHealth health = health_of(frames);
    CHECK(health.frames == 100);
    CHECK(health.lost == 4);
    CHECK(health.restarts == 1);
    REQUIRE(health.intervals.size() == 2);
    const FrameInterval& first = health.intervals[0];
    CHECK(first.begin == doctest::Approx(2.0));
    CHECK(first.end == doctest::Approx(3.0));
    CHECK(first.frames == 3);
    CHECK(first.restarts == 1);
    CHECK(first.distance == doctest::Approx(22));  // from frame 19 to frame 30
    CHECK(health.intervals[1].begin == doctest::Approx(5.0));
    CHECK(health.intervals[1].frames == 1);
  }

  TEST_CASE("each concern has intervals of its own, in the order of time; what is good has none") {
    auto frames = frames_at_10_hz(100);
    CHECK(health_of(frames).intervals.empty());
    const auto use = [&](std::size_t first, std::size_t last, ImuUse what) {
      for (std::size_t i = first; i <= last; ++i) frames[i].health.imu_use = what;
    };
    use(5, 15, ImuUse::none);
    use(16, 26, ImuUse::rough_gyroscope);
    use(27, 37, ImuUse::gyroscope);
    frames[40].health.status = FrameStatus::degenerate;
    frames[60].health.after_gap = true;
    frames[80].health.status = FrameStatus::lost;
    std::vector<std::string> causes;
    for (const FrameInterval& interval : health_of(frames).intervals) causes.push_back(name_of(interval.concern));
    CHECK(causes == std::vector<std::string>{"IMU not used", "gyroscope contradicted by the scans",
                                             "accelerometer contradicted by the scans", "directions not observed",
                                             "gap between scans", "scans lost"});
    CHECK_FALSE(frames[10].health.doubtful());
    for (const std::size_t i : {20U, 30U, 40U, 60U, 80U}) CHECK(frames[i].health.doubtful());
  }

  TEST_CASE("single scans that contradict the IMU are no interval, but what lasts for a second is") {
    auto frames = frames_at_10_hz(200);
    for (std::size_t i = 0; i < 100; i += 5) frames[i].health.imu_use = ImuUse::gyroscope;       // one of five
    for (std::size_t i = 150; i < 160; ++i) frames[i].health.imu_use = ImuUse::rough_gyroscope;  // 0.9 s
    SessionHealth health = health_of(frames);
    CHECK(health.intervals.empty());
    CHECK(health_sentence(session_of(frames)).empty());
    frames[160].health.imu_use = ImuUse::rough_gyroscope;
    health = health_of(frames);
    REQUIRE(health.intervals.size() == 1);
    CHECK(health.intervals[0].concern == FrameConcern::gyroscope);
    CHECK(health.intervals[0].frames == 11);
    CHECK(health.imu_use.all == 169);
    CHECK(health.imu_use.gyroscope == 20);
    CHECK(health.imu_use.scans_only == 11);
    CHECK(text_of(health.imu_use) ==
          "84.5 % of frames with all of the IMU, 10.0 % with its gyroscope, 5.5 % by scans alone");
  }

  TEST_CASE("an accelerometer that settings leave out is not contradicted") {
    auto frames = frames_at_10_hz(40);
    for (FrameRecord& frame : frames) {
      frame.health.imu_use = ImuUse::gyroscope;
      frame.health.imu_as_set = true;
    }
    CHECK(health_of(frames).intervals.empty());
    CHECK(text_of(health_of(frames).imu_use) ==
          "0.0 % of frames with all of the IMU, 100.0 % with its gyroscope, 0.0 % by scans alone");
    CHECK_FALSE(frames[20].health.doubtful());
    for (FrameRecord& frame : frames) frame.health.imu_as_set = false;  // contradicted from the first frame on
    CHECK(health_of(frames).intervals.size() == 1);
    for (FrameRecord& frame : frames) frame.health.imu_use = ImuUse::rough_gyroscope;
    frames[20].health.imu_as_set = true;  // which says nothing of the gyroscope
    CHECK(frames[20].health.doubtful());
  }

  TEST_CASE("a session without an IMU is not one whose IMU is not used") {
    auto frames = frames_at_10_hz(20);
    for (FrameRecord& frame : frames) frame.health.imu_use.reset();
    CHECK(health_of(frames).intervals.empty());
    CHECK(health_of(frames).imu_use.frames() == 0);
    CHECK(text_of(health_of(frames).imu_use).empty());
  }

  TEST_CASE("the sentence says how many, from when on, and whether the map is to be trusted") {
    auto frames = frames_at_10_hz(228);
    CHECK(health_sentence(session_of(frames)).empty());
    frames[100].health.status = FrameStatus::lost;
    CHECK(health_sentence(session_of(frames)) ==
          "drive: 1 of 228 scans lost (0.4 %) from 10.0 s on: the poses there are predicted");
    for (std::size_t i = 123; i < 204; ++i) frames[i].health.status = FrameStatus::lost;
    frames[140].health.map_restarted = frames[160].health.map_restarted = true;
    CHECK(health_sentence(session_of(frames)) ==
          "drive: 82 of 228 scans lost (36 %) from 10.0 s on, 2 restarts of the local map: the map is not to be "
          "trusted there");
    SessionSummary session = session_of(frames_at_10_hz(60));
    session.scans = 100;  // 40 gave no frame
    CHECK(session.lost_share() == doctest::Approx(0.4));
    CHECK(mentions(health_sentence(session), "40 of 100 scans lost (40 %)"));
  }

  TEST_CASE("the verdict names missed goals and each session's losses, and JSON has it first, with all intervals") {
    auto frames = frames_at_10_hz(100);
    for (std::size_t i = 40; i < 80; ++i) frames[i].health.status = FrameStatus::lost;
    RunSummary summary{.dataset = "two drives"};
    summary.sessions = {session_of(frames_at_10_hz(100), "morning"), session_of(frames, "evening")};
    CHECK_FALSE(verdict_of(summary).failed);
    summary.goals = {{"max_ape", 1, 0.5, true}, {"max_lost_share", 0.1, 0.4, false}};
    const Verdict verdict = verdict_of(summary);
    CHECK(verdict.failed);
    CHECK(verdict.headline ==
          "failed: missed max_lost_share; evening: 40 of 100 scans lost (40 %) from 4.0 s on: the map is not to be "
          "trusted there");
    CHECK(verdict.sentences.size() == 1);
    const std::string json = summary_json(summary);
    CHECK(json.find("verdict") < json.find("dataset"));
    CHECK(mentions(json, "\"cause\": \"scans lost\""));
    CHECK(mentions(json, "\"lost_share\": 0.4"));
  }
}

}  // namespace chainslam::support
