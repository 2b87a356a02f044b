#include "map_inspect.hpp"

#include <algorithm>
#include <cstdio>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "map_export.hpp"
#include "map_file.hpp"
#include "support/closure_words.hpp"
#include "support/frame_health.hpp"
#include "support/report_data.hpp"
#include "support/session_joins.hpp"

namespace chainslam::mapper {

namespace {

std::string decimal(const char* format, double value) {
  char text[64];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string megabytes(std::uint64_t bytes) { return decimal("%.3f MB", 1e-6 * static_cast<double>(bytes)); }

std::string session_words(const SlamMap& map, const Session& session) {
  std::string text = session.name.empty() ? "" : '"' + printable(session.name) + "\", ";
  text += std::to_string(session.keyframes) + " keyframes";
  if (session.keyframes > 0) {
    const Trajectory path = keyframe_trajectory(map, {session.id});
    text += decimal(", %.1f m", path_length(path)) + decimal(", %.1f s", to_seconds(path.times.back() - path.times[0]));
  }
  if (session.frame.valid() && session.frame != session.id)
    text += ", in the frame of session " + std::to_string(session.frame.value);
  return text;
}

/// What the map says of its frames; nothing of a map made before it kept them.
void add_health(const SlamMap& map, const Session& session, datasets::Inspection& result) {
  const support::SessionHealth health = support::health_of(map.frames.of(session.id));
  if (health.frames == 0) return;
  const std::string name = "session " + std::to_string(session.id.value);
  result.facts.emplace_back(name + ": frames", std::to_string(health.frames) + ", " + std::to_string(health.lost) +
                                                   " lost, " + std::to_string(health.degenerate) + " degenerate");
  for (const support::FrameInterval& interval : health.intervals)
    if (interval.concern == support::FrameConcern::lost)
      result.warnings.push_back(name + ": " + std::to_string(interval.frames) + " scans lost" +
                                decimal(" from %.1f s", interval.begin) + decimal(" to %.1f s", interval.end) +
                                decimal(", over %.1f m, ", interval.distance) + std::to_string(interval.restarts) +
                                " restarts of the local map");
}

void add_closures(const SlamMap& map, datasets::Inspection& result) {
  result.facts.emplace_back("closures", std::to_string(map.closures.size()));
  std::map<std::string, int> kinds, verdicts;
  for (const LoopClosure& closure : map.closures) ++kinds[support::name_of(closure.kind)];
  for (const LoopClosure& refusal : map.refusals) ++verdicts[support::name_of(refusal.verdict)];
  for (const auto& [kind, count] : kinds) result.facts.emplace_back("closures." + kind, std::to_string(count));
  result.facts.emplace_back("refusals", std::to_string(map.refusals.size()));
  for (const auto& [verdict, count] : verdicts) result.facts.emplace_back("refusals." + verdict, std::to_string(count));
}

/// How sessions were joined, and what was taken back.
void add_joins(const SlamMap& map, datasets::Inspection& result) {
  for (const support::SessionJoin& join : support::session_joins(map)) {
    const std::string doubts = support::doubts_of(join);
    result.facts.emplace_back(
        "sessions " + std::to_string(join.first.value) + " and " + std::to_string(join.second.value),
        "joined by " + support::evidence_of(join) + (doubts.empty() ? "" : "; " + doubts));
  }
}

void add_file(const LoadedMap& loaded, datasets::Inspection& result) {
  const MapFileReport& report = loaded.report;
  char id[24];
  std::snprintf(id, sizeof id, "%016llx", static_cast<unsigned long long>(loaded.id));
  result.facts.emplace_back("format", std::to_string(report.format_major) + '.' + std::to_string(report.format_minor));
  result.facts.emplace_back("id", id);
  result.facts.emplace_back("size", megabytes(report.file_bytes));
  for (const MapFileShare& share : report.shares) {
    std::string text = megabytes(share.bytes) + " in " + std::to_string(share.chunks);
    if (share.kind == "scan" && share.records > 0)
      text += ", " + std::to_string(share.records) + " points, " +
              decimal("%.2f bytes a point", static_cast<double>(share.bytes) / static_cast<double>(share.records));
    result.facts.emplace_back("size." + share.kind, text);
  }
  result.facts.emplace_back("parameters", std::to_string(loaded.parameters.size()) + " bytes of text");
}

}  // namespace

datasets::Inspection inspect_map_file(const std::filesystem::path& path) {
  const LoadedMap loaded = open_map(path, {.recover = true, .scans = false});
  const SlamMap& map = loaded.map;
  datasets::Inspection result{.kind = "map file", .facts = {}, .warnings = losses(loaded)};
  result.facts.emplace_back("sessions", std::to_string(map.sessions.size()));
  for (const Session& session : map.sessions)
    result.facts.emplace_back("session " + std::to_string(session.id.value), session_words(map, session));
  for (const Session& session : map.sessions) add_health(map, session, result);
  result.facts.emplace_back("keyframes", std::to_string(map.keyframes.size()));
  const auto fixes = std::ranges::count_if(map.keyframes, [](const Keyframe& k) { return k.gnss.has_value(); });
  result.facts.emplace_back("gnss fixes", std::to_string(fixes));
  const auto measured =
      std::ranges::count_if(map.frames, [](const FrameRecord& f) { return f.delta_velocity.has_value(); });
  result.facts.emplace_back("frames with acceleration", std::to_string(measured));
  add_closures(map, result);
  add_joins(map, result);
  add_file(loaded, result);
  if (loaded.report.unknown_chunks > 0)
    result.warnings.push_back(std::to_string(loaded.report.unknown_chunks) + " parts that this version does not know");
  if (loaded.report.newer_fields)
    result.warnings.emplace_back("records have fields that this version does not know: rewriting would lose them");
  return result;
}

void print_closures(const SlamMap& map) {
  const std::vector<support::ClosureAccount> accounts = support::closure_accounts(map);
  std::size_t widest = 0;
  for (const support::ClosureAccount& one : accounts) widest = std::max(widest, one.tried.size());
  std::printf("%7s  %-7s  %-9s  %7s  %7s  %7s  %9s  %-*s  %s\n", "closure", "kind", "sessions", "from", "to", "inliers",
              "error m^2", static_cast<int>(widest), "tried because", "outcome");
  for (const support::ClosureAccount& one : accounts) {
    const LoopClosure& closure = *one.closure;
    const std::string number = one.number < 0 ? "-" : std::to_string(one.number);
    const std::string sessions = std::to_string(one.from.value) + " " + std::to_string(one.to.value);
    std::printf("%7s  %-7s  %-9s  %7d  %7d  %6.0f%%  %9.3g  %-*s  %s\n", number.c_str(),
                support::name_of(closure.kind).c_str(), sessions.c_str(), closure.from.value, closure.to.value,
                100 * closure.inlier_ratio, closure.mean_squared_error, static_cast<int>(widest), one.tried.c_str(),
                one.outcome.c_str());
  }
}

nlohmann::ordered_json closures_json(const SlamMap& map) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const support::ClosureAccount& one : support::closure_accounts(map)) {
    const LoopClosure& closure = *one.closure;
    nlohmann::ordered_json entry{{"number", nullptr},
                                 {"kind", support::name_of(closure.kind)},
                                 {"from", closure.from.value},
                                 {"to", closure.to.value},
                                 {"from_session", one.from.value},
                                 {"to_session", one.to.value},
                                 {"tried", one.tried},
                                 {"outcome", one.outcome},
                                 {"verdict", support::name_of(closure.verdict)},
                                 {"cause", nullptr},
                                 {"inlier_ratio", closure.inlier_ratio},
                                 {"mean_squared_error_m2", closure.mean_squared_error}};
    if (one.number >= 0) entry["number"] = one.number;
    if (closure.cause >= 0) entry["cause"] = closure.cause;
    const Eigen::Vector3d& t = closure.T_from_to.translation();
    const auto& q = closure.T_from_to.rotation().quaternion();
    entry["T_from_to"] = {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()};
    list.push_back(std::move(entry));
  }
  return list;
}

}  // namespace chainslam::mapper
