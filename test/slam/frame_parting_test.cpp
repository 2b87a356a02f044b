#include "chainslam/slam/frame_parting.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "chainslam/factor_graph/noise_model.hpp"
#include "slam/street.hpp"

namespace chainslam {
namespace {

constexpr Index part_each = 4;  ///< keyframes of a session

/// Sessions that lie in one frame, each where its odometry and a shift put it.
SlamMap one_frame(Index sessions) {
  SlamMap map;
  for (Index s = 0; s < sessions; ++s) {
    map.sessions.push_back({SessionId{s}, {}, s * part_each, part_each, SessionId{0}, {}, {}});
    for (Index i = 0; i < part_each; ++i) {
      Keyframe keyframe = test::keyframe_at(i, test::shift(2 * i + 1, s, 0));
      keyframe.T_map_body = test::shift(100 * s, 0, 0) * keyframe.T_odom_body;
      keyframe.id = KeyframeId{s * part_each + i};
      keyframe.session = SessionId{s};
      map.keyframes.push_back(keyframe);
    }
  }
  return map;
}

/// Between the first keyframes of two sessions. @returns its position.
Index tie(SlamMap& map, Index from, Index to, ClosureVerdict verdict, Index cause = -1) {
  map.closures.push_back({.from = KeyframeId{part_each * from}, .to = KeyframeId{part_each * to}, .T_from_to = {}});
  map.closures.back().verdict = verdict;
  map.closures.back().cause = cause;
  return to_index(map.closures.size()) - 1;
}

std::vector<Index> held(const SlamMap& map) {
  std::vector<Index> frames;
  for (const SessionId frame : frames_held(map)) frames.push_back(frame.value);
  return frames;
}

const SqrtInformation<6> anchor = NoiseModel<6>::from_sigma(1e-4).sqrt_information();
using Frames = std::vector<Index>;
constexpr auto in = ClosureVerdict::accepted;
constexpr auto out = ClosureVerdict::inconsistent;

}  // namespace

TEST_SUITE("slam/frame_parting") {
  TEST_CASE("sessions stay together as far as accepted closures lead, and no farther") {
    SlamMap map = one_frame(5);
    tie(map, 0, 1, in);
    tie(map, 1, 2, out);
    tie(map, 2, 3, in);
    tie(map, 0, 4, in);
    CHECK(held(map) == Frames{0, 0, 2, 2, 0});
    CHECK_FALSE(is_held(map));
    tie(map, 4, 3, in);
    CHECK(held(map) == Frames{0, 0, 0, 0, 0});
    CHECK(is_held(map));
  }

  TEST_CASE("one closure that counts is enough, whatever became of the others") {
    SlamMap map = one_frame(2);
    for (int k = 0; k < 5; ++k) tie(map, 0, 1, out);
    CHECK_FALSE(is_held(map));
    tie(map, 0, 1, in);
    CHECK(is_held(map));
  }

  TEST_CASE("what no closure ever connected stays where it was put") {
    SlamMap map = one_frame(3);
    tie(map, 0, 1, out);
    CHECK(held(map) == Frames{0, 1, 0});
    map.sessions[2].frame = SessionId{};  // not stated
    CHECK(frames_held(map)[2] == SessionId{});
    CHECK(is_held(one_frame(3)));
  }

  TEST_CASE("what leaves a frame goes back as one body to where odometry has it, held by a prior; the rest stays") {
    SlamMap map = one_frame(4);
    tie(map, 0, 3, in);
    const Index gone = tie(map, 0, 1, out), kept = tie(map, 1, 2, in);
    const SlamMap before = map;
    part_frames(map, anchor);
    for (const Session& session : map.sessions) {
      const bool left = session.id.value == 1 || session.id.value == 2;
      CHECK(session.frame == SessionId{left ? 1 : 0});
      CHECK((session.prior_sqrt_information == anchor) == (session.id.value == 1));
      for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i) {
        const Keyframe& now = map.keyframes[static_cast<std::size_t>(i)];
        const SE3d& then = before.keyframes[static_cast<std::size_t>(i)].T_map_body;
        // The second session lay 100 m off: that comes off the third one's 200 m, too.
        CHECK(now.T_map_body.local(left ? test::shift(-100, 0, 0) * then : then).norm() < 1e-12);
      }
    }
    CHECK(map.sessions[1].prior == map.keyframes[part_each].T_odom_body);
    CHECK(map.closures[static_cast<std::size_t>(gone)].verdict == ClosureVerdict::reverted);
    CHECK_FALSE(map.closures[static_cast<std::size_t>(gone)].is_factor());
    CHECK(map.closures[static_cast<std::size_t>(kept)].verdict == ClosureVerdict::accepted);
    CHECK(is_held(map));
  }

  TEST_CASE(
      "a closure that is withdrawn takes all with it that it led to, over any number of steps, and nothing else") {
    SlamMap map = one_frame(3);
    const Index merge = tie(map, 0, 1, in), other = tie(map, 0, 2, in);
    const Index direct = tie(map, 0, 1, in, merge), chained = tie(map, 0, 1, in, direct);
    const Index of_other = tie(map, 0, 2, in, other);
    withdraw_closures(map, std::vector<Index>{merge});
    for (Index i = 0; i < to_index(map.closures.size()); ++i) {
      const bool withdrawn = i == merge || i == direct || i == chained;
      CHECK((map.closures[static_cast<std::size_t>(i)].verdict == ClosureVerdict::reverted) == withdrawn);
    }
    CHECK(of_other == 4);
    CHECK(held(map) == Frames{0, 1, 0});
  }
}

}  // namespace chainslam
