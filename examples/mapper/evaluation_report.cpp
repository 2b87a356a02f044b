#include "evaluation_report.hpp"

#include <array>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numbers>

#include "chainslam/core/error.hpp"

namespace chainslam::mapper {

namespace {

constexpr double degrees_per_radian = 180 / std::numbers::pi;

/// Appends as printf would print.
[[gnu::format(printf, 2, 3)]] void append(std::string& text, const char* format, ...) {
  std::array<char, 1024> line{};
  std::va_list arguments;
  va_start(arguments, format);
  std::vsnprintf(line.data(), line.size(), format, arguments);
  va_end(arguments);
  text += line.data();
}

ErrorStatistics in_degrees(ErrorStatistics statistics) {
  for (double* value :
       {&statistics.rmse, &statistics.mean, &statistics.median, &statistics.std, &statistics.min, &statistics.max})
    *value *= degrees_per_radian;
  statistics.sse *= degrees_per_radian * degrees_per_radian;
  return statistics;
}

void append_file(std::string& text, const char* role, const TrajectoryFile& file) {
  append(text, "%-11s%s (%s, %zu poses, %.1f m", role, printable(file.path.native()).c_str(), format_name(file.format),
         file.trajectory.size(), path_length(file.trajectory));
  if (file.trajectory.has_times())
    append(text, ", %.1f s", to_seconds(file.trajectory.times.back() - file.trajectory.times.front()));
  if (file.repeated > 0) append(text, "; %d with a repeated stamp left out", file.repeated);
  if (file.not_finite > 0) append(text, "; %d rows with NaN left out", file.not_finite);
  text += ")\n";
}

/// "312 of the reference left over: 200 before, 100 after, 12 with nothing near".
void append_left_over(std::string& text, const char* role, const char* other, const UnmatchedCounts& counts) {
  if (counts.total() == 0) return;
  append(text, "           %d of the %s left over:", counts.total(), role);
  const char* separator = " ";
  const auto add = [&](Index count, const char* reason, const char* object) {
    if (count == 0) return;
    append(text, "%s%d %s%s", separator, count, reason, object);
    separator = ", ";
  };
  add(counts.before, "before the ", other);
  add(counts.after, "after the ", other);
  add(counts.too_far, "with nothing near enough", "");
  add(counts.taken, "beside a nearer one", "");
  text += '\n';
}

void append_row(std::string& text, const char* name, const ErrorStatistics& s) {
  append(text, "%-16s %10.6f %10.6f %10.6f %10.6f %10.6f %10.6f\n", name, s.rmse, s.mean, s.median, s.std, s.min,
         s.max);
}

/// KITTI's figures: over all segments, and for each length.
void append_kitti(std::string& text, const KittiErrors& kitti, Index step) {
  if (kitti.status == EvaluationStatus::path_too_short) {
    append(text, "\nKITTI: no path is longer than %.0f m, the shortest segment\n", kitti_lengths.front());
    return;
  }
  append(text, "\n%-16s %10s %10s %10s %10s\n", "KITTI", "segments", "%", "deg/100 m", "deg/m");
  const auto row = [&](const char* name, std::size_t segments, double translation, double rotation) {
    append(text, "%-16s %10zu %10.4f %10.4f %10.6f\n", name, segments, 100 * translation,
           100 * degrees_per_radian * rotation, degrees_per_radian * rotation);
  };
  row("all", kitti.segments.size(), kitti.translation, kitti.rotation);
  for (const KittiLengthErrors& each : kitti.lengths) {
    if (each.segments == 0) continue;
    const std::string name = std::to_string(std::lround(each.length)) + " m";
    row(name.c_str(), static_cast<std::size_t>(each.segments), each.translation, each.rotation);
  }
  append(text, "segments start every %d poses\n", step);
}

/// Null if there were no errors to take them of.
nlohmann::json to_json(const ErrorStatistics& s) {
  if (s.count == 0) return nullptr;
  return {{"rmse", s.rmse}, {"mean", s.mean}, {"median", s.median}, {"std", s.std},
          {"min", s.min},   {"max", s.max},   {"sse", s.sse}};
}

nlohmann::json to_json(const KittiErrors& kitti, Index step) {
  if (kitti.status != EvaluationStatus::evaluated)
    return {{"status", "path_too_short"}, {"step", step}, {"segments", 0}};
  const auto figures = [](auto segments, double translation, double rotation) {
    return nlohmann::json{{"segments", segments},
                          {"translation_percent", 100 * translation},
                          {"rotation_deg_per_100m", 100 * degrees_per_radian * rotation},
                          {"rotation_deg_per_m", degrees_per_radian * rotation}};
  };
  nlohmann::json document = figures(kitti.segments.size(), kitti.translation, kitti.rotation);
  document["status"] = "evaluated";
  document["step"] = step;
  document["lengths"] = nlohmann::json::array();
  for (const KittiLengthErrors& each : kitti.lengths) {
    if (each.segments == 0) continue;
    document["lengths"].push_back(figures(each.segments, each.translation, each.rotation));
    document["lengths"].back()["length"] = each.length;
  }
  return document;
}

nlohmann::json to_json(const UnmatchedCounts& counts) {
  return {{"before", counts.before}, {"after", counts.after}, {"too_far", counts.too_far}, {"taken", counts.taken}};
}

nlohmann::json to_json(const TrajectoryFile& file) {
  return {{"file", file.path.string()},      {"format", format_name(file.format)},
          {"poses", file.trajectory.size()}, {"path_length", path_length(file.trajectory)},
          {"repeated", file.repeated},       {"not_finite", file.not_finite}};
}

}  // namespace

const char* alignment_name(Alignment alignment) {
  constexpr std::array<const char*, 4> names = {"none", "origin", "se3", "sim3"};
  return names[static_cast<std::size_t>(alignment)];
}

std::string evaluation_table(const Evaluation& evaluation) {
  std::string text;
  for (const EvaluatedSession& session : evaluation.sessions) {
    append_file(text, "reference", session.reference);
    append_file(text, "estimate", session.estimate);
    append(text, "matched    %d by %s", session.matched, session.association.c_str());
    if (session.association == "time") append(text, ", at most %.3g s apart", session.largest_difference);
    text += '\n';
    append_left_over(text, "reference", "estimate", session.reference_left_over);
    append_left_over(text, "estimate", "reference", session.estimate_left_over);
  }
  append(text, "aligned    %s", alignment_name(evaluation.alignment.align));
  if (evaluation.sessions.size() > 1) append(text, ", %zu sessions together", evaluation.sessions.size());
  if (evaluation.alignment.project_xy) text += ", poses laid flat on xy";
  if (evaluation.alignment.align == Alignment::sim3)
    append(text, ", scale %.6f", evaluation.ape.S_reference_estimate.scale());
  append(text, "\n\n%-16s %10s %10s %10s %10s %10s %10s\n", "", "rmse", "mean", "median", "std", "min", "max");
  append_row(text, "APE [m]", evaluation.ape.translation);
  append_row(text, "APE [deg]", in_degrees(evaluation.ape.rotation));
  if (evaluation.rpe.translation.count == 0) {
    append(text, "RPE %s: no two poses are that far apart\n", evaluation.delta.c_str());
  } else {
    append_row(text, ("RPE " + evaluation.delta + " [m]").c_str(), evaluation.rpe.translation);
    append_row(text, ("RPE " + evaluation.delta + " [deg]").c_str(), in_degrees(evaluation.rpe.rotation));
    append(text, "\nAPE over %d poses, RPE over %d %s\n", evaluation.ape.translation.count,
           evaluation.rpe.translation.count,
           evaluation.rpe_options.pairs == PairChoice::all ? "pairs (all)" : "consecutive pairs");
  }
  append_kitti(text, evaluation.kitti, evaluation.kitti_options.step);
  return text;
}

std::string evaluation_json(const Evaluation& evaluation) {
  nlohmann::json sessions = nlohmann::json::array();
  for (const EvaluatedSession& session : evaluation.sessions)
    sessions.push_back({{"reference", to_json(session.reference)},
                        {"estimate", to_json(session.estimate)},
                        {"association", session.association},
                        {"matched", session.matched},
                        {"largest_difference", session.largest_difference},
                        {"reference_left_over", to_json(session.reference_left_over)},
                        {"estimate_left_over", to_json(session.estimate_left_over)}});
  const Eigen::Matrix4d T = evaluation.ape.S_reference_estimate.rigid().matrix();
  std::vector<double> rows;
  for (int i = 0; i < 16; ++i) rows.push_back(T(i / 4, i % 4));
  const nlohmann::json document = {{"sessions", sessions},
                                   {"alignment",
                                    {{"method", alignment_name(evaluation.alignment.align)},
                                     {"project", evaluation.alignment.project_xy ? "xy" : "none"},
                                     {"scale", evaluation.ape.S_reference_estimate.scale()},
                                     {"T_reference_estimate", rows}}},
                                   {"ape",
                                    {{"count", evaluation.ape.translation.count},
                                     {"translation", to_json(evaluation.ape.translation)},
                                     {"rotation_deg", to_json(in_degrees(evaluation.ape.rotation))}}},
                                   {"rpe",
                                    {{"count", evaluation.rpe.translation.count},
                                     {"delta", evaluation.delta},
                                     {"pairs", evaluation.rpe_options.pairs == PairChoice::all ? "all" : "consecutive"},
                                     {"translation", to_json(evaluation.rpe.translation)},
                                     {"rotation_deg", to_json(in_degrees(evaluation.rpe.rotation))}}},
                                   {"kitti", to_json(evaluation.kitti, evaluation.kitti_options.step)}};
  return document.dump(2, ' ', true, nlohmann::ordered_json::error_handler_t::replace) + '\n';
}

}  // namespace chainslam::mapper
