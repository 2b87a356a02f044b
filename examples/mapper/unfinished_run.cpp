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
#include "saved_settings.hpp"
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

  SavedSettings settings =
      saved_settings(recorded.parameters, run.inputs,
                     "recover with the version of chainslam that began the run, or pass --no-replay: that takes what "
                     "the run had closed so far");
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
