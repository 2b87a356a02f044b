#include "chainslam/slam/closure_descent.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cstddef>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "slam/street.hpp"

namespace chainslam {
namespace {

constexpr Index descent_each = 10;  ///< keyframes of a session

/// Sessions whose closures are written down by hand, in the order in which they were accepted.
struct Lineage {
  SlamMap map;

  explicit Lineage(Index sessions) {
    for (Index s = 0; s < sessions; ++s) {
      map.sessions.push_back({SessionId{s}, {}, s * descent_each, descent_each, SessionId{0}, {}, {}});
      for (Index i = 0; i < descent_each; ++i) {
        map.keyframes.push_back(test::keyframe_at(i, test::shift(2 * i, s, 0)));
        map.keyframes.back().id = KeyframeId{s * descent_each + i};
        map.keyframes.back().session = SessionId{s};
      }
    }
  }

  /// @param from  session, then keyframe of it; the same of `to`.
  Index add(ClosureKind kind, std::pair<Index, Index> from, std::pair<Index, Index> to, Index cause = -1) {
    LoopClosure closure{.from = at(from), .to = at(to), .T_from_to = {}};
    closure.kind = kind;
    closure.cause = cause;
    closure.sqrt_information = SqrtInformation<6>::Identity();
    map.closures.push_back(closure);
    return to_index(map.closures.size()) - 1;
  }
  Index merge(std::pair<Index, Index> from, std::pair<Index, Index> to) { return add(ClosureKind::merge, from, to); }
  Index direct(std::pair<Index, Index> from, std::pair<Index, Index> to, Index cause = -1) {
    return add(ClosureKind::direct, from, to, cause);
  }
  Index chained(std::pair<Index, Index> from, std::pair<Index, Index> to, Index cause) {
    return add(ClosureKind::chained, from, to, cause);
  }

  /// Positions of the closures that go.
  [[nodiscard]] std::vector<Index> gone(const UndoRequest& request) const {
    const detail::Table<char> marks = descendants(map, request);
    std::vector<Index> positions;
    for (Offset i = 0; i < marks.size(); ++i)
      if (marks[i] != 0) positions.push_back(static_cast<Index>(i));
    return positions;
  }
  [[nodiscard]] std::vector<Index> gone(Index closure) const { return gone({.closures = {closure}}); }

 private:
  static KeyframeId at(std::pair<Index, Index> place) { return KeyframeId{place.first * descent_each + place.second}; }
};

using Positions = std::vector<Index>;

/// Accepts whatever it is asked for, and remembers how it was asked.
struct CompliantCloser {
  std::string asked;  ///< a: to align, r: to refine

  [[nodiscard]] bool eligible(const Keyframe&, const Keyframe&) const { return true; }
  [[nodiscard]] LoopClosure align(std::span<const Keyframe>, KeyframeId from, KeyframeId to, const SE3d& guess,
                                  const Serial&) {
    asked += 'a';
    return {.from = from, .to = to, .T_from_to = guess, .verdict = ClosureVerdict::accepted};
  }
  [[nodiscard]] LoopClosure refine(std::span<const Keyframe> keyframes, KeyframeId from, KeyframeId to,
                                   const SE3d& guess, const Serial& executor) {
    LoopClosure closure = align(keyframes, from, to, guess, executor);
    asked.back() = 'r';
    return closure;
  }
};

/// The same for several at a time.
struct CompliantClosers : CompliantCloser {
  using CompliantCloser::align;
  using CompliantCloser::refine;
  [[nodiscard]] std::vector<LoopClosure> align(std::span<const Keyframe> keyframes,
                                               std::span<const AlignmentGuess> guesses, KeyframeId to,
                                               const Serial& executor) {
    std::vector<LoopClosure> closures;
    for (const AlignmentGuess& one : guesses)
      closures.push_back(align(keyframes, one.from, to, one.T_from_to, executor));
    return closures;
  }
  [[nodiscard]] std::vector<LoopClosure> refine(std::span<const Keyframe> keyframes,
                                                std::span<const AlignmentGuess> guesses, KeyframeId to,
                                                const Serial& executor) {
    std::vector<LoopClosure> closures = align(keyframes, guesses, to, executor);
    std::fill_n(asked.end() - static_cast<std::ptrdiff_t>(guesses.size()), guesses.size(), 'r');
    return closures;
  }
};

}  // namespace

TEST_SUITE("slam/closure_descent") {
  TEST_CASE("nothing goes if nothing is undone, and only what is asked for if nothing came of it") {
    Lineage lineage(2);
    const Index a = lineage.direct({0, 0}, {0, 8});
    const Index b = lineage.direct({0, 1}, {0, 9});
    CHECK(lineage.gone(UndoRequest{}).empty());
    CHECK(lineage.gone(a) == Positions{a});
    CHECK(lineage.gone(b) == Positions{b});
  }

  TEST_CASE("a closure takes its chain with it, and the chains that went through it") {
    Lineage lineage(3);
    const Index tie = lineage.direct({0, 5}, {1, 5});  // between the first two sessions, joined by other means
    const Index seed = lineage.direct({1, 5}, {2, 5});
    const Index through = lineage.chained({0, 5}, {2, 5}, seed);
    const Index other = lineage.direct({2, 0}, {2, 9});
    CHECK(lineage.gone(seed) == Positions{seed, through});
    CHECK(lineage.gone(tie) == Positions{tie, through});
    CHECK(lineage.gone(through) == Positions{through});
    CHECK(lineage.gone(other) == Positions{other});
  }

  TEST_CASE("a chain stays where another way led to the same keyframe, also by keyframes around the partner") {
    Lineage lineage(3);
    const Index tie = lineage.direct({0, 5}, {1, 5});
    const Index near = lineage.direct({0, 5}, {1, 8});  // within the chain's reach of 4 keyframes
    const Index seed = lineage.direct({1, 5}, {2, 5});
    const Index through = lineage.chained({0, 5}, {2, 5}, seed);
    CHECK(lineage.gone(tie) == Positions{tie});
    CHECK(lineage.gone({.closures = {tie, near}}) == Positions{tie, near, through});
    const detail::Table<char> of_one = descendants(lineage.map, {.closures = {tie}}, {.reach = 2});
    CHECK(of_one[through] == 1);
  }

  TEST_CASE("what came after a chain is no way that it went") {
    Lineage lineage(3);
    const Index tie = lineage.direct({0, 5}, {1, 5});
    const Index seed = lineage.direct({1, 5}, {2, 5});
    const Index first = lineage.chained({0, 5}, {2, 5}, seed);
    const Index second = lineage.chained({0, 4}, {2, 5}, seed);  // the two of one chain do not hold each other
    lineage.direct({0, 5}, {1, 6});
    CHECK(lineage.gone(tie) == Positions{tie, first});
    CHECK(second == 3);
  }

  TEST_CASE("a merge goes with all its places, and takes what was found between its sides, at once and later") {
    Lineage lineage(2);
    const Index within = lineage.direct({0, 0}, {0, 9});
    const Index first = lineage.merge({0, 1}, {1, 1}), second = lineage.merge({0, 6}, {1, 6});
    const Index recheck = lineage.direct({0, 2}, {1, 2}, second);
    const Index chain = lineage.chained({0, 0}, {1, 2}, recheck);
    const Index later = lineage.direct({0, 8}, {1, 8});
    const Index own = lineage.direct({1, 0}, {1, 9});
    for (const Index place : {first, second})
      CHECK(lineage.gone(place) == Positions{first, second, recheck, chain, later});
    CHECK(lineage.gone(within) == Positions{within});
    CHECK(lineage.gone(own) == Positions{own});
  }

  TEST_CASE("of two merges, one takes only what it alone had brought together") {
    Lineage lineage(3);
    const Index ab = lineage.merge({0, 1}, {1, 1});
    const Index found_ab = lineage.direct({0, 2}, {1, 2});
    const Index bc = lineage.merge({1, 4}, {2, 4});
    const Index found_bc = lineage.direct({1, 5}, {2, 5});
    const Index found_ac = lineage.direct({0, 5}, {2, 6});
    CHECK(lineage.gone(ab) == Positions{ab, found_ab, found_ac});
    CHECK(lineage.gone(bc) == Positions{bc, found_bc, found_ac});
    // A merge between the outer two, which came later, has not found what came before it.
    const Index ac = lineage.merge({0, 7}, {2, 7});
    const Index again = lineage.direct({0, 8}, {2, 8});
    CHECK(lineage.gone(bc) == Positions{bc, found_bc, found_ac});
    CHECK(lineage.gone(ac) == Positions{ac});
    CHECK(lineage.gone({.closures = {bc, ac}}) == Positions{bc, found_bc, found_ac, ac, again});
  }

  TEST_CASE("places in two sessions confirm each other only in one frame; merges of two frames stand by themselves") {
    Lineage lineage(3);
    const Index ab = lineage.merge({0, 1}, {1, 1});
    lineage.direct({0, 0}, {0, 9});
    const Index ca = lineage.merge({0, 3}, {2, 3}), cb = lineage.merge({1, 5}, {2, 5});
    CHECK(lineage.gone(ab) == Positions{ab, ca, cb});
    CHECK(lineage.gone(cb) == Positions{ca, cb});
    Lineage apart(3);
    const Index first = apart.merge({0, 3}, {2, 3}), second = apart.merge({1, 5}, {2, 5});
    CHECK(apart.gone(first) == Positions{first});
    CHECK(apart.gone(second) == Positions{second});
  }

  TEST_CASE("a session takes all that touches it, and what was found over it") {
    Lineage lineage(3);
    const Index ab = lineage.merge({0, 1}, {1, 1});
    const Index own_b = lineage.direct({1, 0}, {1, 9});
    const Index bc = lineage.merge({1, 4}, {2, 4});
    const Index ac = lineage.direct({0, 5}, {2, 6});
    const Index own_c = lineage.direct({2, 0}, {2, 9});
    CHECK(lineage.gone({.sessions = {SessionId{1}}}) == Positions{ab, own_b, bc, ac});
    CHECK(lineage.gone({.sessions = {SessionId{2}}}) == Positions{bc, ac, own_c});
  }

  TEST_CASE("sessions that were in one frame by other means need no merge; a reverted merge holds none") {
    Lineage lineage(3);
    const Index placed = lineage.direct({0, 2}, {1, 2});
    const Index merge = lineage.merge({1, 4}, {2, 4});
    const Index found = lineage.direct({1, 5}, {2, 5});
    CHECK(lineage.gone(merge) == Positions{merge, found});
    CHECK(lineage.gone(placed) == Positions{placed});
    Lineage twice(2);
    const Index wrong = twice.merge({0, 1}, {1, 1});
    twice.map.closures.back().verdict = ClosureVerdict::reverted;
    const Index right = twice.merge({0, 4}, {1, 4});
    const Index after = twice.direct({0, 5}, {1, 5});
    CHECK(twice.gone(right) == Positions{right, after});
    CHECK(twice.gone(wrong) == Positions{wrong});
  }

  TEST_CASE("what was undone is refused whether it is aligned or refined, the other way round, too; the rest is not") {
    SlamMap map;
    map.keyframes.resize(3);
    UndoneClosures undone;
    undone.add(map, {.from = KeyframeId{0}, .to = KeyframeId{2}});
    Unrepeated<CompliantCloser> closer({}, undone);
    const auto verdicts = [&](Index from, Index to) {
      return std::pair{closer.align(map.keyframes, KeyframeId{from}, KeyframeId{to}, SE3d()).verdict,
                       closer.refine(map.keyframes, KeyframeId{from}, KeyframeId{to}, SE3d()).verdict};
    };
    CHECK(verdicts(0, 2) == std::pair(ClosureVerdict::reverted, ClosureVerdict::reverted));
    CHECK(verdicts(2, 0) == std::pair(ClosureVerdict::reverted, ClosureVerdict::reverted));
    CHECK(verdicts(1, 2) == std::pair(ClosureVerdict::accepted, ClosureVerdict::accepted));
    CHECK(closer.closer().asked == "ararar");
    static_assert(!BatchAligner<Unrepeated<CompliantCloser>> && BatchAligner<Unrepeated<CompliantClosers>>);

    Unrepeated<CompliantClosers> several({}, undone);
    const std::vector<AlignmentGuess> guesses{{KeyframeId{0}, SE3d()}, {KeyframeId{1}, SE3d()}};
    for (const auto& tried : {several.align(map.keyframes, guesses, KeyframeId{2}),
                              several.refine(map.keyframes, guesses, KeyframeId{2})}) {
      REQUIRE(tried.size() == 2);
      CHECK(tried[0].verdict == ClosureVerdict::reverted);
      CHECK(tried[1].verdict == ClosureVerdict::accepted);
    }
    CHECK(several.closer().asked == "aarr");
  }
}

}  // namespace chainslam
