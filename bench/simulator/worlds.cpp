// How much FAST-LIO2, as it was published, drifts in simulated worlds, and what each error source of a world adds to
// that, as Markdown: see bench/results.md. With --platform it has the settings that the program's preset `paper` gives
// it.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "mapper/options.hpp"
#include "mapper/session_odometry.hpp"
#include "odometry/outcome.hpp"
#include "simulator/error_sources.hpp"
#include "simulator/preset_description.hpp"
#include "simulator/town_drive.hpp"
#include "table_file.hpp"

namespace chainslam::bench {
namespace {

struct Options {
  std::filesystem::path out;
  std::string preset = "nclt-hard";
  std::string size = "medium";
  std::uint64_t seed = 1;
  std::size_t sessions = 5;
  Index scans = 0;             ///< of each session, from its beginning; 0: all
  std::string platform;        ///< of the paper's configuration; empty: the odometry's general settings
  std::string errors = "all";  ///< only these
  std::string without;
  bool by_source = false;
  int threads = 2;
};

/// A world, and what became of each session in it.
struct Variant {
  std::string name;
  simulator::Preset preset;
  std::vector<Outcome> outcomes{};
  std::vector<double> lengths{};  ///< metres
  std::vector<double> moving{};   ///< share of the returns that are from what moves
};

/// Share of the returns that are from what moves, by every twentieth scan.
double moving_share(const simulator::TownDrive& drive, Index scans) {
  std::int64_t moving = 0, all = 0;
  for (Index scan = 0; scan < scans; scan += 20)
    for (const simulator::LidarReturn& hit : drive.revolution(scan).returns) {
      ++all;
      if (hit.presence == simulator::Presence::moving) ++moving;
    }
  return all > 0 ? static_cast<double>(moving) / static_cast<double>(all) : 0.0;
}

/// The odometry that the program runs by its preset `paper`, in the form that `OdometryRun` takes.
class PaperOdometry {
 public:
  PaperOdometry(const std::string& platform, const SE3d& T_body_lidar) {
    mapper::MapperOptions options;
    mapper::configure(options, {}, {"preset=paper", "platform=" + platform});
    datasets::DatasetInfo dataset;
    dataset.T_body_lidar = T_body_lidar;
    odometry_ = mapper::make_session_odometry(options, dataset);
  }

  std::optional<Frame> process(const Packet& packet) { return odometry_->process(packet, threads_); }
  std::optional<Frame> flush() { return odometry_->flush(threads_); }
  [[nodiscard]] LidarOdometryCounts counts() const { return odometry_->counts(); }

 private:
  std::unique_ptr<mapper::SessionOdometry> odometry_;
  ThreadPool threads_{1};
};

/// Of the LiDAR at the ends of a drive's first scans.
test::Drive reference_of(const simulator::TownDrive& drive, const SE3d& T_body_lidar, std::size_t scans) {
  test::Drive reference;
  reference.T_body_lidar = T_body_lidar;
  reference.reference = drive.truth_at_scan_ends();
  reference.reference.times.resize(scans);
  reference.reference.poses.resize(scans);
  for (SE3d& pose : reference.reference.poses) pose = pose * T_body_lidar;
  return reference;
}

Outcome outcome_on(simulator::TownDrive& drive, const test::Drive& reference, const Options& options) {
  const auto next = [&]() -> std::optional<Packet> {
    std::optional<Packet> packet = drive.next();
    const auto* scan = packet ? std::get_if<LidarScan>(&*packet) : nullptr;
    if (scan && scan->end > reference.reference.times.back()) return std::nullopt;
    return packet;
  };
  if (options.platform.empty()) return outcomes_of<FastLio2Source>(reference, next)[0];
  PaperOdometry odometry(options.platform, reference.T_body_lidar);
  return outcome_of(reference, test::run_packets(next, odometry, reference.T_body_lidar));
}

void run_session(Variant& variant, std::size_t session, const Options& options) {
  simulator::TownDrive drive(variant.preset, options.seed, session);
  const Index scans = options.scans > 0 ? std::min(options.scans, drive.scan_count()) : drive.scan_count();
  const test::Drive reference = reference_of(drive, variant.preset.lidar.T_body_lidar, static_cast<std::size_t>(scans));
  variant.outcomes[session] = outcome_on(drive, reference, options);
  variant.lengths[session] = travelled(reference.reference);
  if (!options.by_source) variant.moving[session] = moving_share(drive, scans);
}

/// All sessions of all variants, as many at a time as there are threads.
void run_all(std::vector<Variant>& variants, const Options& options) {
  std::vector<std::pair<std::size_t, std::size_t>> runs;
  for (std::size_t i = 0; i < variants.size(); ++i) {
    variants[i].outcomes.resize(variants[i].preset.sessions.size());
    variants[i].lengths.resize(variants[i].preset.sessions.size());
    variants[i].moving.resize(variants[i].preset.sessions.size());
    for (std::size_t session = 0; session < variants[i].preset.sessions.size(); ++session)
      runs.emplace_back(i, session);
  }
  std::mutex printing;
  ThreadPool(options.threads).for_chunks(to_index(runs.size()), 1, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const auto [variant, session] = runs[static_cast<std::size_t>(i)];
      run_session(variants[variant], session, options);
      const Outcome& outcome = variants[variant].outcomes[session];
      const std::scoped_lock lock(printing);
      std::fprintf(stderr, "%s, session %zu: APE %.3f m, KITTI %.3f %%, %lld lost, %.1f ms\n",
                   variants[variant].name.c_str(), session + 1, outcome.ape.value_or(-1.0),
                   outcome.kitti.value_or(-1.0), static_cast<long long>(outcome.lost), outcome.milliseconds);
    }
  });
}

/// Means over the sessions.
struct Mean {
  double ape = 0;    ///< metres
  double kitti = 0;  ///< percent
  std::int64_t lost = 0;
};

Mean mean_of(const Variant& variant) {
  Mean mean;
  const auto count = static_cast<double>(variant.outcomes.size());
  for (const Outcome& outcome : variant.outcomes) {
    mean.ape += outcome.ape.value_or(0.0) / count;
    mean.kitti += outcome.kitti.value_or(0.0) / count;
    mean.lost += outcome.lost;
  }
  return mean;
}

std::string printed(const char* format, double value) {
  std::array<char, 64> text{};
  std::snprintf(text.data(), text.size(), format, value);
  return text.data();
}

std::string cell(const Mean& mean) {
  std::string text = printed("%.3f m", mean.ape) + printed(", %.2f %%", mean.kitti);
  return mean.lost > 0 ? text + ", " + std::to_string(mean.lost) + " lost" : text;
}

/// A row for each session.
std::string session_table(const Variant& variant) {
  std::string text =
      "| session | length | returns from what moves | APE | error over 100 to 800 m | scans lost "
      "|\n|---|---|---|---|---|---|\n";
  for (std::size_t i = 0; i < variant.outcomes.size(); ++i) {
    const Outcome& outcome = variant.outcomes[i];
    text += "| " + std::to_string(i + 1) + printed(" | %.0f m", variant.lengths[i]) +
            printed(" | %.0f %%", 100.0 * variant.moving[i]) + printed(" | %.2f m", outcome.ape.value_or(-1.0)) +
            printed(" | %.2f %%", outcome.kitti.value_or(-1.0)) + " | " + std::to_string(outcome.lost) + " |\n";
  }
  return text + "| mean | | | " + printed("%.2f m", mean_of(variant).ape) +
         printed(" | %.2f %%", mean_of(variant).kitti) + " | |\n";
}

/// The options in which two presets differ, as one line.
std::string differences(const simulator::Preset& preset, const simulator::Preset& without) {
  std::string text = simulator::describe_options(preset), other = simulator::describe_options(without), found;
  for (std::size_t end = text.find('\n'), from = 0; end != std::string::npos;
       from = end + 1, end = text.find('\n', from)) {
    const std::string line = text.substr(from, end - from);
    if (("\n" + other).find("\n" + line + "\n") == std::string::npos)
      (found += found.empty() ? "`" : ", `") += line + "`";
  }
  return found;
}

/// A row for each error source of the world: alone, and all without it.
std::string source_table(const simulator::Preset& preset, const Options& options) {
  std::vector<Variant> variants{{"all", preset}, {"none", simulator::without_errors(preset, "all")}};
  std::vector<simulator::ErrorSource> present;
  std::string absent;
  for (const simulator::ErrorSource& source : simulator::error_sources()) {
    const simulator::Preset without = simulator::without_errors(preset, source.name);
    if (differences(preset, without).empty()) {
      absent += (absent.empty() ? "" : ", ") + std::string(source.name);
      continue;
    }
    present.push_back(source);
    variants.push_back({std::string(source.name) + " alone", simulator::with_only_errors(preset, source.name)});
    variants.push_back({"without " + std::string(source.name), without});
  }
  run_all(variants, options);
  std::string text = "All error sources: " + cell(mean_of(variants[0])) + "; none: " + cell(mean_of(variants[1])) +
                     ". Not in this world: " + (absent.empty() ? "none" : absent) +
                     ".\n\n| error source | size | alone | all but this |\n|---|---|---|---|\n";
  for (std::size_t i = 0; i < present.size(); ++i) {
    const simulator::ErrorSource& source = present[i];
    text += "| " + std::string(source.name) + ": " + std::string(source.summary) + " | " +
            differences(preset, simulator::without_errors(preset, source.name)) + "; " + std::string(source.reference) +
            " | " + cell(mean_of(variants[2 + 2 * i])) + " | " + cell(mean_of(variants[3 + 2 * i])) + " |\n";
  }
  return text;
}

std::string tables(const Options& options) {
  const auto size = simulator::preset_size(options.size);
  auto preset = size ? simulator::preset(options.preset, *size) : std::nullopt;
  if (!preset) throw std::invalid_argument("there is no preset " + options.preset + " of size " + options.size);
  if (preset->sessions.size() > options.sessions) preset->sessions.resize(options.sessions);
  *preset = simulator::without_errors(simulator::with_only_errors(*preset, options.errors), options.without);
  std::string text = "## " + options.preset + "/" + options.size + ", seed " + std::to_string(options.seed) +
                     ": FAST-LIO2 as published" +
                     (options.platform.empty() ? "" : ", as the paper configures it for " + options.platform) +
                     "\n\nSimulated; options " + simulator::options_hash(*preset) +
                     "; sessions: " + std::to_string(preset->sessions.size()) +
                     (options.scans > 0 ? ", the first " + std::to_string(options.scans) + " scans" : "") +
                     ". APE after SE(3) alignment of each session by itself.\n\n";
  if (options.by_source) return text + source_table(*preset, options);
  std::vector<Variant> variants{{options.preset, *preset}};
  run_all(variants, options);
  return text + session_table(variants[0]);
}

}  // namespace
}  // namespace chainslam::bench

int main(int count, char** words) {
  using namespace chainslam;
  bench::Options options;
  CLI::App app("Drift of FAST-LIO2 in simulated worlds, as Markdown");
  app.add_option("--out", options.out, "where the table goes")->required();
  app.add_option("--preset", options.preset, "of the simulator (default nclt-hard)");
  app.add_option("--size", options.size, "small, medium, large or full (default medium)");
  app.add_option("--seed", options.seed, "of the world and of all noise (default 1)");
  app.add_option("--sessions", options.sessions, "only the first so many (default 5)")->check(CLI::PositiveNumber);
  app.add_option("--scans", options.scans, "only the first so many of each session (default all)")
      ->check(CLI::PositiveNumber);
  app.add_option("--platform", options.platform, "the paper's configuration for it (default: general settings)")
      ->check(CLI::IsMember({"nclt", "mars"}));
  app.add_option("--errors", options.errors, "only these error sources, separated by commas (default all)");
  app.add_option("--without", options.without, "not these");
  app.add_flag("--by-source", options.by_source, "a row for each error source: alone, and all without it");
  app.add_option("--threads", options.threads, "sessions at a time (default 2)")->check(CLI::Range(1, 1024));
  CLI11_PARSE(app, count, words);
  return bench::write_table("bench_worlds", options.out, [&] { return bench::tables(options); });
}
