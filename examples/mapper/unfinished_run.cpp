#include "unfinished_run.hpp"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "map_file.hpp"
#include "mapping.hpp"
#include "options.hpp"
#include "support/progress.hpp"
#include "support/statistics.hpp"

namespace chainslam::mapper {

namespace fs = std::filesystem;

namespace {

fs::path partial(const fs::path& folder, const char* name) { return folder / (std::string(name) + ".partial"); }

bool is_file(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

/// The maps that a run had loaded: where they were, and what they were.
std::vector<SlamMap> loaded_maps(const JournaledInput& recorded, const fs::path& inputs,
                                 const std::shared_ptr<ScanCache>& scans) {
  std::vector<SlamMap> maps;
  for (const LoadedReference& reference : recorded.loaded) {
    if (!is_file(reference.path) || content_of(reference.path) != reference.content)
      throw_input_error(inputs.string(), "",
                        "a run that had loaded " + reference.path +
                            (is_file(reference.path) ? ", which is another map now" : ", which is not there any more"),
                        "put that map back, or pass --no-replay: that takes what the run had closed so far");
    maps.push_back(open_map(reference.path, {.scan_cache = scans}).map);
  }
  return maps;
}

/// A run's settings, as far as this version of the program has them.
struct RunSettings {
  MapperOptions options;
  std::string text;                ///< as a file; the run's own where this version has all of them
  std::vector<std::string> notes;  ///< what this version does not have, and what it has beside
};

/// The first of them, and how many more there are.
std::string some_of(const std::vector<std::string>& names) {
  constexpr std::size_t most = 20;
  std::string text;
  for (std::size_t i = 0; i < std::min(most, names.size()); ++i) text += (i == 0 ? "" : ", ") + names[i];
  return text + (names.size() > most ? " and " + std::to_string(names.size() - most) + " more" : "");
}

RunSettings settings_of(const JournaledInput& recorded, const fs::path& inputs) {
  RunSettings settings{.options = {}, .text = recorded.parameters, .notes = {}};
  support::Configuration configuration = make_configuration(settings.options);
  std::vector<std::string> left_out;
  try {
    left_out = configuration.load_foreign_text(recorded.parameters, "parameters");
    configuration.apply();
  } catch (const support::ConfigError& error) {
    const std::string problem = error.what();
    throw_input_error(inputs.string(), "",
                      "a configuration that this version cannot use: " + problem.substr(0, problem.find('\n')),
                      "recover with the version of chainslam that began the run, or pass --no-replay: that takes what "
                      "the run had closed so far");
  }
  const std::vector<std::string> defaults = configuration.unassigned();
  if (left_out.empty() && defaults.empty()) return settings;
  settings.text = configuration_text(settings.options);
  settings.notes.emplace_back("another version of chainslam began this run: its own map may have differed");
  if (!left_out.empty())
    settings.notes.push_back("settings left out, which this version does not have: " + some_of(left_out));
  if (!defaults.empty())
    settings.notes.push_back("settings of this version that the run does not state, at their defaults: " +
                             some_of(defaults));
  return settings;
}

Index keyframes_in(const fs::path& map) {
  try {
    return to_index(open_map(map, {.recover = true, .scans = false}).map.keyframes.size());
  } catch (const IoError&) {
    return 0;  // nothing of it was committed yet
  }
}

}  // namespace

UnfinishedRun find_unfinished(const fs::path& path) {
  std::error_code error;
  const bool is_folder = fs::is_directory(path, error);
  const fs::path folder = is_folder ? path : path.parent_path();
  const fs::path inputs = partial(folder, inputs_name);
  // A map that has its name is whole: nothing has to be done again for it.
  if (is_folder && is_file(folder / map_name)) return {{}, folder / map_name};
  const bool of_run =
      is_folder || path.filename() == inputs.filename() || path.filename() == partial(folder, map_name).filename();
  if (of_run && is_file(inputs)) return {inputs, partial(folder, map_name)};
  return {{}, is_folder ? partial(folder, map_name) : path};
}

bool has_closed_any(const UnfinishedRun& run) { return keyframes_in(run.map) > 0; }

std::optional<RepeatedRun> repeat(const UnfinishedRun& run, const RecoverArguments& arguments) {
  const auto scans = std::make_shared<ScanCache>();
  JournaledInput recorded = read_input_journal(run.inputs, scans);
  std::vector<SlamMap> loaded = loaded_maps(recorded, run.inputs, scans);
  Index known = recorded.keyframes;
  for (const SlamMap& map : loaded) known += to_index(map.keyframes.size());
  if (keyframes_in(run.map) > known) return std::nullopt;

  RunSettings settings = settings_of(recorded, run.inputs);
  support::Progress progress;
  support::StageTimes times;
  MapJournal journal(arguments.out, {.overwrite = arguments.overwrite, .parameters = settings.text});
  const MappingRun again{.options = settings.options,
                         .threads = to_index(arguments.threads),
                         .progress = progress,
                         .times = times,
                         .journal = [&](const SlamMap& map) { journal.update(map); }};
  RepeatedRun repeated;
  repeated.notes = std::move(settings.notes);
  repeated.account = std::to_string(recorded.keyframes) + " keyframes of the run" +
                     (recorded.problems.empty() ? ", all that it had shown" : "; " + recorded.problems.front());
  repeated.map = run_again(std::move(recorded.inputs), std::move(loaded), again);
  journal.finish(*repeated.map);
  return repeated;
}

}  // namespace chainslam::mapper
