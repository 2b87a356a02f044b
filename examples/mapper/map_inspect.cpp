#include "map_inspect.hpp"

#include <algorithm>
#include <cstdio>
#include <map>
#include <string>

#include "chainslam/core/printable.hpp"
#include "map_export.hpp"
#include "map_file.hpp"
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
  const support::SessionHealth health = support::health_of(support::frames_of(map, session.id));
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

void print_closures_of(const std::filesystem::path& path) {
  const LoadedMap loaded = open_map(path, {.recover = true, .scans = false});
  std::printf("number,from,to,kind,verdict,cause,mean_squared_error_m2,inlier_ratio,x,y,z,qx,qy,qz,qw\n");
  for (const auto* closures : {&loaded.map.closures, &loaded.map.refusals}) {
    for (std::size_t i = 0; i < closures->size(); ++i) {
      const LoopClosure& closure = (*closures)[i];
      const Eigen::Vector3d& t = closure.T_from_to.translation();
      const auto& q = closure.T_from_to.rotation().quaternion();
      std::printf("%s,%d,%d,%s,%s,%d,%.6g,%.4f,%.9g,%.9g,%.9g,%.12g,%.12g,%.12g,%.12g\n",
                  closures == &loaded.map.closures ? std::to_string(i).c_str() : "", closure.from.value,
                  closure.to.value, support::name_of(closure.kind).c_str(), support::name_of(closure.verdict).c_str(),
                  closure.cause, closure.mean_squared_error, closure.inlier_ratio, t.x(), t.y(), t.z(), q.x(), q.y(),
                  q.z(), q.w());
    }
  }
}

}  // namespace chainslam::mapper
