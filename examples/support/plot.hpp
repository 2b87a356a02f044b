#pragma once

#include <string>
#include <vector>

#include "support/report_data.hpp"

namespace chainslam::support {

/// A plot as an HTML element, and what a page needs to tell values under the pointer.
struct PlotDrawing {
  std::string html{};
  double min_x = 0.0, max_x = 1.0;  ///< values at the frame's sides
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
