#include <algorithm>
#include <cmath>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "support/encoding.hpp"
#include "support/report_parts.hpp"

namespace chainslam::support {
namespace {

std::string duration_text(double seconds) {
  if (seconds < 60) return fixed(seconds, 1) + " s";
  const auto whole = static_cast<long long>(std::llround(seconds));
  if (whole < 3600) return std::to_string(whole / 60) + " min " + std::to_string(whole % 60) + " s";
  return std::to_string(whole / 3600) + " h " + std::to_string(whole % 3600 / 60) + " min";
}

std::string time_text(double seconds) {
  return seconds < 1.0 ? fixed(1e3 * seconds, seconds < 0.1 ? 2 : 1) + " ms" : fixed(seconds, 2) + " s";
}

double length_of(const std::vector<Eigen::Vector3d>& path) {
  double length = 0.0;
  for (std::size_t i = 1; i < path.size(); ++i) length += (path[i] - path[i - 1]).norm();
  return length;
}

/// A table; columns after the first are numbers, or words if any of their cells is long.
class Table {
 public:
  Table(std::string title, std::vector<std::string> heads) : title_(std::move(title)), heads_(std::move(heads)) {}

  void add(std::vector<std::string> cells) { rows_.push_back(std::move(cells)); }

  [[nodiscard]] std::string html() const {
    std::string html = "<div><h3>" + escape_html(title_) + "</h3><div class=\"panel scroll\"><table>";
    if (!heads_.empty()) html += "<thead>" + row(heads_, "th") + "</thead>";
    html += "<tbody>";
    for (const std::vector<std::string>& cells : rows_) html += row(cells, "td");
    return html + "</tbody></table></div></div>";
  }

 private:
  [[nodiscard]] bool has_words(std::size_t column) const {
    constexpr std::size_t longest_number = 24;
    return std::ranges::any_of(rows_, [column](const std::vector<std::string>& cells) {
      return column < cells.size() && cells[column].size() > longest_number;
    });
  }

  [[nodiscard]] std::string row(const std::vector<std::string>& cells, const std::string& tag) const {
    std::string html = "<tr>";
    for (std::size_t i = 0; i < cells.size(); ++i) {
      const std::string opened = i == 0 ? "th scope=\"" + std::string(tag == "th" ? "col" : "row")
                                        : tag + " class=\"" + (has_words(i) ? "words" : "n");
      html += "<" + opened + "\">" + escape_html(cells[i]) + (i == 0 ? "</th>" : "</" + tag + ">");
    }
    return html + "</tr>";
  }

  std::string title_;
  std::vector<std::string> heads_;
  std::vector<std::vector<std::string>> rows_;
};

std::string sessions_table(const ReportData& data) {
  const bool several = data.sessions.size() > 1;
  std::vector<std::string> heads{"Session", "Keyframes", "Path", "Duration"};
  if (several) heads.insert(heads.end(), {"From", "Frame of"});
  Table table("Sessions", heads);
  for (const ReportSession& session : data.sessions) {
    std::vector<std::string> row{session.name, std::to_string(session.optimized.size()),
                                 fixed(length_of(session.optimized), 1) + " m",
                                 session.times.empty() ? "–" : duration_text(session.times.back())};
    if (several) {
      row.emplace_back(session.loaded ? "saved map" : "this run");
      row.push_back(data.sessions[static_cast<std::size_t>(session.frame)].name);
    }
    table.add(row);
  }
  return table.html();
}

std::string closures_table(const ReportData& data) {
  Table table("Closures accepted", {"Kind", "Count", "Error RMS, median", "Error RMS, largest"});
  for (const ClosureKind kind : closure_kinds) {
    std::vector<double> errors;
    for (const ReportClosure& closure : data.closures)
      if (closure.kind == kind) errors.push_back(std::sqrt(std::max(0.0, closure.score)));
    if (errors.empty()) continue;
    table.add({name_of(kind), std::to_string(errors.size()), fixed(percentile(errors, 0.5), 3) + " m",
               fixed(*std::ranges::max_element(errors), 3) + " m"});
  }
  return table.html();
}

/// Reasons down, kinds across.
std::string refusals_table(const ReportData& data) {
  std::vector<ClosureKind> kinds;
  for (const ClosureKind kind : closure_kinds)
    if (std::ranges::any_of(data.refusals, [kind](const ReportRefusal& refusal) { return refusal.kind == kind; }))
      kinds.push_back(kind);
  std::vector<std::string> heads{"Reason"};
  for (const ClosureKind kind : kinds) heads.push_back(name_of(kind));
  if (kinds.size() > 1) heads.emplace_back("all");
  std::map<std::string, std::map<ClosureKind, Index>> by_reason;
  for (const ReportRefusal& refusal : data.refusals) by_reason[refusal.reason][refusal.kind] += refusal.count;
  std::map<ClosureKind, Index> totals;
  Table table("Candidates refused", heads);
  const auto add = [&](const std::string& reason, const std::map<ClosureKind, Index>& counts) {
    std::vector<std::string> row{reason};
    Index sum = 0;
    for (const ClosureKind kind : kinds) {
      const auto found = counts.find(kind);
      row.push_back(found == counts.end() ? "–" : std::to_string(found->second));
      if (found != counts.end()) sum += found->second;
    }
    if (kinds.size() > 1) row.push_back(std::to_string(sum));
    table.add(row);
  };
  for (const auto& [reason, counts] : by_reason) {
    add(reason, counts);
    for (const auto& [kind, count] : counts) totals[kind] += count;
  }
  if (by_reason.size() > 1) add("all reasons", totals);
  return table.html();
}

/// The largest components one by one, the others in one row.
std::string components_table(const ReportData& data) {
  constexpr std::size_t shown = 10;
  Table table("Components of the adjacency graph", {"Component", "Keyframes", "Closures", "Sessions connected"});
  for (std::size_t i = 0; i < std::min(shown, data.components.size()); ++i) {
    const ReportComponent& component = data.components[i];
    std::string names;
    for (const Index session : component.sessions)
      names += (names.empty() ? "" : ", ") + data.sessions[static_cast<std::size_t>(session)].name;
    table.add(
        {std::to_string(i + 1), std::to_string(component.keyframes.size()), std::to_string(component.closures), names});
  }
  if (data.components.size() > shown) {
    std::size_t keyframes = 0;
    Index closures = 0;
    for (std::size_t i = shown; i < data.components.size(); ++i) {
      keyframes += data.components[i].keyframes.size();
      closures += data.components[i].closures;
    }
    table.add({std::to_string(data.components.size() - shown) + " more", std::to_string(keyframes),
               std::to_string(closures), "–"});
  }
  return table.html();
}

std::string stages_table(const ReportData& data) {
  Table table("Time by stage", {"Stage", "Steps", "Total", "Median", "99 %", "Longest"});
  for (const StageTime& stage : data.stages)
    table.add({stage.stage, std::to_string(stage.count), duration_text(stage.total), time_text(stage.p50),
               time_text(stage.p99), time_text(stage.max)});
  return table.html();
}

}  // namespace

std::string tables_section(const ReportData& data) {
  std::string html = "<section><h2>Figures</h2>";
  if (!data.sessions.empty()) html += sessions_table(data);
  for (const ReportTable& given : data.tables) {
    Table table(given.title, given.heads);
    for (const std::vector<std::string>& row : given.rows) table.add(row);
    html += table.html();
  }
  if (!data.stages.empty()) html += stages_table(data);
  html += "<div class=\"columns\">";
  if (!data.closures.empty()) html += closures_table(data);
  if (!data.refusals.empty()) html += refusals_table(data);
  if (!data.components.empty()) html += components_table(data);
  if (!data.summary.empty()) {
    Table table("Summary", {});
    for (const auto& [what, how_much] : data.summary) table.add({what, how_much});
    html += table.html();
  }
  return html + "</div></section>\n";
}

}  // namespace chainslam::support
