#include "support/plot.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <iterator>
#include <limits>

#include "support/drawable.hpp"
#include "support/encoding.hpp"

namespace chainslam::support {
namespace {

constexpr double area_width = 1000.0,
                 area_height = 220.0;         // of grid and lines, which the page stretches; text it does not
constexpr std::size_t largest_series = 1500;  // points: two for each unit of the drawing

std::string number(double value, int digits) {
  char buffer[64];
  return {buffer, std::to_chars(buffer, std::end(buffer), value, std::chars_format::general, digits).ptr};
}

std::string coordinate(double value) {
  char buffer[64];
  return {buffer, std::to_chars(buffer, std::end(buffer), value, std::chars_format::fixed, 1).ptr};
}

/// What can be drawn of the values, thinned so that each stretch keeps its lowest and its highest.
ReportSeries thinned(const ReportSeries& series) {
  ReportSeries finite{.name = series.name};
  for (std::size_t i = 0; i < std::min(series.x.size(), series.y.size()); ++i) {
    if (!is_drawable(series.x[i]) || !is_drawable(series.y[i])) continue;
    finite.x.push_back(series.x[i]);
    finite.y.push_back(series.y[i]);
  }
  if (finite.x.size() <= largest_series) return finite;
  ReportSeries result{.name = series.name};
  const std::size_t stretches = largest_series / 2;
  for (std::size_t stretch = 0; stretch < stretches; ++stretch) {
    const auto begin = finite.y.begin() + static_cast<std::ptrdiff_t>(stretch * finite.y.size() / stretches);
    const auto end = finite.y.begin() + static_cast<std::ptrdiff_t>((stretch + 1) * finite.y.size() / stretches);
    auto [low, high] = std::minmax_element(begin, end);
    if (low > high) std::swap(low, high);
    for (const auto at : {low, high}) {
      if (at == high && low == high) break;
      result.x.push_back(finite.x[static_cast<std::size_t>(at - finite.y.begin())]);
      result.y.push_back(*at);
    }
  }
  return result;
}

void fit_axes(PlotDrawing& drawing) {
  constexpr double infinity = std::numeric_limits<double>::infinity();
  double min_x = infinity, max_x = -infinity, min_y = 0.0, max_y = -infinity;  // lengths and speeds start at 0
  for (const ReportSeries& series : drawing.series) {
    for (const double x : series.x) min_x = std::min(min_x, x), max_x = std::max(max_x, x);
    for (const double y : series.y) min_y = std::min(min_y, y), max_y = std::max(max_y, y);
  }
  if (!(max_x > min_x)) min_x = is_finite(min_x) ? min_x - 0.5 : 0.0, max_x = min_x + 1.0;
  if (!(max_y > min_y)) max_y = min_y + 1.0;
  drawing.min_x = min_x;
  drawing.max_x = max_x;
  drawing.min_y = min_y;
  drawing.max_y = max_y + 0.05 * (max_y - min_y);
}

/// @param place  attributes.
std::string text(const std::string& place, const char* anchor, const std::string& words) {
  return "<text " + place + " text-anchor=\"" + anchor + "\">" + escape_html(words) + "</text>";
}

std::string percent(double value, double whole) { return coordinate(100.0 * value / whole) + "%"; }

std::string line(double x1, double y1, double x2, double y2) {
  return "<line x1=\"" + coordinate(x1) + "\" y1=\"" + coordinate(y1) + "\" x2=\"" + coordinate(x2) + "\" y2=\"" +
         coordinate(y2) + "\"/>";
}

}  // namespace

std::string color_class(const ReportPlot& plot, std::size_t series) {
  const Index color = plot.series[series].color;
  return "s" + std::to_string((color >= 0 ? static_cast<std::size_t>(color) : series) % 8);
}

std::vector<double> axis_ticks(double low, double high, int count) {
  const double rough = (high - low) / count;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  double step = 10.0 * power;
  for (const double factor : {5.0, 2.0, 1.0})
    if (factor * power >= rough) step = factor * power;
  std::vector<double> ticks;
  const double first = std::ceil(low / step);  // so large, perhaps, that adding 1 does not change it
  for (int i = 0; i <= count && (first + i) * step <= high; ++i) ticks.push_back((first + i) * step);
  return ticks;
}

PlotDrawing draw_plot(const ReportPlot& plot, std::size_t plot_number) {
  PlotDrawing drawing;
  for (const ReportSeries& series : plot.series) drawing.series.push_back(thinned(series));
  fit_axes(drawing);
  const auto to_x = [&](double x) { return (x - drawing.min_x) / (drawing.max_x - drawing.min_x) * area_width; };
  const auto to_y = [&](double y) { return (drawing.max_y - y) / (drawing.max_y - drawing.min_y) * area_height; };

  std::string grid, labels;
  bool every_other = false;
  for (const double tick : axis_ticks(drawing.min_x, drawing.max_x, 10)) {
    grid += line(to_x(tick), 0.0, to_x(tick), area_height);
    labels += text("x=\"" + percent(to_x(tick), area_width) + "\" y=\"236\"" + (every_other ? " class=\"wide\"" : ""),
                   "middle", number(tick, 6));
    every_other = !every_other;
  }
  for (const double tick : axis_ticks(drawing.min_y, drawing.max_y, 5)) {
    grid += line(0.0, to_y(tick), area_width, to_y(tick));
    labels += text("x=\"-8\" y=\"" + percent(to_y(tick), area_height) + "\" dy=\"4\"", "end", number(tick, 4));
  }
  labels += text("class=\"axis\" x=\"50%\" y=\"258\"", "middle", plot.x_label);
  labels += text("class=\"axis\" transform=\"translate(-44 110) rotate(-90)\"", "middle", plot.y_label);

  std::string lines;
  for (std::size_t i = 0; i < drawing.series.size(); ++i) {
    const ReportSeries& series = drawing.series[i];
    std::string points;
    for (std::size_t j = 0; j < series.x.size(); ++j)
      points += (j == 0 ? "" : " ") + coordinate(to_x(series.x[j])) + "," + coordinate(to_y(series.y[j]));
    lines += "<polyline class=\"" + color_class(plot, i) + (plot.series[i].dashed ? " dashed" : "") + "\" points=\"" +
             points + "\"/>";
  }
  const std::string width = coordinate(area_width), height = coordinate(area_height);
  drawing.html = "<div class=\"plot\" data-plot=\"" + std::to_string(plot_number) + "\" role=\"img\" aria-label=\"" +
                 escape_html(plot.title) + "\"><svg class=\"area\" viewBox=\"0 0 " + width + " " + height +
                 "\" preserveAspectRatio=\"none\"><rect width=\"" + width + "\" height=\"" + height +
                 "\"/><g class=\"grid\">" + grid + "</g><g class=\"lines\">" + lines +
                 "</g></svg><svg class=\"area labels\">" + labels + "</svg></div>";
  return drawing;
}

}  // namespace chainslam::support
