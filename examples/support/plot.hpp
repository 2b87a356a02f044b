#pragma once

#include <string>
#include <vector>

#include "support/report_data.hpp"

namespace chainslam::support {

/// A plot as an SVG element, and what a page needs to tell values under the pointer.
struct PlotDrawing {
  std::string svg{};
  double min_x = 0.0, max_x = 1.0;  ///< values at the frame's sides
  double left = 0.0, right = 1.0;   ///< the frame's sides in the drawing's units
  double top = 0.0, bottom = 1.0;
  double min_y = 0.0, max_y = 1.0;
  std::vector<ReportSeries> series{};  ///< thinned to what the drawing shows; finite values alone
};

/// Draws axes, grid and lines; a line has the class `s<n>` of its colour. `number` names the plot to the page
/// (`data-plot`).
[[nodiscard]] PlotDrawing draw_plot(const ReportPlot& plot, std::size_t number);

/// Class of a series' colour: `s0` to `s7`.
[[nodiscard]] std::string color_class(const ReportPlot& plot, std::size_t series);

/// Round numbers that cut [low, high] into about `count` parts, all inside.
[[nodiscard]] std::vector<double> axis_ticks(double low, double high, int count);

}  // namespace chainslam::support
