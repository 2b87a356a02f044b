#include <doctest/doctest.h>

#include <memory>
#include <numbers>
#include <utility>
#include <vector>

#include "chainslam/slam/chained_closer.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/gnss_candidates.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "slam/scripted.hpp"
#include "slam/street.hpp"

// The defaults of what is tried: candidates, chains and the way between two searches.

namespace chainslam {
namespace {

/// Keyframes in the order of their numbers, each of a session and at a place, with what their closures say.
struct Places {
  std::vector<SE3d> truth{};
  std::vector<Keyframe> keyframes{};
  std::vector<std::pair<Index, Index>> edges{};

  /// @returns its number.
  Index add(Index session, const Eigen::Vector3d& position, double heading = 0, double time = 0) {
    truth.emplace_back(SO3d::exp({0, 0, heading}), position);
    keyframes.push_back(test::keyframe_at(time, truth.back()));
    keyframes.back().id = KeyframeId{to_index(keyframes.size() - 1)};
    keyframes.back().session = SessionId{session};
    return keyframes.back().id.value;
  }
  /// A session of its own along the street.
  void add_street(Index session, Index count, double step, double aside) {
    for (Index i = 0; i < count; ++i) add(session, {step * i, aside, 0});
  }

  /// What the newest keyframe may have seen.
  [[nodiscard]] std::vector<Index> proposed() const {
    PositionIndex index;
    index.rebuild(keyframes);
    std::vector<Index> ids;
    for (const KeyframeId id : ProximityCandidates{}.find(keyframes, index, keyframes.back().id))
      ids.push_back(id.value);
    return ids;
  }

  /// Chains a direct closure from j to the newest keyframe. @param error  of the direct closure.
  [[nodiscard]] std::vector<LoopClosure> chained(Index j, const SE3d& error = {}, double* information = nullptr) const {
    test::TruthCloser closer;
    closer.truth = std::make_shared<const std::vector<SE3d>>(truth);
    closer.reach = 1e9;
    const KeyframeId newest = keyframes.back().id;
    LoopClosure direct = closer.align(keyframes, KeyframeId{j}, newest, SE3d());
    direct.T_from_to = direct.T_from_to * error;
    const double alone = direct.sqrt_information.squaredNorm();
    ClosureGraph graph(to_index(keyframes.size()));
    for (const auto& [a, b] : edges) graph.add_edge(a, b, 0);
    std::vector<LoopClosure> tried = ChainedCloser().close(keyframes, graph, direct, newest.value, closer);
    if (information == nullptr) return tried;
    *information = direct.sqrt_information.squaredNorm() / alone;
    for (const LoopClosure& one : tried) *information += one.sqrt_information.squaredNorm() / alone;
    return tried;
  }
};

std::vector<Index> partners(const std::vector<LoopClosure>& tried) {
  std::vector<Index> ids;
  for (const LoopClosure& closure : tried) ids.push_back(closure.from.value);
  return ids;
}

using Ids = std::vector<Index>;

}  // namespace

TEST_SUITE("slam: what is tried by default") {
  TEST_CASE(
      "candidates lie within 15 m, 30 s and 30 keyframes or 200 m of path apart, and look the same way if they are 9 m "
      "farther") {
    Places places;
    places.add(0, {14, 0, 0});
    places.add(1, {16, 0, 0});
    places.add(9, {1, 0, 0}, 0, 0);
    places.add(9, {0.5, 0, 0}, 0, 31);
    for (int i = 0; i < 28; ++i) places.add(9, {50, 0, 0}, 0, 40);
    Places sooner = places;
    sooner.add(9, {0, 0, 0}, 0, 60);
    CHECK(sooner.proposed() == Ids{0});  // 29 keyframes lie between, and 100 m of path: the submap may hold the scan
    places.add(9, {50, 0, 0}, 0, 40);
    places.add(9, {0, 0, 0}, 0, 60);
    CHECK(places.proposed() == Ids{2, 0});
    for (const double away : {99.0, 101.0}) {
      Places drive;
      drive.add(0, {0, 0, 0}, 0, 0);
      drive.add(0, {away, 0, 0}, 0, 30);
      drive.add(0, {0, 0, 0}, 0, 60);
      CHECK(drive.proposed() == (away > 100 ? Ids{0} : Ids{}));
    }
    Places turned;
    turned.add(0, {2, 0, 0}, std::numbers::pi);
    turned.add(1, {8, 0, 0});
    turned.add(2, {3, 0, 0}, 0.3);
    turned.add(3, {4.5, 0, 0});
    turned.add(9, {0, 0, 0});
    CHECK(turned.proposed() == Ids{2, 3, 1});
  }

  TEST_CASE("candidates of one session are ten keyframes apart, and no more than three") {
    Places places;
    places.add_street(0, 30, 0.7, 0);  // the nearest, one ten keyframes on, and one twenty
    places.add(9, {0, 0, 0});
    CHECK(places.proposed() == Ids{0, 10, 20});
    Places crowd;
    for (Index session = 0; session < 6; ++session) crowd.add(session, {1.0 + session, 0, 0});
    crowd.add(9, {0, 0, 0});
    CHECK(crowd.proposed() == Ids{0, 1, 2});
  }

  TEST_CASE("places that GNSS proposes for a merge are ten keyframes apart, and no more than two") {
    SlamMap map;
    for (Index i = 0; i < 40; ++i) {
      Keyframe keyframe = test::keyframe_at(i, SE3d());
      keyframe.id = KeyframeId{i};
      keyframe.session = SessionId{i < 39 ? 0 : 1};
      keyframe.gnss = test::fix_at(keyframe.time, {i < 39 ? 0.2 * i : 0, 0, 0});
      map.keyframes.push_back(keyframe);
    }
    map.sessions.push_back({SessionId{0}, {}, 0, 39, SessionId{0}, {}, {}});
    map.sessions.push_back({SessionId{1}, {}, 39, 1, SessionId{1}, {}, {}});
    Ids found;
    for (const KeyframeId id : GnssCandidates().find(map, KeyframeId{39})) found.push_back(id.value);
    CHECK(found == Ids{0, 10});
  }

  TEST_CASE("keyframes beside the partner, up to four, count as the partner") {
    Places places;
    places.add_street(0, 20, 1, 0);
    places.add_street(1, 40, 0.5, 2);
    places.add(9, {10, 1, 0});
    places.edges = {{14, 30}, {15, 37}, {6, 52}};
    CHECK(partners(places.chained(10)) == Ids{30, 52});
  }

  TEST_CASE("chained keyframes lie within 20 m, twenty keyframes apart, and are no more than four") {
    Places places;
    places.add_street(0, 20, 1, 0);
    places.add_street(1, 60, 0.5, 0);
    places.add(2, {31, 0, 0});
    places.add(3, {29, 0, 0});
    places.add(9, {10, 1, 0});
    places.edges = {{10, 59}, {59, 80}, {80, 40},
                    {40, 60}, {60, 20}, {20, 81}};  // 40 is at 10 m, 20 and 60 at 0 and 20
    CHECK(partners(places.chained(10)) == Ids{40, 60, 20, 81});
    Places crowd;
    crowd.add(0, {0, 0, 0});
    for (Index session = 1; session < 15; ++session) {
      crowd.add(session, {0.1 * session, 0, 0});
      crowd.edges.emplace_back(session - 1, session);
    }
    crowd.add(20, {0, 0, 0});
    CHECK(crowd.chained(0).size() == 4);
  }

  TEST_CASE("a chained closure may be off the direct one by 1.5 m and 0.08 rad, not by 3 m or 0.2 rad") {
    Places places;
    places.add(0, {0, 0, 0});
    places.add(1, {1, 0, 0});
    places.add(9, {0, 1, 0});
    places.edges = {{0, 1}};
    const auto verdict = [&](double turn, const Eigen::Vector3d& shift) {
      return places.chained(0, SE3d(SO3d::exp({0, 0, turn}), shift)).at(0).verdict;
    };
    CHECK(verdict(0.08, {1.5, 0, 0}) == ClosureVerdict::accepted);
    CHECK(verdict(0, {3, 0, 0}) == ClosureVerdict::inconsistent);
    CHECK(verdict(0.2, {0, 0, 0}) == ClosureVerdict::inconsistent);
  }

  TEST_CASE("four closures that share a scan know 1.6 times as much as one") {
    Places places;
    for (Index session = 0; session < 4; ++session) places.add(session, {0.5 * session, 0, 0});
    places.add(9, {0, 1, 0});
    places.edges = {{0, 1}, {1, 2}, {2, 3}};
    double information = 0;
    CHECK(places.chained(0, {}, &information).size() == 3);
    CHECK(information == doctest::Approx(1.6));
  }

  TEST_CASE("loops are looked for every 4 m of the path") {
    Places places;
    LoopCloser<> closer;
    PositionIndex index;
    for (Index i = 0; i < 42; ++i) {
      places.add(0, {1.01 * i, 0, 0}, 0, 0.1 * i);
      (void)closer.close(places.keyframes, index);
    }
    REQUIRE(closer.search_spacing().size() == 10);
    for (const double spacing : closer.search_spacing()) CHECK(spacing == doctest::Approx(4.04));
  }
}

}  // namespace chainslam
