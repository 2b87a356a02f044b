#include <doctest/doctest.h>

#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/slam/map_merger.hpp"
#include "slam/scripted.hpp"
#include "slam/street.hpp"

// What joins two frames by the defaults of `MergeOptions`: registrations are what a script says.

namespace chainslam {
namespace {

/// Two sessions along one street, 2.1 m between keyframes, the second in a frame that lies a kilometre off.
struct TwoFrames {
  static constexpr Index each = 60;
  SlamMap map;
  test::TruthCloser closer;
  std::shared_ptr<test::Script> script = std::make_shared<test::Script>();

  TwoFrames() {
    const SE3d T_frame_world(SO3d::exp({0, 0, 2}), {800, -600, 0});
    std::vector<SE3d> truth;
    for (Index session = 0; session < 2; ++session) {
      map.sessions.push_back({SessionId{session}, {}, session * each, each, SessionId{session}, {}, {}});
      for (Index i = 0; i < each; ++i) {
        truth.emplace_back(SO3d::exp({0, 0, 0.01 * i}), Eigen::Vector3d(2.1 * i, session, 0));
        Keyframe keyframe = test::keyframe_at(i, session == 0 ? truth.back() : T_frame_world * truth.back());
        keyframe.id = KeyframeId{session * each + i};
        keyframe.session = SessionId{session};
        map.keyframes.push_back(keyframe);
      }
    }
    closer.truth = std::make_shared<const std::vector<SE3d>>(std::move(truth));
  }

  /// Of the second session's keyframe: registration finds where it was, but for the error in its own frame.
  test::Place& place(Index query, const SE3d& error = {}) {
    const SE3d T = (*closer.truth)[static_cast<std::size_t>(query)].inverse() *
                   (*closer.truth)[static_cast<std::size_t>(each + query)] * error;
    script->places.push_back({each + query, query, T});
    return script->places.back();
  }

  /// Attempts to find all keyframes of the second session.
  /// @returns the first keyframe that joined the frames, and what was refused by then.
  struct Result {
    std::optional<Index> joined;
    std::vector<ClosureVerdict> refused;
  };
  [[nodiscard]] Result run(MergeOptions options = {}) {
    options.measurement = MergeMeasurement::submaps;  // the places' own poses count
    MapMerger<test::ScriptedPlaces, test::ScriptedRegistration> merger(options, {script}, {script});
    Result result;
    for (Index i = 0; i < each && !result.joined; ++i)
      for (const LoopClosure& closure : merger.attempt(map, KeyframeId{each + i}, closer)) {
        if (closure.verdict == ClosureVerdict::accepted)
          result.joined = i;
        else
          result.refused.push_back(closure.verdict);
      }
    return result;
  }
};

/// Whether two places join the frames, of which the second is changed.
template <class Change>
bool joins(Change&& change, Index second = 20, const SE3d& error = {}) {
  TwoFrames frames;
  frames.place(10);
  change(frames.place(second, error));
  return frames.run().joined.has_value();
}
bool joins(Index second, const SE3d& error = {}) {
  return joins([](test::Place&) {}, second, error);
}

}  // namespace

TEST_SUITE("slam/map_merger: values") {
  TEST_CASE("a registration that did not verify itself needs 0.3 of the submap and 0.05 of the features") {
    CHECK(joins([](test::Place& place) { place.fitness = 0.32; }));
    CHECK_FALSE(joins([](test::Place& place) { place.fitness = 0.28; }));
    CHECK(joins([](test::Place& place) { place.putative_ratio = 0.06; }));
    CHECK_FALSE(joins([](test::Place& place) { place.putative_ratio = 0.04; }));
    TwoFrames frames;
    frames.place(10).fitness = 0.28;
    frames.place(20).putative_ratio = 0.04;
    CHECK(frames.run().refused == std::vector{ClosureVerdict::low_fitness, ClosureVerdict::low_fitness});
  }

  TEST_CASE("two places have to agree, 10 m apart") {
    TwoFrames one;
    one.place(10);
    CHECK_FALSE(one.run().joined);
    CHECK(joins(16));
    CHECK_FALSE(joins(13));
  }

  TEST_CASE("they agree to 2 m and 2 % of the path between them, and to 0.1 rad, where the newer lies") {
    CHECK(joins(20, SE3d(SO3d(), {0, 1.8, 0})));
    CHECK_FALSE(joins(20, SE3d(SO3d(), {0, 3, 0})));
    CHECK(joins(58, SE3d(SO3d(), {0, 3.6, 0})));  // 100 m on: 2 m more
    CHECK_FALSE(joins(58, SE3d(SO3d(), {0, 5, 0})));
    CHECK_FALSE(joins(20, SE3d(SO3d::exp({0, 0, 0.15}), {0, 0, 0})));
    // A turn at the newer place moves it nowhere, though it moves the frame's origin, a kilometre off, by 80 m.
    CHECK(joins(20, SE3d(SO3d::exp({0, 0, 0.08}), {0, 0, 0})));
  }

  TEST_CASE("places are looked for every 4 m of the path") {
    TwoFrames frames;
    for (Index i = 0; i < 20; ++i) frames.place(i).fitness = 0;
    CHECK(frames.run().refused.size() == 10);
  }
}

}  // namespace chainslam
