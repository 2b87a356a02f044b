#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <system_error>

#include "chainslam/core/error.hpp"
#include "chainslam/io/map_archive.hpp"
#include "console.hpp"
#include "end_on_interrupt.hpp"
#include "exit_code.hpp"
#include "map_file.hpp"
#include "output.hpp"
#include "unfinished_run.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

/// Reads what was written once more, from its start to its end, and compares it with what was to be written.
void check_copy(const std::filesystem::path& path, const SlamMap& map) {
  const LoadedMap copy = open_map(path);
  const bool same =
      copy.map.sessions.size() == map.sessions.size() && copy.map.odometry.size() == map.odometry.size() &&
      copy.map.closures.size() == map.closures.size() && copy.map.refusals.size() == map.refusals.size() &&
      std::equal(copy.map.keyframes.begin(), copy.map.keyframes.end(), map.keyframes.begin(), map.keyframes.end(),
                 [](const Keyframe& a, const Keyframe& b) {
                   return a.time == b.time && a.T_map_body == b.T_map_body && !a.cloud == !b.cloud &&
                          (!a.cloud || a.cloud.load()->positions == b.cloud.load()->positions);
                 });
  if (!same)
    throw_output_error(path.string(), "", "another map than was written", "check the disk, and do not use this file");
}

int recover_file(const std::filesystem::path& path, const RecoverArguments& arguments) {
  const LoadedMap loaded = open_map(path, {.recover = true});
  Output output(arguments.overwrite);
  const bool saved = output.guarded(arguments.out, [&] {
    save_map(arguments.out, loaded, arguments.overwrite);
    check_copy(arguments.out, loaded.map);
  });
  if (!saved) return output.exit_code(exit_good);
  for (const std::string& line : losses(loaded)) std::printf("lost         %s\n", printable(line).c_str());
  if (loaded.report.complete) std::printf("nothing was lost: the map was intact\n");
  std::printf("saved        %s\nwritten      %s\n", short_account(loaded.map).c_str(),
              printable(arguments.out.native()).c_str());
  return exit_good;
}

}  // namespace

int run(const RecoverArguments& arguments) {
  std::error_code ignored;
  const UnfinishedRun unfinished = find_unfinished(arguments.map);
  for (const std::filesystem::path& source : {unfinished.map, unfinished.inputs})
    if (std::filesystem::equivalent(source, arguments.out, ignored))
      throw_output_error(arguments.out.string(), "", "the map that is to be recovered itself",
                         "choose another name: nothing is ever recovered in place");
  require_free(arguments.out, arguments.overwrite);
  const EndOnInterrupt interrupt(arguments.out);
  if (!unfinished.inputs.empty() && !arguments.replay && !has_closed_any(unfinished))
    throw_input_error(unfinished.map.string(), "", "nothing that the run had closed",
                      "recover without --no-replay: what the run was given is kept beside it");
  if (unfinished.inputs.empty() || !arguments.replay) return recover_file(unfinished.map, arguments);
  const std::optional<RepeatedRun> repeated = repeat(unfinished, arguments);
  if (!repeated) return recover_file(unfinished.map, arguments);
  check_copy(arguments.out, *repeated->map);
  print_notes("note:", repeated->notes);
  std::printf("recovered    %s\nsaved        %s\nwritten      %s\n", repeated->account.c_str(),
              short_account(*repeated->map).c_str(), printable(arguments.out.native()).c_str());
  return exit_good;
}

}  // namespace chainslam::mapper
