#pragma once

#include <filesystem>
#include <vector>

#include "chainslam/sensor/packet.hpp"
#include "datasets/png_image.hpp"

namespace chainslam::datasets {

/// How a range image's pixels become points: a column is an azimuth, a row an elevation.
struct RangeImageGeometry {
  double units_per_metre = 500;
  int width = 0;
  int height = 0;
  double first_azimuth_deg = 180;      ///< of column 0's outer edge; x forward, y left
  double last_azimuth_deg = -180;      ///< of the last column's outer edge
  std::vector<double> row_angles_deg;  ///< downward positive, one for each row
};

/// Reads the geometry from the last line of a configuration: `[multiplier] width height first last angle...`, with one
/// angle for each row or the first and the last one; separated by blanks or semicolons. '#' starts a comment line.
/// @throws IoError if the numbers do not add up.
[[nodiscard]] RangeImageGeometry read_range_image_geometry(const std::filesystem::path& path);

/// Points of a range image measured between `start` and `end`, column after column from the first: clockwise from
/// behind the sensor, as the HDL-64E turns. Derived from the Muehlburger Tor recording (scans 240 to 500, the car
/// drives): with sweeps corrected by this order, scan-to-map registration matches 52.5 % of the points at 42.1 mm rms;
/// in the reverse order 50.3 % at 44.2 mm, without correction 52.0 % at 43.1 mm, and every order that starts elsewhere
/// does worse too.
/// @param mask  none, or an image of the same size whose zeros are left out.
[[nodiscard]] LidarScan scan_of_range_image(const GrayImage& image, const RangeImageGeometry& geometry, Timestamp start,
                                            Timestamp end, const GrayImage* mask = nullptr);

}  // namespace chainslam::datasets
