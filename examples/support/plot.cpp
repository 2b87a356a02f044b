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

constexpr double drawing_width = 1100.0, drawing_height = 290.0;
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

std::string text(double x, double y, const char* anchor, const std::string& words, const char* extra = "") {
  return "<text x=\"" + coordinate(x) + "\" y=\"" + coordinate(y) + "\" text-anchor=\"" + anchor + "\"" + extra + ">" +
         escape_html(words) + "</text>";
}

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
  PlotDrawing drawing{.left = 58.0, .right = drawing_width - 14.0, .top = 12.0, .bottom = drawing_height - 44.0};
  for (const ReportSeries& series : plot.series) drawing.series.push_back(thinned(series));
  fit_axes(drawing);
  const auto to_x = [&](double x) {
    return drawing.left + (x - drawing.min_x) / (drawing.max_x - drawing.min_x) * (drawing.right - drawing.left);
  };
  const auto to_y = [&](double y) {
    return drawing.bottom - (y - drawing.min_y) / (drawing.max_y - drawing.min_y) * (drawing.bottom - drawing.top);
  };

  std::string grid, labels;
  for (const double tick : axis_ticks(drawing.min_x, drawing.max_x, 10)) {
    grid += line(to_x(tick), drawing.top, to_x(tick), drawing.bottom);
    labels += text(to_x(tick), drawing.bottom + 16.0, "middle", number(tick, 6));
  }
  for (const double tick : axis_ticks(drawing.min_y, drawing.max_y, 5)) {
    grid += line(drawing.left, to_y(tick), drawing.right, to_y(tick));
    labels += text(drawing.left - 8.0, to_y(tick) + 4.0, "end", number(tick, 4));
  }
  const double middle_y = 0.5 * (drawing.top + drawing.bottom);
  labels += text(0.5 * (drawing.left + drawing.right), drawing_height - 8.0, "middle", plot.x_label, " class=\"axis\"");
  const std::string turn = " class=\"axis\" transform=\"rotate(-90 14 " + coordinate(middle_y) + ")\"";
  labels += text(14.0, middle_y, "middle", plot.y_label, turn.c_str());

  std::string lines;
  for (std::size_t i = 0; i < drawing.series.size(); ++i) {
    const ReportSeries& series = drawing.series[i];
    std::string points;
    for (std::size_t j = 0; j < series.x.size(); ++j)
      points += (j == 0 ? "" : " ") + coordinate(to_x(series.x[j])) + "," + coordinate(to_y(series.y[j]));
    lines += "<polyline class=\"" + color_class(plot, i) + (plot.series[i].dashed ? " dashed" : "") + "\" points=\"" +
             points + "\"/>";
  }
  drawing.svg = "<svg class=\"plot\" data-plot=\"" + std::to_string(plot_number) + "\" viewBox=\"0 0 " +
                coordinate(drawing_width) + " " + coordinate(drawing_height) + "\" role=\"img\" aria-label=\"" +
                escape_html(plot.title) + "\"><g class=\"grid\">" + grid + "</g><g class=\"lines\">" + lines +
                "</g><g class=\"labels\">" + labels + "</g></svg>";
  return drawing;
}

}  // namespace chainslam::support
