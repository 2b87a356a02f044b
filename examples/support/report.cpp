#include "support/report.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <iterator>
#include <span>
#include <stdexcept>

#include "chainslam/core/error.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/io/file_system.hpp"
#include "support/encoding.hpp"
#include "support/map_picture.hpp"
#include "support/plot.hpp"
#include "support/report_assets.hpp"
#include "support/report_view.hpp"

namespace chainslam::support {
namespace {

std::string fixed(double value, int decimals) {
  if (!is_finite(value)) return "–";
  char buffer[400];
  return {buffer, std::to_chars(buffer, std::end(buffer), value, std::chars_format::fixed, decimals).ptr};
}

std::string hex_color(std::uint32_t color) {
  std::string text = "#000000";
  for (std::size_t i = 0; i < 6; ++i) text[6 - i] = "0123456789abcdef"[color >> (4 * i) & 15];
  return text;
}

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

void require_consistent(const ReportData& data) {
  Index keyframes = 0;
  for (const ReportSession& session : data.sessions) {
    const std::size_t count = session.optimised.size();
    for (const std::size_t size : {session.times.size(), session.odometry.size(), session.truth.size()})
      if (size != 0 && size != count)
        throw std::invalid_argument("report: session '" + session.name + "' has columns of different lengths");
    keyframes += to_index(count, "keyframes of a session");
  }
  for (const ReportClosure& closure : data.closures)
    if (std::min(closure.from, closure.to) < 0 || std::max(closure.from, closure.to) >= keyframes)
      throw std::invalid_argument("report: a closure names keyframe " +
                                  std::to_string(std::max(closure.from, closure.to)) + " of " +
                                  std::to_string(keyframes));
  if (!data.point_sessions.empty() && data.point_sessions.size() != data.points.size())
    throw std::invalid_argument("report: point_sessions and points differ in length");
}

std::string read_script(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (!stream || text.empty())
    throw_input_error(path.string(), "", "no three.js there, which the report's 3-D view needs",
                      "install Debian's libjs-three, or name the folder's three.min.js of release 111");
  for (const std::string_view end : {"</script", "<!--"})
    if (text.find(end) != std::string::npos)
      throw_input_error(path.string(), "", "'" + std::string(end) + "' in it, which would end the page's script",
                        "take the file three.min.js of release 111");
  return text;
}

std::string session_class(std::size_t session) { return "s" + std::to_string(session % 8); }

/// Style that gives each session and each kind of closure its colour.
std::string color_rules() {
  std::string rules;
  for (std::size_t i = 0; i < 8; ++i)
    rules += "." + session_class(i) + " { --c: " + hex_color(session_color(i)) + "; }\n";
  for (const ClosureKind kind : closure_kinds)
    rules += "." + name_of(kind) + " { --c: " + hex_color(closure_color(kind)) + "; }\n";
  for (std::size_t i = 0; i < 8; ++i) rules += ".plot .lines ." + session_class(i) + " { stroke: var(--c); }\n";
  return rules;
}

Index count_kind(const ReportData& data, ClosureKind kind) {
  return static_cast<Index>(std::ranges::count(data.closures, kind, &ReportClosure::kind));
}

bool has_odometry(const ReportData& data) {
  return std::ranges::any_of(data.sessions, [](const ReportSession& session) { return !session.odometry.empty(); });
}

bool has_truth(const ReportData& data) {
  return std::ranges::any_of(data.sessions, [](const ReportSession& session) { return !session.truth.empty(); });
}

std::string header(const ReportData& data) {
  std::string html = "<header><p class=\"kicker\">Mapping report</p><h1>" + escape_html(data.title) + "</h1>";
  if (!data.subtitle.empty()) html += "<p>" + escape_html(data.subtitle) + "</p>";
  html += "</header>\n";
  if (!data.figures.empty()) {
    html += "<dl class=\"figures\">";
    for (const ReportFigure& figure : data.figures) {
      html +=
          "<div class=\"figure\"><dt>" + escape_html(figure.label) + "</dt><dd>" + escape_html(figure.value) + "</dd>";
      if (!figure.note.empty()) html += "<dd class=\"note\">" + escape_html(figure.note) + "</dd>";
      html += "</div>";
    }
    html += "</dl>\n";
  }
  if (!data.warnings.empty()) {
    html += "<ul class=\"warnings\">";
    for (const std::string& warning : data.warnings) html += "<li>" + escape_html(warning) + "</li>";
    html += "</ul>\n";
  }
  return html;
}

std::string layer_box(const std::string& layer, const std::string& label, const std::string& swatch, bool checked) {
  return "<label><input type=\"checkbox\" data-layer=\"" + layer + "\"" + (checked ? " checked" : "") + ">" +
         (swatch.empty() ? "" : "<i class=\"swatch " + swatch + "\"></i>") + escape_html(label) + "</label>";
}

std::string view_section(const ReportData& data) {
  std::string layers = data.points.empty() ? "" : layer_box("points", "Points", "", true);
  layers += layer_box("optimised", "Trajectories", "s0", true);
  if (has_odometry(data)) layers += layer_box("odometry", "Odometry alone", "odometry s0", false);
  if (has_truth(data)) layers += layer_box("truth", "Truth", "truth", true);
  for (const ClosureKind kind : closure_kinds)
    if (count_kind(data, kind) > 0)
      layers += layer_box(name_of(kind), "Closures, " + name_of(kind), name_of(kind), true);
  const bool has_sessions = data.sessions.size() > 1 && !data.point_sessions.empty();
  return R"(<section class="interactive"><h2>Map in 3-D</h2>
<p>Closures tie places seen again; chained ones follow from a direct one through what the map already ties together.</p>
<div class="panel"><div class="viewer"><canvas id="view" tabindex="0" aria-label="Map in 3-D"></canvas><div class="tip"></div>
<p class="no-webgl">This browser gives no WebGL: the map from above, below, shows the same.</p></div>
<div class="controls">)" +
         layers + R"(<span class="space"></span>
<label>Colour by <select id="color-mode"><option value="0">height</option>)" +
         (has_sessions ? R"(<option value="1">session</option>)" : "") +
         R"(<option value="2">nothing</option></select></label>
<label>Point size <input type="range" id="point-size" min="-1.2" max="1.2" step="0.05" value="0"></label>
<span><button type="button" id="view-above">Above</button> <button type="button" id="view-slant">Slant</button>
<button type="button" id="view-side">Side</button></span>
<p>Drag to turn, right button or Shift to move, wheel to zoom; double click goes to a keyframe.</p></div></div></section>
)";
}

/// The map from above as an SVG element over a picture of its points.
class PictureDrawing {
 public:
  explicit PictureDrawing(const ReportData& data)
      : data_(data), view_(view_of(data)), units_per_metre_(1100.0 / std::max(view_.width(), view_.height())) {}

  [[nodiscard]] std::string svg() const {
    const std::string size =
        fixed(view_.width() * units_per_metre_, 1) + " " + fixed(view_.height() * units_per_metre_, 1);
    std::string html = "<svg viewBox=\"0 0 " + size + "\" role=\"img\" aria-label=\"Map from above\">" + image();
    for (std::size_t s = 0; s < data_.sessions.size(); ++s)
      html += path("truth", data_.sessions[s].truth) + path("odometry " + session_class(s), data_.sessions[s].odometry);
    for (const ClosureKind kind : {ClosureKind::chained, ClosureKind::direct, ClosureKind::merge})
      html += closures(kind);
    for (std::size_t s = 0; s < data_.sessions.size(); ++s) html += path(session_class(s), data_.sessions[s].optimised);
    return html + scale_bar() + "</svg>";
  }

 private:
  [[nodiscard]] std::string x(double value) const { return fixed((value - view_.min_x) * units_per_metre_, 1); }
  [[nodiscard]] std::string y(double value) const { return fixed((view_.max_y - value) * units_per_metre_, 1); }

  [[nodiscard]] std::string image() const {
    if (data_.points.empty()) return "";
    const MapRaster raster = rasterize(data_, view_, 1400);
    std::vector<std::uint8_t> samples;
    for (const std::uint8_t opacity : raster.opacity) samples.insert(samples.end(), {0x38, opacity});
    const std::string png = png_bytes(samples, raster.width, raster.height, 2);
    return "<image width=\"" + fixed(view_.width() * units_per_metre_, 1) + "\" height=\"" +
           fixed(view_.height() * units_per_metre_, 1) +
           "\" preserveAspectRatio=\"none\" href=\"data:image/png;base64," + base64(std::as_bytes(std::span(png))) +
           "\"/>";
  }

  [[nodiscard]] std::string path(const std::string& classes, const std::vector<Eigen::Vector3d>& positions) const {
    if (positions.size() < 2) return "";
    std::string points;
    for (const Eigen::Vector3d& p : positions)
      if (is_finite(p)) points += (points.empty() ? "" : " ") + x(p.x()) + "," + y(p.y());
    return "<polyline class=\"path " + classes + "\" points=\"" + points + "\"/>";
  }

  [[nodiscard]] std::string closures(ClosureKind kind) const {
    std::vector<Eigen::Vector3d> keyframes;
    for (const ReportSession& session : data_.sessions)
      keyframes.insert(keyframes.end(), session.optimised.begin(), session.optimised.end());
    std::string lines;
    for (const ReportClosure& closure : data_.closures) {
      if (closure.kind != kind) continue;
      const Eigen::Vector3d& from = keyframes[static_cast<std::size_t>(closure.from)];
      const Eigen::Vector3d& to = keyframes[static_cast<std::size_t>(closure.to)];
      if (!is_finite(from) || !is_finite(to)) continue;
      lines += "M" + x(from.x()) + " " + y(from.y()) + "L" + x(to.x()) + " " + y(to.y());
    }
    return lines.empty() ? "" : "<path class=\"closures " + name_of(kind) + "\" d=\"" + lines + "\"/>";
  }

  [[nodiscard]] std::string scale_bar() const {
    const double metres = scale_bar_length(view_.width());
    const double left = 18.0, bottom = view_.height() * units_per_metre_ - 18.0, length = metres * units_per_metre_;
    return "<path class=\"bar\" d=\"M" + fixed(left, 1) + " " + fixed(bottom - 6, 1) + "v6h" + fixed(length, 1) +
           "v-6\"/><text x=\"" + fixed(left + 6, 1) + "\" y=\"" + fixed(bottom - 7, 1) + "\">" +
           (metres >= 1000 ? fixed(metres / 1000, 0) + " km" : fixed(metres, 0) + " m") + "</text>";
  }

  const ReportData& data_;
  MapView view_;
  double units_per_metre_;
};

std::string legend_entry(const std::string& swatch, const std::string& label) {
  return "<span><i class=\"swatch " + swatch + "\"></i>" + escape_html(label) + "</span>";
}

std::string above_section(const ReportData& data) {
  std::string legend;
  for (std::size_t s = 0; s < data.sessions.size(); ++s)
    legend += legend_entry(session_class(s), data.sessions[s].name);
  if (has_odometry(data)) legend += legend_entry("odometry", "odometry alone");
  if (has_truth(data)) legend += legend_entry("truth", "truth");
  for (const ClosureKind kind : closure_kinds)
    if (count_kind(data, kind) > 0) legend += legend_entry(name_of(kind), "closures, " + name_of(kind));
  return "<section><h2>Map from above</h2><p>Walls are strong, ground is faint.</p><div class=\"panel above\">" +
         PictureDrawing(data).svg() + "<div class=\"legend\">" + legend + "</div></div></section>\n";
}

std::string plot_section(const std::vector<ReportPlot>& plots, const std::vector<PlotDrawing>& drawings) {
  std::string html = "<section><h2>Over time</h2>";
  for (std::size_t i = 0; i < plots.size(); ++i) {
    html += "<h3>" + escape_html(plots[i].title) + "</h3><div class=\"panel plot-panel\">" + drawings[i].svg +
            "<div class=\"legend\">";
    for (std::size_t j = 0; j < plots[i].series.size(); ++j)
      html += legend_entry(color_class(plots[i], j) + (plots[i].series[j].dashed ? " odometry" : ""),
                           plots[i].series[j].name);
    html += "</div><div class=\"tip\"></div></div>";
  }
  return html + "</section>\n";
}

/// A table; columns after the first are numbers.
class Table {
 public:
  Table(const std::string& title, const std::vector<std::string>& heads) {
    html_ = "<div><h3>" + escape_html(title) + "</h3><div class=\"panel\"><table>";
    if (!heads.empty()) html_ += "<thead>" + row(heads, "th") + "</thead>";
    html_ += "<tbody>";
  }

  void add(const std::vector<std::string>& cells) { html_ += row(cells, "td"); }
  [[nodiscard]] std::string html() const { return html_ + "</tbody></table></div></div>"; }

 private:
  static std::string row(const std::vector<std::string>& cells, const std::string& tag) {
    std::string html = "<tr>";
    for (std::size_t i = 0; i < cells.size(); ++i)
      html += i == 0
                  ? "<th scope=\"" + std::string(tag == "th" ? "col" : "row") + "\">" + escape_html(cells[i]) + "</th>"
                  : "<" + tag + " class=\"n\">" + escape_html(cells[i]) + "</" + tag + ">";
    return html + "</tr>";
  }

  std::string html_;
};

std::string sessions_table(const ReportData& data) {
  Table table("Sessions", {"Session", "Keyframes", "Path", "Duration"});
  for (const ReportSession& session : data.sessions)
    table.add({session.name, std::to_string(session.optimised.size()), fixed(length_of(session.optimised), 0) + " m",
               session.times.empty() ? "–" : duration_text(session.times.back() - session.times.front())});
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

std::string refusals_table(const ReportData& data) {
  Index total = 0;
  for (const ReportRefusal& refusal : data.refusals) total += refusal.count;
  Table table("Candidates refused", {"Reason", "Count", "Share"});
  for (const ReportRefusal& refusal : data.refusals)
    table.add({refusal.reason, std::to_string(refusal.count),
               fixed(100.0 * refusal.count / std::max<Index>(1, total), 0) + " %"});
  return table.html();
}

std::string stages_table(const ReportData& data) {
  Table table("Time by stage", {"Stage", "Steps", "Total", "Median", "99 %", "Longest"});
  for (const StageTime& stage : data.stages)
    table.add({stage.stage, std::to_string(stage.count), duration_text(stage.total), time_text(stage.p50),
               time_text(stage.p99), time_text(stage.max)});
  return table.html();
}

std::string tables_section(const ReportData& data) {
  std::string html = "<section><h2>Figures</h2>";
  if (!data.stages.empty()) html += stages_table(data);
  html += "<div class=\"columns\">";
  if (!data.summary.empty()) {
    Table table("Summary", {});
    for (const auto& [what, how_much] : data.summary) table.add({what, how_much});
    html += table.html();
  }
  if (!data.sessions.empty()) html += sessions_table(data);
  if (!data.closures.empty()) html += closures_table(data);
  if (!data.refusals.empty()) html += refusals_table(data);
  return html + "</div></section>\n";
}

std::string policy_hash(std::string_view text) {
  const auto digest = sha256(text);
  return "'sha256-" + base64(std::as_bytes(std::span(digest))) + "'";
}

}  // namespace

std::string report_html(const ReportData& data, const ReportOptions& options) {
  require_consistent(data);
  const std::string three_js = read_script(options.three_js);
  std::vector<PlotDrawing> drawings;
  for (const ReportPlot& plot : data.plots) drawings.push_back(draw_plot(plot, drawings.size()));

  const std::string style = report_style + color_rules();
  const std::string script = report_script;
  std::string html =
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; script-src " +
      policy_hash(three_js) + " " + policy_hash(script) + "; style-src " + policy_hash(style) +
      "; img-src data:; base-uri 'none'; form-action 'none'\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<link rel=\"icon\" href=\"data:,\">\n<title>Mapping report: " +
      escape_html(data.title) + "</title>\n<style>" + style + "</style>\n</head>\n<body>\n<main>\n";
  html += header(data);
  if (!data.sessions.empty() || !data.points.empty()) html += view_section(data) + above_section(data);
  if (!data.plots.empty()) html += plot_section(data.plots, drawings);
  html += tables_section(data);
  html +=
      "<footer>Made by chainslam. This page holds all its data and asks no network for anything.</footer>\n</main>\n";
  html += view_elements(data, options.max_points, drawings);
  html += "<script>" + three_js + "</script>\n<script>" + script + "</script>\n</body>\n</html>\n";
  return html;
}

void write_report(const std::filesystem::path& path, const ReportData& data, const ReportOptions& options) {
  const std::string html = report_html(data, options);
  AtomicFile file(path);
  file.write(html);
  file.commit();
}

}  // namespace chainslam::support
