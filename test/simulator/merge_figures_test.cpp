#include <doctest/doctest.h>

#include <cstdint>
#include <cstdlib>
#include <vector>

#include "simulator/merge_runs.hpp"

// The figures of twenty worlds are those of bench_merges (bench/README.md); here are enough of them to notice a change.

namespace chainslam::test {

TEST_SUITE("simulator: merging sessions") {
  TEST_CASE("sessions of one campus are joined where they were, whatever three in ten fixes say, and nowhere else") {
    const auto preset = simulator::preset("nclt-like", simulator::PresetSize::small);
    REQUIRE(preset);
    const std::uint64_t seeds = std::getenv("CHAINSLAM_FULL") ? 4 : 1;
    for (std::uint64_t seed = 1; seed <= seeds; ++seed) {
      CAPTURE(seed);
      std::vector<SimulatedSession> sessions;
      for (const std::size_t number : {std::size_t{0}, std::size_t{1}})
        sessions.push_back(simulated_session(*preset, seed, number));
      for (const FixFault fault : {FixFault::none, FixFault::scattered, FixFault::biased}) {
        const MergeOutcome outcome = merged(with_fault(sessions, fault, seed));
        CAPTURE(static_cast<int>(fault));
        CHECK(outcome.wrong == 0);
        if (fault != FixFault::biased) CHECK(outcome.right == 1);
        if (fault == FixFault::biased) CHECK(outcome.tried > 0);  // other places are mistaken for it, and refused
        CHECK(outcome.worst < 0.5);
      }
    }
  }
}

}  // namespace chainslam::test
