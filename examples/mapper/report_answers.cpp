#include "report_answers.hpp"

#include <algorithm>
#include <array>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "run_report_tables.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

/// "a, b and 3 more".
std::string listed(const std::vector<std::string>& names) {
  constexpr std::size_t most = 6;
  std::string text;
  for (std::size_t i = 0; i < std::min(most, names.size()); ++i) text += (text.empty() ? "" : ", ") + names[i];
  return names.size() > most ? text + " and " + std::to_string(names.size() - most) + " more" : text;
}

std::string merged(const support::RunSummary& summary) {
  std::vector<std::string> apart;
  for (const support::SessionSummary& session : summary.sessions)
    if (session.frame != summary.sessions.front().frame) apart.push_back(session.name);
  const std::string all = std::to_string(summary.sessions.size());
  if (apart.empty()) return "all " + all + " sessions are in one frame";
  return std::to_string(summary.sessions.size() - apart.size()) + " of " + all + " sessions are in the frame of " +
         summary.sessions.front().name + "; not merged with it: " + listed(apart);
}

std::string error(const RunOutcome& outcome) {
  const auto& errors = outcome.optimized_errors;
  if (!errors) return "not known: there is no ground truth";
  std::string text = metres(errors->translation.rmse) + " RMSE against the ground truth";
  if (errors->alignments > 1) text += " under " + counted(errors->alignments, "alignment");
  if (outcome.odometry_errors) text += ", odometry alone " + metres(outcome.odometry_errors->translation.rmse);
  if (const auto& between = outcome.inter_session_errors)
    text += "; " + metres(between->translation.rmse) + " between sessions at one place";
  return text;
}

Index closures_with(const SlamMap& map, bool reverted) {
  return to_index(std::ranges::count_if(map.closures, [reverted](const LoopClosure& closure) {
    return closure.verdict != ClosureVerdict::accepted && (closure.verdict == ClosureVerdict::reverted) == reverted;
  }));
}

std::string lost_or_doubtful(const RunOutcome& outcome) {
  const support::RunSummary& summary = outcome.summary;
  Index lost = 0, restarts = 0, contradicted = 0;
  for (const support::SessionSummary& session : summary.sessions) {
    contradicted += to_index(session.failures.size());
    if (session.loaded) continue;
    lost += session.unregistered_scans();
    restarts += session.health.restarts;
  }
  std::string text;
  const auto add = [&](Index count, const std::string& what, const std::string& became) {
    if (count > 0) text += (text.empty() ? "" : "; ") + counted(count, what) + " " + became;
  };
  add(lost, "scan", "lost of " + std::to_string(summary.scans));
  add(restarts, "restart", "of the local map");
  add(summary.degenerate_frames, "scan", "degenerate");
  add(contradicted, "step", "of odometry contradicted by closures or fixes");
  add(closures_with(*outcome.mapping.map, false), "closure", "rejected as outliers");
  add(closures_with(*outcome.mapping.map, true), "closure", "reverted");
  if (!text.empty()) return text;
  return summary.scans > 0 ? "nothing: all " + std::to_string(summary.scans) + " scans were registered" : "nothing";
}

struct KnownFile {
  std::string_view begin, end;  ///< of its name: between them is what distinguishes sessions or frames
  const char* what;
};

constexpr std::array known_files{KnownFile{"map", ".cslam", "the map, input of --load"},
                                 KnownFile{"map", ".ply", "point cloud"},
                                 KnownFile{"map", ".png", "picture"},
                                 KnownFile{"trajectory", ".tum", "poses of all scans"},
                                 KnownFile{"graph", ".g2o", "pose graph"},
                                 KnownFile{"keyframes", ".csv", ""},
                                 KnownFile{"closures", ".csv", ""},
                                 KnownFile{"frames", ".csv", ""},
                                 KnownFile{"summary", ".json", "all figures"},
                                 KnownFile{"config", ".toml", "settings"}};

}  // namespace

void add_answers(const RunOutcome& outcome, support::ReportData& data) {
  if (outcome.summary.sessions.size() > 1) data.answers.emplace_back("Merged", merged(outcome.summary));
  data.answers.emplace_back("Error", error(outcome));
  data.answers.emplace_back("Lost or doubtful", lost_or_doubtful(outcome));
}

void add_files(const fs::path& written, const fs::path& folder, support::ReportData& data) {
  std::vector<std::string> names;
  std::error_code unreadable;  // then there is nothing to list
  for (const fs::directory_entry& entry : fs::directory_iterator(written, unreadable))
    names.push_back(entry.path().filename().native());
  std::ranges::sort(names);
  const fs::path absolute = fs::absolute(folder, unreadable);
  data.folder = (unreadable ? folder : absolute.lexically_normal()).native();
  for (const KnownFile& known : known_files)
    for (const std::string& name : names)
      if (name.starts_with(known.begin) && name.ends_with(known.end)) data.files.push_back({name, known.what});
}

}  // namespace chainslam::mapper
