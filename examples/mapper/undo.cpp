#include <algorithm>
#include <charconv>
#include <cstdio>
#include <filesystem>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/slam/map_undo.hpp"
#include "console.hpp"
#include "end_on_interrupt.hpp"
#include "exit_code.hpp"
#include "map_export.hpp"
#include "map_file.hpp"
#include "mapping.hpp"
#include "output.hpp"
#include "saved_settings.hpp"
#include "support/configuration.hpp"
#include "support/progress.hpp"
#include "support/report_data.hpp"
#include "support/statistics.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

std::string inspect_remedy(const fs::path& map) {
  return "`chainslam inspect " + printable(map.native()) +
         " --closures` lists sessions and closures with their numbers";
}

/// A session by its number, or else by its name.
SessionId find_session(const SlamMap& map, const std::string& text, const fs::path& file) {
  Index number = -1;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  const bool is_number = error == std::errc() && end == text.data() + text.size();
  if (is_number && number >= 0 && number < to_index(map.sessions.size())) return SessionId{number};
  std::vector<SessionId> named;
  for (const Session& session : map.sessions)
    if (session.name == text) named.push_back(session.id);
  if (named.size() == 1) return named.front();
  std::string numbers;
  for (const SessionId id : named) numbers += (numbers.empty() ? "" : ", ") + std::to_string(id.value);
  throw support::ConfigError("--session", "a session's number, or a name that only one has",
                             named.empty()
                                 ? text + ", where the map has sessions 0 to " + std::to_string(map.sessions.size() - 1)
                                 : text + ", the name of sessions " + numbers,
                             inspect_remedy(file));
}

/// @param merges  whether they are asked for as merges. @throws support::ConfigError for numbers that are none's.
void take_closures(const SlamMap& map, const std::vector<int>& numbers, bool merges, const fs::path& file,
                   UndoRequest& request) {
  const std::string option = merges ? "--merge" : "--closure";
  for (const int number : numbers) {
    const auto refuse = [&](const std::string& found, const std::string& remedy) {
      throw support::ConfigError(option, merges ? "the number of a place of a merge" : "the number of a closure",
                                 std::to_string(number) + ", " + found, remedy);
    };
    if (number < 0 || number >= std::ssize(map.closures))
      refuse("where the map has " + std::to_string(map.closures.size()) + " closures", inspect_remedy(file));
    const LoopClosure& closure = map.closures[static_cast<std::size_t>(number)];
    if ((closure.kind == ClosureKind::merge) != merges)
      refuse("a " + support::name_of(closure.kind) + " closure",
             std::string("pass ") + (merges ? "--closure " : "--merge ") + std::to_string(number));
    if (closure.verdict == ClosureVerdict::reverted) refuse("which was taken back already", inspect_remedy(file));
    request.closures.push_back(number);
  }
}

UndoRequest request_of(const UndoArguments& arguments, const SlamMap& map) {
  UndoRequest request;
  for (const std::string& text : arguments.sessions)
    if (const SessionId id = find_session(map, text, arguments.map);
        std::ranges::find(request.sessions, id) == request.sessions.end())
      request.sessions.push_back(id);
  if (request.sessions.size() == map.sessions.size())
    throw support::ConfigError("--session", "what is left needs a session", "all sessions of the map",
                               "delete the file instead, or keep a session");
  take_closures(map, arguments.closures, false, arguments.map, request);
  take_closures(map, arguments.merges, true, arguments.map, request);
  return request;
}

void require_optimum(const ConvergeReport& report, const fs::path& map) {
  if (report.ok()) return;
  throw_input_error(map.string(), "",
                    "measurements that do not hold all keyframes without what was to be undone" +
                        (report.free.empty() ? "" : ": " + describe(report.free.front())),
                    "pass --replay: that decides again from the scans");
}

}  // namespace

int run(const UndoArguments& arguments) {
  const fs::path source = map_path(arguments.map);
  std::error_code ignored;
  if (fs::equivalent(source, arguments.out, ignored))
    throw_output_error(arguments.out.string(), "", "the map itself", "choose another name: a map is never changed");
  require_free(arguments.out, arguments.overwrite);
  const EndOnInterrupt interrupt(arguments.out);
  LoadedMap loaded = open_map(source);
  const UndoRequest request = request_of(arguments, loaded.map);
  const bool has_scans =
      std::ranges::any_of(loaded.map.keyframes, [](const Keyframe& k) { return k.cloud != nullptr; });
  if (arguments.replay && !has_scans)
    throw_input_error(source.string(), "", "no scans, without which nothing can be decided again",
                      "undo without --replay, or give the map that has them");
  SavedSettings settings =
      saved_settings(loaded.parameters, source, "undo with the version of chainslam that made the map");
  UndoneMap undone =
      without(loaded.map, request, settings.options.back_end.chain, settings.options.back_end.back_end.graph.anchor);
  support::Progress progress;
  support::StageTimes times;
  std::vector<std::string> notes = std::move(settings.notes);
  if (arguments.replay) {
    const MappingRun again{
        .options = settings.options, .threads = to_index(arguments.threads), .progress = progress, .times = times};
    for (std::string& note : replay_notes(loaded)) notes.push_back(std::move(note));
    undone.map = *map_again(undone.map, undone.undone, again);
  } else {
    progress.update({.stage = "optimizing", .keyframes = to_index(undone.map.keyframes.size())});
    require_optimum(optimize_map(undone.map, settings.options.back_end), source);
    progress.finish();
  }
  const SlamMap before = std::exchange(loaded.map, std::move(undone.map));
  loaded.parameters = settings.text;
  Output output(arguments.overwrite);
  if (!output.guarded(arguments.out, [&] { save_map(arguments.out, loaded, arguments.overwrite); }))
    return output.exit_code(exit_good);
  print_notes("note:", notes);
  std::printf("removed      %zu of %zu sessions with %d keyframes; %d of %zu closures%s\n", request.sessions.size(),
              before.sessions.size(), undone.removed_keyframes, undone.removed_closures, before.closures.size(),
              arguments.replay ? "" : ", descendants included");
  std::printf("sessions     %s\n", sessions_account(loaded.map).c_str());
  if (frames_of(loaded.map).size() > frames_of(before).size())
    std::printf("note         the map has more frames than before: nothing that remains connects them\n");
  std::printf("closures     %s\nsaved        %s\nwritten      %s\n", closures_account(loaded.map).c_str(),
              short_account(loaded.map).c_str(), printable(arguments.out.native()).c_str());
  return exit_good;
}

}  // namespace chainslam::mapper
