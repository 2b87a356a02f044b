#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "support/report_data.hpp"

namespace chainslam::support {

/// The part of the map's ground plane that pictures show, metres, map frame.
struct MapView {
  double min_x = 0.0;
  double min_y = 0.0;
  double max_x = 1.0;
  double max_y = 1.0;

  [[nodiscard]] double width() const { return max_x - min_x; }
  [[nodiscard]] double height() const { return max_y - min_y; }
};

/// All trajectories and nearly all points: the outermost hundredth of the points on each side has no say. A long thin
/// map gets a view whose shorter side is an eighth of the longer one, so that there is a picture to look at.
[[nodiscard]] MapView view_of(const ReportData& data);

/// The view with its shorter side widened to an eighth of the longer one, about its centre.
[[nodiscard]] MapView with_least_sides(const MapView& view);

/// The map from above, as opacity: 0 where nothing is, faint ground, strong walls. Rows from the largest y down.
struct MapRaster {
  Index width = 0;
  Index height = 0;
  std::vector<std::uint8_t> opacity;  ///< row by row

  [[nodiscard]] std::uint8_t at(Index column, Index row) const {
    return opacity[static_cast<std::size_t>(row) * static_cast<std::size_t>(width) + static_cast<std::size_t>(column)];
  }
};

/// @param largest_side  of the raster, in cells; fewer are taken where points are sparse, so that surfaces stay closed.
[[nodiscard]] MapRaster rasterize(const ReportData& data, const MapView& view, Index largest_side);

/// Bytes of a PNG file. @param channels  1 gray, 2 gray and opacity, 3 red, green and blue.
/// @throws std::runtime_error if libpng refuses.
[[nodiscard]] std::string png_bytes(const std::vector<std::uint8_t>& samples, Index width, Index height, int channels);

/// A length of 1, 2 or 5 times a power of ten for a scale bar: the longest within a fifth of `width`.
[[nodiscard]] double scale_bar_length(double width);

/// Colours of sessions (in turn), and of closures by kind, as 0xRRGGBB: the same in pictures, plots and 3-D views.
[[nodiscard]] std::uint32_t session_color(std::size_t session);
[[nodiscard]] std::uint32_t closure_color(ClosureKind kind);

struct MapPictureOptions {
  Index largest_side = 1600;  ///< pixels
  bool dark = true;
};

/// Writes a PNG file of the map from above, with trajectories, closures and a scale bar. @throws IoError
void write_map_picture(const std::filesystem::path& path, const ReportData& data,
                       const MapPictureOptions& options = {});

}  // namespace chainslam::support
