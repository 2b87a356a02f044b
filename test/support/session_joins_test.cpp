#include "support/session_joins.hpp"

#include <doctest/doctest.h>

namespace chainslam::support {
namespace {

/// Three sessions of two keyframes each.
SlamMap joined_sessions() {
  SlamMap map;
  for (Index s = 0; s < 3; ++s) {
    map.sessions.push_back({SessionId{s}, {}, 2 * s, 2, SessionId{0}, {}, {}});
    for (Index i = 0; i < 2; ++i) {
      Keyframe keyframe;
      keyframe.id = KeyframeId{2 * s + i};
      keyframe.session = SessionId{s};
      map.keyframes.push_back(keyframe);
    }
  }
  return map;
}

LoopClosure told(Index from, Index to, ClosureKind kind, ClosureVerdict verdict) {
  LoopClosure closure;
  closure.from = KeyframeId{from};
  closure.to = KeyframeId{to};
  closure.kind = kind;
  closure.verdict = verdict;
  return closure;
}

}  // namespace

TEST_SUITE("support/session_joins") {
  TEST_CASE("what joins two sessions is counted by kind and verdict, each pair by itself") {
    SlamMap map = joined_sessions();
    const auto in = ClosureVerdict::accepted;
    map.closures = {told(0, 2, ClosureKind::merge, in),
                    told(3, 1, ClosureKind::merge, in),
                    told(0, 3, ClosureKind::direct, in),
                    told(1, 3, ClosureKind::chained, ClosureVerdict::inconsistent),
                    told(0, 4, ClosureKind::merge, ClosureVerdict::reverted),
                    told(0, 5, ClosureKind::direct, ClosureVerdict::reverted),
                    told(0, 1, ClosureKind::direct, in)};  // within a session
    map.refusals = {told(2, 4, ClosureKind::merge, ClosureVerdict::unconfirmed),
                    told(2, 5, ClosureKind::merge, ClosureVerdict::against_fixes),
                    told(3, 5, ClosureKind::merge, ClosureVerdict::not_converged),
                    told(3, 5, ClosureKind::direct, ClosureVerdict::high_residual)};
    const std::vector<SessionJoin> joins = session_joins(map);
    REQUIRE(joins.size() == 3);
    CHECK(joins[0].first == SessionId{0});
    CHECK(joins[0].second == SessionId{1});
    CHECK(evidence_of(joins[0]) == "2 places, 1 direct, 0 chained closures");
    CHECK(doubts_of(joins[0]) == "1 closure rejected");
    CHECK_FALSE(joins[1].connected());
    CHECK(evidence_of(joins[1]) == "nothing");
    CHECK(doubts_of(joins[1]) == "1 place and 1 closure reverted");
    CHECK(joins[2].first == SessionId{1});
    CHECK(doubts_of(joins[2]) == "1 place unconfirmed, 1 place against the fixes, 1 place not recognized");
  }

  TEST_CASE("a map of one session has nothing to say") {
    SlamMap map = joined_sessions();
    map.closures = {told(0, 1, ClosureKind::direct, ClosureVerdict::accepted)};
    CHECK(session_joins(map).empty());
  }
}

}  // namespace chainslam::support
