#include <algorithm>
#include <cmath>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "support/drawable.hpp"
#include "support/encoding.hpp"
#include "support/map_picture.hpp"
#include "support/report_parts.hpp"

namespace chainslam::support {
namespace {

/// A plan as an SVG element: layers that the page's legend switches on and off by their `data-shape`.
class PlanDrawing {
 public:
  /// @param width  of the drawing's larger side, in its own units.
  PlanDrawing(const ReportData& data, const MapView& view, double width)
      : data_(data), view_(view), units_per_metre_(width / std::max(view_.width(), view_.height())) {
    for (const ReportSession& session : data_.sessions)
      keyframes_.insert(keyframes_.end(), session.optimized.begin(), session.optimized.end());
  }

  [[nodiscard]] std::string svg(const std::string& label, const std::string& layers) const {
    const std::string size =
        fixed(view_.width() * units_per_metre_, 1) + " " + fixed(view_.height() * units_per_metre_, 1);
    return "<svg viewBox=\"0 0 " + size + "\" role=\"img\" aria-label=\"" + label + "\">" + layers + scale_bar() +
           "</svg>";
  }

  [[nodiscard]] static std::string layer(const std::string& shape, const std::string& content, bool shown = true) {
    if (content.empty()) return "";
    return "<g data-shape=\"" + shape + "\"" + (shown ? "" : " class=\"off\"") + ">" + content + "</g>";
  }

  /// A path of each session. @param classes  besides the session's.
  [[nodiscard]] std::string paths(std::vector<Eigen::Vector3d> ReportSession::*which,
                                  const std::string& classes = "") const {
    std::string html;
    for (std::size_t s = 0; s < data_.sessions.size(); ++s)
      html += path(classes + session_class(s), data_.sessions[s].*which);
    return html;
  }

  /// Where scans were lost, with a ring where each stretch begins.
  [[nodiscard]] std::string lost() const {
    std::string html;
    for (const ReportSession& session : data_.sessions)
      for (const std::vector<Eigen::Vector3d>& stretch : session.lost) {
        html += path("lost", stretch);
        if (!stretch.empty() && is_drawable(stretch.front()))
          html += "<circle class=\"lost\" r=\"6\" cx=\"" + x(stretch.front().x()) + "\" cy=\"" +
                  y(stretch.front().y()) + "\"/>";
      }
    return html;
  }

  [[nodiscard]] std::string closures(ClosureKind kind) const {
    std::string lines;
    for (const ReportClosure& closure : data_.closures) {
      if (closure.kind != kind) continue;
      const Eigen::Vector3d& from = keyframe(closure.from);
      const Eigen::Vector3d& to = keyframe(closure.to);
      if (!is_drawable(from) || !is_drawable(to)) continue;
      lines += "M" + x(from.x()) + " " + y(from.y()) + "L" + x(to.x()) + " " + y(to.y());
    }
    if (lines.empty()) return "";
    const std::string path = "d=\"" + lines + "\"/>";
    return (kind == ClosureKind::merge ? "<path class=\"casing\" " + path : "") + "<path class=\"closures " +
           name_of(kind) + "\" " + path;
  }

  /// Blots under the keyframes of each component, in four colours in turn; the largest have numbers.
  [[nodiscard]] std::string components() const {
    constexpr std::size_t numbered = 10;
    std::string blots, numbers;
    for (std::size_t c = 0; c < data_.components.size(); ++c) {
      const std::vector<Index>& members = data_.components[c].keyframes;
      blots += "<path class=\"component k" + std::to_string(c % 4) + "\" d=\"" + blot(members) + "\"/>";
      if (c >= numbered) continue;
      const Eigen::Vector3d& middle = keyframe(members[members.size() / 2]);
      if (is_drawable(middle))
        numbers += "<text class=\"number\" x=\"" + x(middle.x()) + "\" y=\"" + y(middle.y()) +
                   "\" dx=\"9\" dy=\"-9\">" + std::to_string(c + 1) + "</text>";
    }
    return blots + numbers;
  }

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

 private:
  [[nodiscard]] std::string x(double value) const { return fixed((value - view_.min_x) * units_per_metre_, 1); }
  [[nodiscard]] std::string y(double value) const { return fixed((view_.max_y - value) * units_per_metre_, 1); }
  [[nodiscard]] const Eigen::Vector3d& keyframe(Index i) const { return keyframes_[static_cast<std::size_t>(i)]; }

  [[nodiscard]] std::string path(const std::string& classes, const std::vector<Eigen::Vector3d>& positions) const {
    if (positions.size() < 2) return "";
    std::string points;
    for (const Eigen::Vector3d& p : positions)
      if (is_drawable(p)) points += (points.empty() ? "" : " ") + x(p.x()) + "," + y(p.y());
    return "<polyline class=\"path " + classes + "\" points=\"" + points + "\"/>";
  }

  /// Neighbours in time are one stroke, what stands alone a dot.
  [[nodiscard]] std::string blot(const std::vector<Index>& members) const {
    std::string path;
    Index last = -2;
    for (const Index i : members) {
      const Eigen::Vector3d& p = keyframe(i);
      if (!is_drawable(p)) continue;
      const bool goes_on = i == last + 1 && (p - keyframe(last)).norm() < 15.0;
      path += (goes_on ? "L" : "M") + x(p.x()) + " " + y(p.y()) + (goes_on ? "" : "h0");
      last = i;
    }
    return path;
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
  std::vector<Eigen::Vector3d> keyframes_;
};

/// A legend's entry that switches a layer on and off.
std::string switch_entry(const std::string& shape, const std::string& swatch, const std::string& label,
                         bool shown = true) {
  return "<label><input type=\"checkbox\" data-switch=\"" + shape + "\"" + (shown ? " checked" : "") +
         "><i class=\"swatch " + swatch + "\"></i>" + escape_html(label) + "</label>";
}

/// What `view_of` shows, and all of the odometry.
MapView view_with_odometry(const ReportData& data) {
  MapView view = view_of(data);
  constexpr double margin = 5.0;
  for (const ReportSession& session : data.sessions)
    for (const Eigen::Vector3d& p : session.odometry) {
      if (!is_drawable(p)) continue;
      view.min_x = std::min(view.min_x, p.x() - margin);
      view.min_y = std::min(view.min_y, p.y() - margin);
      view.max_x = std::max(view.max_x, p.x() + margin);
      view.max_y = std::max(view.max_y, p.y() + margin);
    }
  return with_least_sides(view);
}

}  // namespace

std::string plan_section(const ReportData& data) {
  const PlanDrawing drawing(data, view_of(data), 1100.0);
  const bool alone = data.sessions.size() < 2;
  std::string layers = drawing.image() + PlanDrawing::layer("components", drawing.components(), false) +
                       PlanDrawing::layer("truth", drawing.paths(&ReportSession::truth, "truth ")) +
                       PlanDrawing::layer("odometry", drawing.paths(&ReportSession::odometry, "odometry "), alone);
  const auto add_closures = [&](ClosureKind kind) {
    layers += PlanDrawing::layer(name_of(kind), drawing.closures(kind));
  };
  add_closures(ClosureKind::chained);
  add_closures(ClosureKind::direct);
  layers += PlanDrawing::layer("optimized", drawing.paths(&ReportSession::optimized));
  layers += PlanDrawing::layer("lost", drawing.lost());
  add_closures(ClosureKind::merge);  // few, short, and what all else hangs on

  std::string legend;
  for (std::size_t s = 0; s < data.sessions.size(); ++s)
    legend += legend_entry(session_class(s), data.sessions[s].name);
  legend += "<label><input type=\"checkbox\" data-switch=\"optimized\" checked>trajectories</label>";
  if (has_odometry(data))
    legend += switch_entry("odometry", "odometry", alone ? "odometry alone" : "odometry, placed by the merge", alone);
  if (has_truth(data)) legend += switch_entry("truth", "truth", "truth");
  if (has_lost(data)) legend += switch_entry("lost", "lost", "scans lost");
  for (const ClosureKind kind : closure_kinds)
    if (count_kind(data, kind) > 0) legend += switch_entry(name_of(kind), name_of(kind), "closures, " + name_of(kind));
  if (!data.components.empty()) legend += switch_entry("components", "component k0", "adjacency components", false);
  return "<section><h2>Map from above</h2><p>Walls are strong, ground is faint.</p><div class=\"panel above\">" +
         drawing.svg("Map from above", layers) + "<div class=\"legend\">" + legend + "</div></div></section>\n";
}

std::string before_after_section(const ReportData& data) {
  if (!has_odometry(data) || data.closures.empty()) return "";
  const PlanDrawing drawing(data, view_with_odometry(data), 640.0);
  std::string after;
  for (const ClosureKind kind : {ClosureKind::chained, ClosureKind::direct}) after += drawing.closures(kind);
  after += drawing.paths(&ReportSession::optimized) + drawing.closures(ClosureKind::merge);
  const bool alone = data.sessions.size() < 2;
  const std::string before =
      alone ? "Odometry alone, from the first keyframe on." : "Odometry alone, each session placed by its merge.";
  return "<section><h2>Before and after</h2><div class=\"pair\"><figure class=\"panel above\">" +
         drawing.svg("Before the closures", drawing.paths(&ReportSession::odometry)) + "<figcaption>" + before +
         "</figcaption></figure><figure class=\"panel above\">" + drawing.svg("After the closures", after) +
         "<figcaption>Optimized, with the closures.</figcaption></figure></div></section>\n";
}

}  // namespace chainslam::support
