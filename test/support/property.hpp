#pragma once

#include <doctest/doctest.h>

#include <cstdint>
#include <cstdlib>
#include <optional>
#include <string>

#include "chainslam/core/random.hpp"
#include "support/quick.hpp"

namespace chainslam::test {

/// The one seed to run, as CHAINSLAM_TEST_SEED states it, or nothing.
inline std::optional<std::uint64_t> seed_from_environment() {
  const char* text = std::getenv("CHAINSLAM_TEST_SEED");
  if (text == nullptr || *text == '\0') return std::nullopt;
  return std::stoull(text);
}

/// Checks a property on `count` random inputs: calls `property(Rng& rng, int size)` for the seeds 0, 1, ... A size
/// between 1 and 100 goes with each seed, small ones first, so that the first failure is a small one.
///
/// A failing check prints seed and size. CHAINSLAM_TEST_SEED=<seed> in the environment runs that seed alone; with
/// CHAINSLAM_QUICK, as under the slow sanitizers, every fourth seed of many is run.
template <class Property>
void for_all(int count, Property&& property) {
  const auto run = [&](std::uint64_t seed) {
    const int size = 1 + static_cast<int>(seed % 100);
    INFO("seed ", seed, ", size ", size, "; to repeat it alone: CHAINSLAM_TEST_SEED=", seed);
    Rng rng(seed);
    property(rng, size);
  };
  if (const auto seed = seed_from_environment()) return run(*seed);
  const int step = count >= 100 && quick() ? 4 : 1;
  for (int i = 0; i < count; i += step) run(static_cast<std::uint64_t>(i));
}

}  // namespace chainslam::test
