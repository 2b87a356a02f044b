#include "chainslam/factor_graph/shared_estimates.hpp"

#include <doctest/doctest.h>

#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/lie/rn.hpp"
#include "support/street_walk.hpp"
#include "support/threads_cases.hpp"

using namespace chainslam;

namespace {

/// As a smoother looks to `SharedEstimates`: all estimates of an update are its number.
struct Counting {
  Values<R1d> estimates;
  std::vector<Key> keys;
  std::uint64_t number = 0;

  void update(std::uint64_t revisions) {
    keys.push_back(estimates.add(R1d()));
    number += revisions;
    for (const Key key : keys) estimates[key] = R1d(R1d::Tangent(static_cast<double>(number)));
  }
  [[nodiscard]] std::uint64_t revision() const { return number; }
  [[nodiscard]] Index size() const { return estimates.size(); }
  [[nodiscard]] const R1d& operator[](Key key) const { return estimates[key]; }
  [[nodiscard]] const std::vector<Key>& changed() const { return keys; }
  [[nodiscard]] const Values<R1d>& values() const { return estimates; }
};

}  // namespace

TEST_SUITE("factor_graph/shared_estimates") {
  THREADS_TEST_CASE("factor_graph/shared_estimates",
                    "other threads read whole updates, one after another, while the next one runs") {
    Counting smoother;
    SharedEstimates<R1d> shared;
    smoother.update(1);
    smoother.update(1);
    shared.publish(smoother);
    std::atomic<bool> done{false};
    std::atomic<Index> wrong{0}, reads{0};
    const auto read = [&] {
      double last = 0.0;
      while (!done.load()) {
        const Index size = shared.size();
        const std::vector<R1d> found = shared.read(std::vector<Key>{0, size - 1, 1});
        const double number = found[0].value()[0];
        for (const R1d& other : found) wrong += other == found[0] ? 0 : 1;
        const Values<R1d> all = shared.values();
        for (const R1d& other : all) wrong += other == all[0] ? 0 : 1;
        wrong += number >= last && all[0].value()[0] >= number && all.size() >= size ? 0 : 1;
        wrong += shared[0].value()[0] >= number ? 0 : 1;
        last = number;
        ++reads;
      }
    };
    std::vector<std::jthread> readers;
    for (int k = 0; k < 2; ++k) readers.emplace_back(read);
    for (int k = 0; k < 300 || reads.load() < 20; ++k) {
      if (k < 2000) smoother.update(k % 7 == 0 ? 2 : 1);
      shared.publish(smoother);
    }
    done = true;
    readers.clear();
    CHECK(wrong == 0);
    CHECK(shared.size() == smoother.size());
    CHECK(shared[5] == smoother[5]);
  }

  THREADS_TEST_CASE("factor_graph/shared_estimates", "an optimisation on several threads ends at the bits of one") {
    const auto walk = [] { return test::StreetWalk({.sessions = 2, .keyframes = 300, .blocks = 2}).graph(); };
    PoseGraph one = walk(), four = walk();
    REQUIRE(optimise(one, GaussNewton{}).ok());
    REQUIRE(optimise(four, GaussNewton{}, ThreadPool(4)).ok());
    CHECK(four.values() == one.values());
  }
}
