#include "simulator/simulate.hpp"

#include <cstdio>
#include <filesystem>
#include <string>
#include <string_view>

#include "chainslam/core/thread_pool.hpp"
#include "exit_code.hpp"
#include "output_folder.hpp"
#include "support/configuration.hpp"
#include "support/interrupt.hpp"
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

struct Interrupted {};

}  // namespace

int run(const SimulateArguments& arguments) {
  auto preset = simulator::preset(arguments.preset, *simulator::preset_size(arguments.size));
  if (!preset)
    throw support::ConfigError("simulate", "there is no such preset", arguments.preset,
                               "take one of: " + known_presets());
  if (arguments.sessions) {
    if (*arguments.sessions > preset->sessions.size())
      throw support::ConfigError("simulate", "the preset has fewer sessions", std::to_string(*arguments.sessions),
                                 "take at most " + std::to_string(preset->sessions.size()));
    preset->sessions.resize(*arguments.sessions);
  }
  OutputFolder folder(arguments.out, arguments.overwrite);
  const support::Interrupt interrupt;
  support::Progress progress;
  simulator::SimulationReport report;
  try {
    report = simulator::simulate(*preset, arguments.seed, folder.path(), ThreadPool(to_index(arguments.threads)),
                                 [&](Index done, Index total) {
                                   if (interrupt.requested()) throw Interrupted();
                                   support::ProgressState state;
                                   state.stage = "simulating";
                                   state.done = done;
                                   state.total = total;
                                   progress.update(state);
                                 });
  } catch (const Interrupted&) {
    progress.finish();
    std::fprintf(stderr, "interrupted: nothing was kept, and what stood at %s still does\n", folder.target().c_str());
    return exit_interrupted;
  }
  progress.finish();
  folder.commit();
  std::printf("%s, seed %llu: %zu session%s, %d scans, %.1f million points, %.0f s, %.0f m, %.0f MB in %s\n",
              preset->name.c_str(), static_cast<unsigned long long>(arguments.seed), preset->sessions.size(),
              preset->sessions.size() == 1 ? "" : "s", report.scans, 1e-6 * static_cast<double>(report.points),
              report.duration, report.length, 1e-6 * static_cast<double>(report.bytes), folder.target().c_str());
  return exit_good;
}

}  // namespace chainslam::mapper
