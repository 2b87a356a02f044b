// How often sessions of simulated worlds are merged rightly, wrongly or not at all, with fixes as they are and with
// wrong ones, as a Markdown table: see bench/README.md.

#include <CLI/CLI.hpp>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "simulator/merge_runs.hpp"

namespace chainslam::bench {
namespace {

struct Options {
  std::string preset = "nclt-like";
  std::uint64_t seeds = 20, first_seed = 1;
  std::size_t sessions = 3;
};

constexpr std::pair<test::FixFault, const char*> faults[] = {
    {test::FixFault::none, "as simulated"},
    {test::FixFault::scattered, "30 % off by 50 m"},
    {test::FixFault::biased, "each later session off by 200 m"}};

void run(const Options& options) {
  const auto preset = simulator::preset(options.preset, simulator::PresetSize::small);
  if (!preset) throw std::invalid_argument("no preset " + options.preset);
  test::MergeOutcome sums[std::size(faults)];
  for (std::uint64_t seed = options.first_seed; seed < options.first_seed + options.seeds; ++seed) {
    std::vector<test::SimulatedSession> sessions;
    for (std::size_t s = 0; s < options.sessions; ++s) sessions.push_back(test::simulated_session(*preset, seed, s));
    for (std::size_t f = 0; f < std::size(faults); ++f) {
      const test::MergeOutcome outcome = test::merged(test::with_fault(sessions, faults[f].first, seed));
      std::fprintf(stderr, "seed %d, %s: %d of %d right, %d wrong, %d reverted, %d tried, worst %.2f m\n",
                   static_cast<int>(seed), faults[f].second, outcome.right, outcome.sessions, outcome.wrong,
                   outcome.reverted, outcome.tried, outcome.worst);
      sums[f] += outcome;
    }
  }
  std::printf(
      "| fixes | sessions | right | wrong | apart | reverted | places tried | against the fixes | worst |\n"
      "|---|---|---|---|---|---|---|---|---|\n");
  for (std::size_t f = 0; f < std::size(faults); ++f)
    std::printf("| %s | %d | %d | %d | %d | %d | %d | %d | %.2f m |\n", faults[f].second, sums[f].sessions,
                sums[f].right, sums[f].wrong, sums[f].sessions - sums[f].right - sums[f].wrong, sums[f].reverted,
                sums[f].tried, sums[f].against_fixes, sums[f].worst);
}

}  // namespace
}  // namespace chainslam::bench

int main(int argc, char** argv) {
  chainslam::bench::Options options;
  CLI::App app("merges of simulated sessions, right and wrong");
  app.add_option("--preset", options.preset, "of the simulator, in its small size")->capture_default_str();
  app.add_option("--seeds", options.seeds, "worlds")->capture_default_str();
  app.add_option("--first-seed", options.first_seed, "the first one's")->capture_default_str();
  app.add_option("--sessions", options.sessions, "of each world")->check(CLI::Range(2, 5))->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    chainslam::bench::run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
  }
  return 0;
}
