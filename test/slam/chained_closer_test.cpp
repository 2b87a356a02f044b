#include "chainslam/slam/chained_closer.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <set>
#include <utility>
#include <vector>

#include "chainslam/slam/submap.hpp"
#include "slam/scripted.hpp"
#include "slam/street.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;
using test::random_motion;
using test::TruthCloser;

/// Algorithm 1 as it is printed.
constexpr ChainOptions paper{.reach = 0,
                             .guess_through_chain = false,
                             .max_distance = 0,
                             .min_separation = 0,
                             .max_alignments = 0,
                             .max_translation = 0,
                             .correlation = 0};

using Edges = std::vector<std::pair<Index, Index>>;

std::vector<Index> numbers(const std::vector<KeyframeId>& ids) {
  std::vector<Index> values;
  for (const KeyframeId id : ids) values.push_back(id.value);
  return values;
}

/// Three drives of five keyframes along one street, two metres apart and side by side: 0 .. 4, 5 .. 9 and, the one that
/// is being mapped, 10 .. 14. What was measured is exact, what the map believes of the last is 3 m off.
struct Drives {
  static constexpr Index loaded = 10;
  std::vector<SE3d> truth;
  std::vector<Keyframe> keyframes;
  ClosureGraph graph;
  TruthCloser closer;

  explicit Drives(const Edges& edges) : graph(15) {
    for (int i = 0; i < 15; ++i) truth.emplace_back(SO3d::exp({0, 0, 0.1 * i}), Eigen::Vector3d(2 * (i % 5), i / 5, 0));
    keyframes = test::keyframes_at(truth);
    for (Index i = 0; i < 15; ++i) keyframes[static_cast<std::size_t>(i)].session = SessionId{i / 5};
    for (std::size_t i = 10; i < 15; ++i) keyframes[i].T_map_body = truth[i] * SE3d(SO3d(), {3, 0, 0});
    for (const auto& [a, b] : edges) graph.add_edge(a, b, 0);
    closer.truth = std::make_shared<const std::vector<SE3d>>(truth);
  }

  /// The direct closure from j to i, exact.
  [[nodiscard]] LoopClosure direct(Index j, Index i) {
    LoopClosure closure = closer.align(keyframes, KeyframeId{j}, KeyframeId{i}, SE3d());
    closer.asked->clear();
    return closure;
  }

  [[nodiscard]] std::vector<LoopClosure> chain(const ChainOptions& options, LoopClosure direct) {
    return ChainedCloser(options).close(keyframes, graph, direct, loaded, closer);
  }
  /// The keyframes k that were tried with i = 14 when it had closed with j, in their order.
  [[nodiscard]] std::vector<Index> tried(const ChainOptions& options, Index j) {
    std::vector<Index> from;
    for (const LoopClosure& closure : chain(options, direct(j, 14))) {
      CHECK(closure.to == KeyframeId{14});
      CHECK(closure.kind == ClosureKind::chained);
      from.push_back(closure.from.value);
    }
    return from;
  }
};

/// Counts the alignments that look near the guess alone.
struct RefiningCloser : TruthCloser {
  int refined = 0;

  template <Executor E = Serial>
  [[nodiscard]] LoopClosure refine(std::span<const Keyframe> keyframes, KeyframeId from, KeyframeId to,
                                   const SE3d& guess, const E& executor = {}) {
    ++refined;
    return align(keyframes, from, to, guess, executor);
  }
};

// ---- the same, written down naively ----

void walk(const Edges& edges, Index node, Index loaded, bool through, std::set<Index>& seen) {
  if (!seen.insert(node).second || (!through && node >= loaded)) return;
  for (const auto& [a, b] : edges) {
    if (a == node) walk(edges, b, loaded, through, seen);
    if (b == node) walk(edges, a, loaded, through, seen);
  }
}

std::set<Index> connected_naively(const Edges& edges, Index j, Index loaded, bool through) {
  std::set<Index> seen;
  walk(edges, j, loaded, through, seen);
  seen.erase(j);
  std::erase_if(seen, [&](Index k) { return k >= loaded; });
  return seen;
}

/// A map of several sessions with closures at random; the last keyframe is the current one.
struct RandomMap {
  std::vector<SE3d> truth;
  std::vector<Keyframe> keyframes;
  Edges edges;
  ClosureGraph graph;
  Index loaded = 0, current = 0, j = 0;

  RandomMap(Rng& rng, int size) {
    const Index sessions = 2 + static_cast<Index>(rng.uniform_index(4));
    const Index each = 2 + size / 3;
    loaded = (sessions - 1) * each;
    const Index count = sessions * each;
    current = count - 1;
    for (Index i = 0; i < count; ++i) truth.push_back(random_motion(rng, 15, 1));
    keyframes = test::keyframes_at(truth);
    graph.resize(count);
    for (Index i = 0; i < count; ++i) keyframes[static_cast<std::size_t>(i)].session = SessionId{i / each};
    for (Index i = 0; i < count; ++i) {
      const auto a = rng.uniform_index(count);
      const auto b = rng.uniform_index(count);
      if (a == b) continue;
      edges.emplace_back(a, b);
      graph.add_edge(a, b, i);
    }
    j = rng.uniform_index(loaded);
  }

  [[nodiscard]] SE3d T(Index k) const { return keyframes[static_cast<std::size_t>(k)].T_map_body; }
  [[nodiscard]] bool joined(Index a, Index b) const {
    return std::ranges::any_of(edges, [&](const auto& edge) {
      return (edge.first == a && edge.second == b) || (edge.first == b && edge.second == a);
    });
  }

  /// The keyframes to try, nearest first.
  [[nodiscard]] std::vector<Index> candidates(const ChainOptions& options, const SE3d& T_map_i) const {
    std::set<Index> connected = connected_naively(edges, j, loaded, options.through_current_session);
    const SubmapRange submap = submap_range(keyframes, KeyframeId{j}, options.reach);
    for (Index beside = submap.begin; beside < submap.end; ++beside)
      if (beside != j && !connected.contains(beside))
        connected.merge(connected_naively(edges, beside, loaded, options.through_current_session));
    std::vector<std::pair<double, Index>> near;
    for (const Index k : connected) {
      const double distance = (T(k).inverse() * T_map_i).translation().norm();
      if (!joined(k, current) && (options.max_distance == 0 || distance <= options.max_distance))
        near.emplace_back(distance, k);
    }
    std::ranges::sort(near);
    std::vector<Index> kept, partners{j};
    for (const auto& [distance, k] : near) {
      const bool beside = std::ranges::any_of(partners, [&, k = k](Index other) {
        return keyframes[static_cast<std::size_t>(other)].session == keyframes[static_cast<std::size_t>(k)].session &&
               std::abs(other - k) < options.min_separation;
      });
      if (beside || (options.max_alignments > 0 && to_index(kept.size()) == options.max_alignments)) continue;
      kept.push_back(k);
      partners.push_back(k);
    }
    return kept;
  }
};

}  // namespace

TEST_SUITE("slam/chained_closer") {
  TEST_CASE(
      "a scan is aligned near what comes through the chain, and from farther away if the graph alone says where") {
    for (const bool through_chain : {true, false}) {
      Drives drives({{2, 7}, {2, 14}});
      RefiningCloser closer{drives.closer};
      LoopClosure direct = drives.direct(2, 14);
      ChainOptions options = paper;
      options.guess_through_chain = through_chain;
      const auto tried = ChainedCloser(options).close(drives.keyframes, drives.graph, direct, Drives::loaded, closer);
      REQUIRE(tried.size() == 1);
      CHECK(closer.refined == (through_chain ? 1 : 0));
    }
  }

  TEST_CASE("N(j) is every loaded keyframe that closures connect with j, by way of the current session too") {
    //  2 - 7 - 9,  7 - 12 - 4,  12 - 13 - 0;  apart: 3 - 8
    const Drives drives({{2, 7}, {7, 9}, {7, 12}, {12, 4}, {12, 13}, {13, 0}, {3, 8}});
    ChainedCloser closer(paper);
    CHECK(numbers(closer.connected(drives.graph, KeyframeId{2}, 10)) == std::vector<Index>{7, 9, 4, 0});
    CHECK(numbers(closer.connected(drives.graph, KeyframeId{9}, 10)) == std::vector<Index>{7, 2, 4, 0});
    CHECK(numbers(closer.connected(drives.graph, KeyframeId{8}, 10)) == std::vector<Index>{3});
    CHECK(closer.connected(drives.graph, KeyframeId{1}, 10).empty());
    CHECK(numbers(closer.connected(drives.graph, KeyframeId{2}, 5)) == std::vector<Index>{4, 0});
  }

  TEST_CASE("a search that keeps out of the current session misses what only its keyframes join") {
    const Drives drives({{2, 7}, {7, 9}, {7, 12}, {12, 4}, {12, 13}, {13, 0}, {2, 11}, {11, 9}});
    ChainOptions options = paper;
    options.through_current_session = false;
    ChainedCloser closer(options);
    CHECK(numbers(closer.connected(drives.graph, KeyframeId{2}, 10)) == std::vector<Index>{7, 9});
    CHECK(closer.connected(drives.graph, KeyframeId{4}, 10).empty());
  }

  TEST_CASE("as in the paper, every connected loaded keyframe but j is tried with the same scan, nearest first") {
    Drives drives({{2, 7}, {7, 9}, {7, 12}, {12, 4}, {12, 13}, {13, 0}, {3, 8}});
    // Keyframe 14 is believed at x = 11, beyond 9 at (8, 1) and 4 at (8, 0).
    CHECK(drives.tried(paper, 2) == std::vector<Index>{9, 4, 7, 0});
    CHECK(drives.tried(paper, 9) == std::vector<Index>{4, 7, 2, 0});
    CHECK(drives.tried(paper, 1).empty());
  }

  TEST_CASE("a direct closure within the current session chains nothing") {
    Drives drives({{2, 7}, {7, 12}, {12, 11}});
    CHECK(drives.chain(paper, drives.direct(12, 14)).empty());
    CHECK(drives.chain(paper, drives.direct(10, 14)).empty());
    CHECK(drives.tried(paper, 7) == std::vector<Index>{2});
  }

  TEST_CASE("switched off, nothing is tried, and the direct closure is as it was") {
    Drives drives({{2, 7}});
    LoopClosure direct = drives.direct(2, 14);
    CHECK(ChainedCloser({.enabled = false}).close(drives.keyframes, drives.graph, direct, 10, drives.closer).empty());
    CHECK(NoChaining().close(drives.keyframes, drives.graph, direct, 10, drives.closer).empty());
    CHECK(direct.sqrt_information == drives.direct(2, 14).sqrt_information);
    CHECK(drives.closer.asked->empty());
  }

  TEST_CASE("chained candidates obey what closures must obey, and pairs already connected are left out") {
    Drives drives({{2, 7}, {7, 9}, {7, 4}, {9, 14}});
    CHECK(drives.tried(paper, 2) == std::vector<Index>{4, 7});
    drives.keyframes[4].session = SessionId{2};  // of the query's session and just before it: not eligible
    drives.keyframes[4].time = drives.keyframes[14].time - seconds(29);
    CHECK(drives.tried(paper, 2) == std::vector<Index>{7});
    drives.keyframes[4].time = drives.keyframes[14].time - seconds(30);
    CHECK(drives.tried(paper, 2) == std::vector<Index>{4, 7});
  }

  TEST_CASE("closures of keyframes beside j count as j's, as far as asked and within its session") {
    Drives drives({{2, 7}, {3, 9}, {0, 8}, {5, 4}});
    CHECK(drives.tried(paper, 2) == std::vector<Index>{7});
    ChainOptions options = paper;
    options.reach = 1;
    CHECK(drives.tried(options, 2) == std::vector<Index>{9, 7});
    options.reach = 2;
    CHECK(drives.tried(options, 2) == std::vector<Index>{9, 8, 7, 5});
    CHECK(drives.tried(options, 7) == std::vector<Index>{4, 3, 2, 0});
    options.min_separation = 3;  // all of one session are too near each other
    CHECK(drives.tried(options, 2) == std::vector<Index>{9, 5});
  }

  TEST_CASE("bounds: how far off, how close to another partner of its session, how many") {
    Drives drives({{2, 7}, {7, 9}, {7, 12}, {12, 4}, {12, 13}, {13, 0}});
    ChainOptions options = paper;
    options.max_distance = 8;  // believed at x = 11: 7 is at 4, 0 at 0
    CHECK(drives.tried(options, 2) == std::vector<Index>{9, 4, 7});
    options = paper;
    options.min_separation = 2;
    CHECK(drives.tried(options, 2) == std::vector<Index>{9, 4, 7, 0});
    options.min_separation = 3;  // 4 and 0 are two from j, 7 two from 9
    CHECK(drives.tried(options, 2) == std::vector<Index>{9});
    options = paper;
    options.max_alignments = 2;
    CHECK(drives.tried(options, 2) == std::vector<Index>{9, 4});
  }

  TEST_CASE("of more sessions than may be tried, those of the last partners stay, unless others are much nearer") {
    // Four loaded drives along lanes, 0 .. 4 to 15 .. 19; the current one crosses from the first to the last.
    const auto second = [](double lane, ChainOptions options) {
      std::vector<SE3d> truth;
      for (Index i = 0; i < 25; ++i) {
        const double y = lane * (i < 20 ? i / 5 : i == 22 ? 3 : 0);
        truth.emplace_back(SO3d(), Eigen::Vector3d(2 * (i % 5), y, 0));
      }
      std::vector<Keyframe> keyframes = test::keyframes_at(truth);
      ClosureGraph graph(25);
      for (Index i = 0; i < 25; ++i) {
        keyframes[static_cast<std::size_t>(i)].session = SessionId{i / 5};
        if (i < 15) graph.add_edge(i, i + 5, i);
      }
      TruthCloser closer;
      closer.truth = std::make_shared<const std::vector<SE3d>>(truth);
      options.max_alignments = 1;
      ChainedCloser chainer(options);
      std::vector<LoopClosure> tried;
      for (const Index at : {0, 2}) {
        LoopClosure direct = closer.align(keyframes, KeyframeId{at}, KeyframeId{20 + at}, SE3d());
        tried = chainer.close(keyframes, graph, direct, 20, closer);
        REQUIRE(tried.size() == 1);
        if (at == 0) CHECK(tried.front().from == KeyframeId{5});
      }
      return tried.front().from;
    };
    CHECK(second(2, {}) == KeyframeId{7});
    CHECK(second(2.4, {}) == KeyframeId{7});
    CHECK(second(2.6, {}) == KeyframeId{17});  // 5.2 m nearer
    CHECK(second(0.1, {.hysteresis = 0}) == KeyframeId{17});
  }

  TEST_CASE("alignments start where the map has the current keyframe, or where the chain puts it") {
    Drives drives({{2, 7}, {7, 9}});
    for (const bool through_chain : {false, true}) {
      ChainOptions options = paper;
      options.guess_through_chain = through_chain;
      CHECK(drives.tried(options, 2).size() == 2);
      for (const test::Asked& asked : *drives.closer.asked) {
        const SE3d T_k_i = drives.truth[static_cast<std::size_t>(asked.from.value)].inverse() * drives.truth[14];
        const SE3d off = through_chain ? SE3d() : SE3d(SO3d(), {3, 0, 0});  // the drift is gone with the direct closure
        CHECK((T_k_i * off).local(asked.guess).norm() < 1e-12);
      }
    }
  }

  TEST_CASE("a closure that contradicts the chain is refused as inconsistent, unless anything goes") {
    Drives drives({{2, 7}, {7, 9}});
    LoopClosure direct = drives.direct(2, 14);
    const auto verdicts = [&](const ChainOptions& options, const Vector6d& error) {
      LoopClosure wrong = direct;
      wrong.T_from_to = direct.T_from_to.retract(error);
      const auto tried = drives.chain(options, wrong);
      REQUIRE(tried.size() == 1);  // 7, and 9 beside it
      return tried.front().verdict;
    };
    const Vector6d metres = Vector6d::Unit(0), radians = Vector6d::Unit(5);
    const ChainOptions best{.max_translation = 2, .max_rotation = 0.1};
    CHECK(verdicts(best, 1.9 * metres) == ClosureVerdict::accepted);
    CHECK(verdicts(best, 2.1 * metres) == ClosureVerdict::inconsistent);
    CHECK(verdicts(best, 0.09 * radians) == ClosureVerdict::accepted);
    CHECK(verdicts(best, 0.11 * radians) == ClosureVerdict::inconsistent);
    ChainOptions any = best;
    any.max_translation = 0;
    CHECK(verdicts(any, 5 * metres) == ClosureVerdict::accepted);
    drives.closer.reach = 0;  // refused by the closer itself: its own reason stays
    CHECK(verdicts(best, 5 * metres) == ClosureVerdict::too_few_inliers);
  }

  TEST_CASE("m closures that share a scan know as much as m / (1 + (m - 1) r) of them") {
    for (const double r : {0.0, 0.5, 1.0}) {
      Drives drives({{2, 7}, {7, 9}, {7, 4}, {4, 0}});
      drives.closer.reach = 7;  // keyframe 14 stands at x = 8: it does not see 0, nor 2 but for the direct closure
      LoopClosure direct = drives.direct(4, 14);
      const Matrix6d alone = direct.sqrt_information.transpose() * direct.sqrt_information;
      ChainOptions options = paper;
      options.correlation = r;
      const auto tried = ChainedCloser(options).close(drives.keyframes, drives.graph, direct, 10, drives.closer);
      REQUIRE(tried.size() == 4);
      Matrix6d sum = direct.sqrt_information.transpose() * direct.sqrt_information;
      double accepted = 1;
      for (const LoopClosure& closure : tried) {
        if (closure.verdict == ClosureVerdict::accepted) ++accepted;
        sum += closure.sqrt_information.transpose() * closure.sqrt_information;
      }
      CHECK(accepted == 4);
      CHECK(sum.isApprox(accepted / (1 + (accepted - 1) * r) * alone, 1e-12));
    }
  }

  TEST_CASE("whatever the graph, what is reached and tried is what a naive search finds") {
    for_all(100, [](Rng& rng, int size) {
      const RandomMap map(rng, size);
      for (const bool through : {true, false}) {
        ChainOptions options = paper;
        options.through_current_session = through;
        ChainedCloser chainer(options);
        const std::vector<Index> found = numbers(chainer.connected(map.graph, KeyframeId{map.j}, map.loaded));
        const std::set<Index> expected = connected_naively(map.edges, map.j, map.loaded, through);
        CHECK(found.size() == expected.size());
        CHECK(std::set(found.begin(), found.end()) == expected);
        CHECK(numbers(chainer.connected(map.graph, KeyframeId{map.j}, map.loaded)) == found);

        if (size % 2 == 0) {
          options.max_distance = 14;
          options.min_separation = 1 + size % 7;
          options.max_alignments = 3;
          options.reach = size % 4;
        }
        TruthCloser closer;
        closer.truth = std::make_shared<const std::vector<SE3d>>(map.truth);
        LoopClosure direct = closer.align(map.keyframes, KeyframeId{map.j}, KeyframeId{map.current}, SE3d());
        PositionIndex index;
        index.rebuild(map.keyframes);
        for (const PositionIndex* const known : {static_cast<const PositionIndex*>(nullptr), &std::as_const(index)}) {
          LoopClosure shared = direct;
          std::vector<Index> tried;
          for (const LoopClosure& one :
               ChainedCloser(options).close(map.keyframes, map.graph, shared, map.loaded, closer, Serial{}, known))
            tried.push_back(one.from.value);
          CHECK(tried == map.candidates(options, map.T(map.current)));
        }
      }
    });
  }
}

}  // namespace chainslam
