#include "simulator/simulate.hpp"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "exit_code.hpp"
#include "output.hpp"
#include "recorded_simulation.hpp"
#include "simulator/error_sources.hpp"
#include "simulator/recorded_files.hpp"
#include "support/configuration.hpp"
#include "support/interrupt.hpp"
#include "support/nearest_name.hpp"
#include "support/progress.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

std::string known_presets() {
  std::string names;
  for (const std::string_view name : simulator::preset_names())
    names += (names.empty() ? "" : ", ") + std::string(name);
  return names;
}

namespace {

/// What was probably meant by the first of some names that no error source has; empty if nothing is near.
std::string meant_error_source(const std::string& names) {
  const std::vector<std::string> known = support::names_of_list(simulator::error_source_names());
  for (const std::string& name : support::names_of_list(names))
    if (name != "all" && std::ranges::find(known, name) == known.end()) return support::suggestion(name, known);
  return "";
}

}  // namespace

simulator::Preset with_error_sources(const simulator::Preset& preset, const std::string& only,
                                     const std::string& without) {
  try {
    return simulator::without_errors(simulator::with_only_errors(preset, only), without);
  } catch (const std::invalid_argument& error) {
    throw support::ConfigError("simulate", "an error source has no such name",
                               only + " and without " + without + meant_error_source(only + "," + without),
                               std::string(error.what()));
  }
}

namespace {

struct Interrupted {};

/// Makes a folder with a progress line. @returns nothing if interrupted, and then nothing is kept.
/// @param interrupt  from before the folder was begun: no signal leaves one behind.
template <class Make>
std::optional<simulator::SimulationReport> make_with_progress(const OutputFolder& folder,
                                                              const support::Interrupt& interrupt, const Make& make) {
  support::Progress progress;
  try {
    const simulator::SimulationReport report = make([&](Index done, Index total) {
      if (interrupt.requested()) throw Interrupted();
      support::ProgressState state;
      state.stage = "simulating";
      state.done = done;
      state.total = total;
      progress.update(state);
    });
    progress.finish();
    return report;
  } catch (const Interrupted&) {
    progress.finish();
    std::fprintf(stderr, "interrupted: nothing was kept, and what stood at %s still does\n",
                 printable(folder.target().native()).c_str());
    return std::nullopt;
  }
}

int simulate_recorded(const SimulateArguments& arguments) {
  const RecordedSimulation simulation = make_recorded_simulation(arguments);
  const support::Interrupt interrupt;
  OutputFolder folder(arguments.out, arguments.overwrite);
  folder.drop_all_unless_committed();  // a data set without some of its files is of no use
  const ThreadPool pool(to_index(arguments.threads));
  const auto report = make_with_progress(folder, interrupt, [&](const simulator::SimulationProgress& progress) {
    return simulator::write_recorded_drive(
        *simulation.drive, simulation.texts, folder.path(), arguments.scans,
        [&](Index count, Index grain, const std::function<void(Index, Index)>& body) {
          pool.for_chunks(count, grain, body);
        },
        progress);
  });
  if (!report) return exit_interrupted;
  folder.commit();
  std::printf("%s\n%s%d scans%s, %.1f million points, %.0f s, %.0f m, %.0f MB in %s\n",
              printable(simulation.texts.source).c_str(), simulation.agreement.c_str(), report->scans,
              arguments.scans ? "" : " (not written)", 1e-6 * static_cast<double>(report->points), report->duration,
              report->length, 1e-6 * static_cast<double>(report->bytes), printable(folder.target().native()).c_str());
  return exit_good;
}

}  // namespace

int run(const SimulateArguments& arguments) {
  if (arguments.preset.empty() == arguments.trajectory.empty())
    throw support::ConfigError("simulate", "a preset or a trajectory is needed",
                               arguments.preset.empty() ? "neither" : "both",
                               "name a preset (" + known_presets() + ") or give --trajectory FILE");
  if (!arguments.trajectory.empty()) return simulate_recorded(arguments);
  auto preset = simulator::preset(arguments.preset, *simulator::preset_size(arguments.size));
  if (!preset)
    throw support::ConfigError(
        "simulate", "there is no such preset",
        arguments.preset + support::suggestion(arguments.preset, support::names_of_list(known_presets())),
        "take one of: " + known_presets());
  preset = with_error_sources(*preset, arguments.errors, arguments.without);
  if (arguments.sessions) {
    if (*arguments.sessions > preset->sessions.size())
      throw support::ConfigError("simulate", "the preset has fewer sessions", std::to_string(*arguments.sessions),
                                 "take at most " + std::to_string(preset->sessions.size()));
    preset->sessions.resize(*arguments.sessions);
  }
  const support::Interrupt interrupt;
  OutputFolder folder(arguments.out, arguments.overwrite);
  folder.drop_all_unless_committed();  // a data set without some of its files is of no use
  const auto made = make_with_progress(folder, interrupt, [&](const simulator::SimulationProgress& progress) {
    return simulator::simulate(*preset, arguments.seed, folder.path(), ThreadPool(to_index(arguments.threads)),
                               progress);
  });
  if (!made) return exit_interrupted;
  const simulator::SimulationReport& report = *made;
  folder.commit();
  std::printf("%s, seed %llu: %zu session%s, %d scans, %.1f million points, %.0f s, %.0f m, %.0f MB in %s\n",
              preset->name.c_str(), static_cast<unsigned long long>(arguments.seed), preset->sessions.size(),
              preset->sessions.size() == 1 ? "" : "s", report.scans, 1e-6 * static_cast<double>(report.points),
              report.duration, report.length, 1e-6 * static_cast<double>(report.bytes),
              printable(folder.target().native()).c_str());
  return exit_good;
}

}  // namespace chainslam::mapper
