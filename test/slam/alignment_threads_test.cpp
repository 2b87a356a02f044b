#include <doctest/doctest.h>

#include <span>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/slam/chained_closer.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "slam/street.hpp"
#include "support/threads_cases.hpp"

namespace chainslam {

static_assert(BatchAligner<LoopCloser<>>);

TEST_SUITE("slam/loop_closer") {
  THREADS_TEST_CASE("slam/loop_closer",
                    "several alignments of a scan on threads are those made one by one, bit for bit") {
    const test::Street street;
    std::vector<SE3d> poses = test::way_round();
    poses.resize(24);
    poses.push_back(poses[8] * SE3d(SO3d::exp({0.02, -0.03, 0.3}), {1.2, -0.8, 0.1}));
    std::vector<Keyframe> keyframes = test::keyframes_at(poses);
    for (std::size_t i = 0; i < keyframes.size(); ++i) keyframes[i].cloud = street.scan(poses[i], Rng(100 + i), 1500);
    const KeyframeId query = keyframes.back().id;
    std::vector<AlignmentGuess> guesses;
    for (const Index from : {3, 8, 12, 9, 20})
      guesses.push_back({KeyframeId{from}, poses[static_cast<std::size_t>(from)].inverse() * poses.back() *
                                               SE3d(SO3d::exp({0, 0, 0.03}), {0.3, -0.4, 0})});
    for (const std::size_t max_bytes : {SubmapOptions{}.max_bytes, std::size_t{1}}) {
      LoopCloserOptions options = test::small_submaps;
      options.submap.max_bytes = max_bytes;
      LoopCloser<> alone(options), together(options), on_threads(options);
      const auto same = together.align(keyframes, guesses, query);
      const auto same_on_threads = on_threads.align(keyframes, guesses, query, ThreadPool(3));
      REQUIRE(same.size() == guesses.size());
      REQUIRE(same_on_threads.size() == guesses.size());
      Index accepted = 0;
      for (std::size_t k = 0; k < guesses.size(); ++k) {
        const LoopClosure one = alone.align(keyframes, guesses[k].from, query, guesses[k].T_from_to);
        accepted += one.verdict == ClosureVerdict::accepted ? 1 : 0;
        for (const LoopClosure* other : {&same[k], &same_on_threads[k]}) {
          CHECK(other->from == guesses[k].from);
          CHECK(other->to == query);
          CHECK(other->verdict == one.verdict);
          CHECK(other->T_from_to == one.T_from_to);
          CHECK(other->sqrt_information == one.sqrt_information);
        }
      }
      CHECK(accepted >= 3);
      CHECK(on_threads.submaps().built() == together.submaps().built());
      CHECK(on_threads.submaps().fragments_built() == together.submaps().fragments_built());
      CHECK(on_threads.submaps().bytes() == together.submaps().bytes());
    }
    LoopCloser<> none(test::small_submaps);
    keyframes.back().cloud = nullptr;
    for (const LoopClosure& one : none.refine(keyframes, guesses, query, ThreadPool(2)))
      CHECK(one.verdict == ClosureVerdict::too_few_inliers);
    CHECK(none.align(keyframes, std::span<const AlignmentGuess>(), query).empty());
  }
}

}  // namespace chainslam
