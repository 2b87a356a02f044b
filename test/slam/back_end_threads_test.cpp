#include <doctest/doctest.h>

#include <atomic>
#include <cstddef>
#include <memory>
#include <thread>
#include <vector>

#include "chainslam/slam/back_end.hpp"
#include "chainslam/slam/pipeline.hpp"
#include "slam/scripted.hpp"
#include "slam/street.hpp"
#include "support/threads_cases.hpp"

namespace chainslam {
namespace {

TEST_SUITE("slam/back_end") {
  THREADS_TEST_CASE("slam/back_end", "readers on other threads see whole maps while a pipeline adds keyframes") {
    const std::vector<SE3d> truth = test::way_round();
    Vector6d error;
    error << 0.01, 0.004, 0.002, 0.0002, 0, 0.0009;
    const std::vector<SE3d> odometry = test::drifting(truth, error);
    test::TruthCloser closer;
    closer.truth = std::make_shared<const std::vector<SE3d>>(truth);
    closer.candidates.min_interval = seconds(10);
    BackEnd<test::TruthCloser, NoChaining, NoMerging> back_end({}, closer);
    std::atomic<bool> done = false;
    std::size_t seen = 0, torn = 0;
    std::jthread reader([&] {
      do {
        const auto map = back_end.snapshot();
        const std::size_t steps = map->keyframes.empty() ? 0 : map->keyframes.size() - 1;
        if (map->keyframes.size() < seen || map->odometry.size() != steps) ++torn;
        seen = map->keyframes.size();
        if (const auto frame = back_end.T_map_odom(); frame && !frame->translation().allFinite()) ++torn;
      } while (!done);
    });
    const Serial serial;
    Pipeline pipeline(back_end, serial, NoCallback{}, 2);
    for (std::size_t i = 0; i < truth.size(); ++i) pipeline.add(test::keyframe_at(static_cast<double>(i), odometry[i]));
    pipeline.finish();
    const auto last = back_end.finish();
    done = true;
    reader.join();
    CHECK(torn == 0);
    CHECK(last->keyframes.size() == truth.size());
    CHECK_FALSE(last->closures.empty());
    CHECK(back_end.snapshot() == last);
  }
}

}  // namespace
}  // namespace chainslam
