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
#include "chainslam/core/types.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "support/encoding.hpp"
#include "support/map_picture.hpp"
#include "support/plot.hpp"
#include "support/report_assets.hpp"
#include "support/report_parts.hpp"
#include "support/report_view.hpp"

namespace chainslam::support {
namespace {

std::string hex_color(std::uint32_t color) {
  std::string text = "#000000";
  for (std::size_t i = 0; i < 6; ++i) text[6 - i] = "0123456789abcdef"[color >> (4 * i) & 15];
  return text;
}

void require_consistent(const ReportData& data) {
  Index keyframes = 0;
  for (const ReportSession& session : data.sessions) {
    const std::size_t count = session.optimized.size();
    for (const std::size_t size : {session.times.size(), session.odometry.size(), session.truth.size()})
      if (size != 0 && size != count)
        throw std::invalid_argument("report: session '" + session.name + "' has columns of different lengths");
    keyframes += to_index(count, "keyframes of a session");
    if (session.frame < 0 || static_cast<std::size_t>(session.frame) >= data.sessions.size())
      throw std::invalid_argument("report: session '" + session.name + "' lies in the frame of none");
  }
  for (const ReportClosure& closure : data.closures)
    if (std::min(closure.from, closure.to) < 0 || std::max(closure.from, closure.to) >= keyframes)
      throw std::invalid_argument("report: a closure names keyframe " +
                                  std::to_string(std::max(closure.from, closure.to)) + " of " +
                                  std::to_string(keyframes));
  const auto fits = [](const std::vector<Index>& numbers, std::size_t count) {
    return std::ranges::all_of(numbers, [count](Index i) { return i >= 0 && static_cast<std::size_t>(i) < count; });
  };
  for (const ReportComponent& component : data.components)
    if (component.keyframes.empty() || !fits(component.keyframes, static_cast<std::size_t>(keyframes)) ||
        !fits(component.sessions, data.sessions.size()))
      throw std::invalid_argument("report: a component is empty or names what is not there");
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

/// Style that gives each session and each kind of closure its colour.
std::string color_rules() {
  std::string rules;
  for (std::size_t i = 0; i < 8; ++i)
    rules += "." + session_class(i) + " { --c: " + hex_color(session_color(i)) + "; }\n";
  for (const ClosureKind kind : closure_kinds)
    rules += "." + name_of(kind) + " { --c: " + hex_color(closure_color(kind)) + "; }\n";
  constexpr std::array<std::uint32_t, 4> component_colors{0x99ddff, 0xffaabb, 0xdddd77,
                                                          0x66ccaa};  // Tol's light scheme
  for (std::size_t i = 0; i < component_colors.size(); ++i)
    rules += ".k" + std::to_string(i) + " { --c: " + hex_color(component_colors[i]) + "; }\n";
  for (std::size_t i = 0; i < 8; ++i) rules += ".plot .lines ." + session_class(i) + " { stroke: var(--c); }\n";
  return rules;
}

/// What a reader asks first.
std::string answers(const ReportData& data) {
  std::string rows;
  for (const auto& [question, answer] : data.answers)
    rows += "<div><dt>" + escape_html(question) + "</dt><dd>" + escape_html(answer) + "</dd></div>";
  if (!data.folder.empty()) {
    rows += "<div><dt>Files</dt><dd>in " + escape_html(data.folder);
    for (std::size_t i = 0; i < data.files.size(); ++i) {
      const std::string name = escape_html(data.files[i].name);
      rows += (i == 0 ? ": " : ", ") + ("<a href=\"" + name + "\">" + name + "</a>");
      if (!data.files[i].what.empty()) rows += " (" + escape_html(data.files[i].what) + ")";
    }
    rows += "</dd></div>";
  }
  return rows.empty() ? "" : "<dl class=\"answers\">" + rows + "</dl>";
}

std::string header(const ReportData& data) {
  std::string html = "<header><p class=\"kicker\">Mapping report</p><h1>" + escape_html(data.title) + "</h1>";
  if (!data.verdict.empty())
    html +=
        "<p class=\"verdict" + std::string(data.failed ? " failed" : "") + "\">" + escape_html(data.verdict) + "</p>";
  if (!data.subtitle.empty()) html += "<p>" + escape_html(data.subtitle) + "</p>";
  html += answers(data) + "</header>\n";
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
  const bool several = data.sessions.size() > 1;
  layers += layer_box("optimized", "Trajectories", several ? "" : "s0", true);
  if (has_odometry(data))
    layers += layer_box("odometry", "Odometry alone", several ? "odometry" : "odometry s0", false);
  if (has_truth(data)) layers += layer_box("truth", "Truth", "truth", true);
  for (const ClosureKind kind : closure_kinds)
    if (count_kind(data, kind) > 0)
      layers += layer_box(name_of(kind), "Closures, " + name_of(kind), name_of(kind), true);
  std::string sessions;
  for (std::size_t i = 0; several && i < data.sessions.size(); ++i)
    sessions += "<label><input type=\"checkbox\" data-session=\"" + std::to_string(i) +
                "\" checked><i class=\"swatch " + session_class(i) + "\"></i>" + escape_html(data.sessions[i].name) +
                "</label>";
  if (several) sessions = "<div class=\"sessions\">" + sessions + "</div>";
  const bool has_sessions = several && !data.point_sessions.empty();
  return R"(<section class="interactive"><h2>Map in 3-D</h2>
<p>Direct closures tie places seen again; chained ones follow from a direct one through what the map already ties
together; a merge joins a session to the map.</p>
<div class="panel"><div class="viewer"><canvas id="view" tabindex="0" aria-label="Map in 3-D"></canvas><div class="tip"></div>
<p class="no-webgl"><strong>No 3-D view: WebGL is not available in this browser.</strong><br>The map from above, below, shows the
same. For the 3-D view switch on hardware acceleration, or open the page in another browser.</p></div>
<div class="controls">)" +
         sessions + layers + R"(<span class="space"></span>
<label>Colour by <select id="color-mode">)" +
         (has_sessions ? R"(<option value="1">session</option>)" : "") +
         R"(<option value="0">height</option><option value="2">nothing</option></select></label>
<label>Point size <input type="range" id="point-size" min="-1.2" max="1.2" step="0.05" value="0"></label>
<span><button type="button" id="view-above">Above</button> <button type="button" id="view-side">Side</button>
<button type="button" id="view-reset">Reset view</button></span>
<p>Drag to turn, right button or Shift to move, wheel to zoom; double click goes to a keyframe.</p></div></div></section>
)";
}

std::string plot_section(const std::vector<ReportPlot>& plots, const std::vector<PlotDrawing>& drawings) {
  std::string html = "<section><h2>Over time</h2>";
  for (std::size_t i = 0; i < plots.size(); ++i) {
    html += "<h3>" + escape_html(plots[i].title) + "</h3><div class=\"panel plot-panel\">" + drawings[i].html +
            "<div class=\"legend\">";
    for (std::size_t j = 0; j < plots[i].series.size(); ++j)
      html += legend_entry(color_class(plots[i], j) + (plots[i].series[j].dashed ? " odometry" : ""),
                           plots[i].series[j].name);
    html += "</div><div class=\"tip\"></div></div>";
  }
  return html + "</section>\n";
}

std::string policy_hash(std::string_view text) {
  const auto digest = sha256(text);
  return "'sha256-" + base64(std::as_bytes(std::span(digest))) + "'";
}

}  // namespace

std::string fixed(double value, int decimals) {
  if (!is_finite(value)) return "–";
  char buffer[400];
  return {buffer, std::to_chars(buffer, std::end(buffer), value, std::chars_format::fixed, decimals).ptr};
}

std::string session_class(std::size_t session) { return "s" + std::to_string(session % 8); }

std::string legend_entry(const std::string& swatch, const std::string& label) {
  return "<span><i class=\"swatch " + swatch + "\"></i>" + escape_html(label) + "</span>";
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

bool has_lost(const ReportData& data) {
  return std::ranges::any_of(data.sessions, [](const ReportSession& session) { return !session.lost.empty(); });
}

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
  if (!data.sessions.empty() || !data.points.empty()) html += view_section(data) + plan_section(data);
  html += before_after_section(data);
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
