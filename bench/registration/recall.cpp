// Recall of registration without a guess: crops of real scans at given overlap,
// random rotations, all methods on the same crops. See bench/README.md.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "proportion.hpp"
#include "registration/crops.hpp"
#include "registration/global_methods.hpp"
#include "versus.hpp"

namespace chainslam::bench {
namespace {

struct Options {
  int trials = 100;
  std::uint64_t seed = 1;
  std::vector<double> overlaps{0.9, 0.7, 0.5, 0.3};
  std::string only;      ///< methods whose name contains this
  bool details = false;  ///< a line for each trial that failed
};

/// What a method did at one overlap.
struct Tally {
  int trials = 0, right = 0, tight = 0, refused = 0;
  std::vector<double> metres, degrees, milliseconds;
};

double percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

void add(Tally& tally, const CropPair& pair, const GlobalMethod& method, const Options& options) {
  const double start = ThreadTime::now();
  const std::optional<SE3d> T = method.align(pair.source, pair.target);
  tally.milliseconds.push_back(1e3 * (ThreadTime::now() - start));
  ++tally.trials;
  if (!T) {
    ++tally.refused;
    if (options.details)
      std::printf("  %s, seed %llu: nothing found\n", method.name.c_str(), static_cast<unsigned long long>(pair.seed));
    return;
  }
  const SE3d off = pair.T_target_source.inverse() * *T;
  const double metres = off.translation().norm(), degrees = off.rotation().log().norm() * 180 / std::numbers::pi;
  if (metres < 2 && degrees < 5) {
    ++tally.right;
    tally.metres.push_back(metres);
    tally.degrees.push_back(degrees);
  }
  tally.tight += metres < 0.6 && degrees < 1.5 ? 1 : 0;
  if (options.details && !(metres < 0.6 && degrees < 1.5))
    std::printf("  %s, seed %llu: %.2f m, %.2f deg\n", method.name.c_str(), static_cast<unsigned long long>(pair.seed),
                metres, degrees);
}

void run(const Options& options, CropSource& crops) {
  std::vector<GlobalMethod> methods = global_methods();
  std::erase_if(methods,
                [&](const GlobalMethod& method) { return method.name.find(options.only) == std::string::npos; });
  std::printf(
      "Success: 2 m and 5 deg; tight: 0.6 m and 1.5 deg. In brackets "
      "Wilson's 95 %% bounds. Median errors of the\n"
      "successes; processor time of the thread, all steps from the raw "
      "crop on.\n\n");
  std::printf(
      "| overlap | method | success %% | tight %% | error m | error "
      "deg | ms | p95 ms |\n|---|---|---|---|---|---|---|---|\n");
  for (const double overlap : options.overlaps) {
    std::vector<Tally> tallies(methods.size());
    std::uint64_t seed = options.seed;
    int ambiguous = 0;
    for (int trial = 0; trial < options.trials; ++seed) {
      const std::optional<CropPair> pair = crops.crop(overlap, seed);
      if (!pair) {
        ++ambiguous;
        continue;
      }
      for (std::size_t k = 0; k < methods.size(); ++k) {
        const std::size_t next = (k + static_cast<std::size_t>(trial)) % methods.size();
        add(tallies[next], *pair, methods[next], options);
      }
      ++trial;
    }
    for (std::size_t k = 0; k < methods.size(); ++k) {
      const Tally& t = tallies[k];
      const auto bounds = [&](int hits) {
        const ShareBounds share = wilson(static_cast<std::size_t>(hits), static_cast<std::size_t>(t.trials));
        return std::pair(100 * share.low, 100 * share.high);
      };
      const auto [low, high] = bounds(t.right);
      const auto [tight_low, tight_high] = bounds(t.tight);
      std::printf(
          "| %.0f %% | %s | %.1f (%.1f to %.1f) | %.1f (%.1f to %.1f) | %.3f | "
          "%.2f | %.0f | %.0f |\n",
          100 * overlap, methods[k].name.c_str(), 100.0 * t.right / t.trials, low, high, 100.0 * t.tight / t.trials,
          tight_low, tight_high, percentile(t.metres, 0.5), percentile(t.degrees, 0.5), percentile(t.milliseconds, 0.5),
          percentile(t.milliseconds, 0.95));
    }
    std::printf("  (seeds %llu to %llu, %d ambiguous ones left out)\n", static_cast<unsigned long long>(options.seed),
                static_cast<unsigned long long>(seed - 1), ambiguous);
    std::fflush(stdout);
  }
}

std::optional<Options> parse(int count, char** words) {
  Options options;
  for (int i = 1; i < count; ++i) {
    const std::string word = words[i];
    const char* value = i + 1 < count ? words[i + 1] : nullptr;
    if (word == "--details") {
      options.details = true;
      continue;
    }
    if (value == nullptr) return std::nullopt;
    if (word == "--trials")
      options.trials = std::atoi(value);
    else if (word == "--seed")
      options.seed = std::strtoull(value, nullptr, 10);
    else if (word == "--overlap")
      options.overlaps = {std::atof(value) / 100};
    else if (word == "--method")
      options.only = value;
    else
      return std::nullopt;
    ++i;
  }
  if (options.trials < 1) return std::nullopt;
  return options;
}

}  // namespace
}  // namespace chainslam::bench

int main(int count, char** words) {
  using namespace chainslam::bench;
  const auto options = parse(count, words);
  if (!options) {
    std::fprintf(stderr,
                 "usage: bench_recall [--trials N] [--seed N] [--overlap "
                 "PERCENT] [--method PART-OF-NAME] [--details]\n");
    return 2;
  }
  const auto folder = CropSource::find_data();
  if (!folder) {
    std::fprintf(stderr,
                 "bench_recall: CHAINSLAM_UNPACKED_DATA names no "
                 "folder with kitti00_first101; run bench/run.sh\n");
    return 3;
  }
  try {
    CropSource crops(*folder);
    run(*options, crops);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_recall: %s\n", error.what());
    return 70;
  }
  return 0;
}
