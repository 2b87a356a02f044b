#include "support/map_picture.hpp"

#include <png.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <stdexcept>
#include <string_view>

#include "chainslam/core/types.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "support/drawable.hpp"

namespace chainslam::support {
namespace {

struct Range {
  double min = std::numeric_limits<double>::max();
  double max = std::numeric_limits<double>::lowest();

  void include(double value) {
    if (!is_drawable(value)) return;
    min = std::min(min, value);
    max = std::max(max, value);
  }
  [[nodiscard]] bool empty() const { return min > max; }
};

/// From the first to the last hundredth of one coordinate of the points.
Range middle_of(const ReportData& data, Eigen::Index axis) {
  std::vector<float> values;
  const std::size_t stride = data.points.size() / 100'000 + 1;
  for (std::size_t i = 0; i < data.points.size(); i += stride)
    if (is_finite(data.points[i])) values.push_back(data.points[i][axis]);
  Range range;
  if (values.empty()) return range;
  std::ranges::sort(values);
  range.include(data.points_origin[axis] + values[values.size() / 100]);
  range.include(data.points_origin[axis] + values[values.size() - 1 - values.size() / 100]);
  return range;
}

Range shown_range(const ReportData& data, Eigen::Index axis) {
  Range range = middle_of(data, axis);
  for (const ReportSession& session : data.sessions)
    for (const auto* path : {&session.optimized, &session.truth})
      for (const Eigen::Vector3d& position : *path) range.include(position[axis]);
  if (range.empty()) return {0.0, 1.0};
  const double margin = 0.02 * (range.max - range.min) + 5.0;
  return {range.min - margin, range.max + margin};
}

/// Lowest and highest point of each cell.
struct HeightRaster {
  Index width, height;
  std::vector<float> lowest, highest;
  Index occupied = 0;
  std::size_t points = 0;

  HeightRaster(const ReportData& data, const MapView& view, Index side) {
    const double cell = std::max(view.width(), view.height()) / side;
    width = std::max<Index>(1, static_cast<Index>(std::ceil(view.width() / cell - 1e-9)));
    height = std::max<Index>(1, static_cast<Index>(std::ceil(view.height() / cell - 1e-9)));
    const std::size_t size = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    lowest.assign(size, std::numeric_limits<float>::max());
    highest.assign(size, std::numeric_limits<float>::lowest());
    for (const Eigen::Vector3f& point : data.points) add(point, data.points_origin, view, cell);
  }

  void add(const Eigen::Vector3f& point, const Eigen::Vector3d& origin, const MapView& view, double cell) {
    if (!is_finite(point)) return;
    const double column = std::floor((point.x() + origin.x() - view.min_x) / cell);
    const double row = std::floor((view.max_y - point.y() - origin.y()) / cell);
    if (!(column >= 0 && row >= 0 && column < width && row < height)) return;  // nor what is NaN
    const auto at = static_cast<std::size_t>(row) * static_cast<std::size_t>(width) + static_cast<std::size_t>(column);
    if (lowest[at] > highest[at]) ++occupied;
    ++points;
    lowest[at] = std::min(lowest[at], point.z());
    highest[at] = std::max(highest[at], point.z());
  }
};

using Color = Eigen::Vector3f;  // red, green, blue in [0, 1]

Color color_of(std::uint32_t rgb) {
  return Color(static_cast<float>(rgb >> 16 & 255), static_cast<float>(rgb >> 8 & 255), static_cast<float>(rgb & 255)) /
         255.0F;
}

/// A picture that strokes are blended onto, in pixels, y down. What is drawn outside of it is clipped.
class Canvas {
 public:
  Canvas(Index width, Index height, const Color& background)
      : width_(width),
        height_(height),
        pixels_(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), background),
        coverage_(pixels_.size(), 0.0F) {}

  void blend(Index column, Index row, const Color& color, float opacity) {
    if (contains(column, row)) blend(at(column, row), color, opacity);
  }

  /// Marks what a line covers; `paint` blends all that was marked at once, so that joints are not painted twice.
  void mark(const Eigen::Vector2f& a, const Eigen::Vector2f& b, float line_width) {
    if (!is_finite(a) || !is_finite(b)) return;
    const float reach = 0.5F * line_width + 1.0F;
    const Index first_column = clamp(std::min(a.x(), b.x()) - reach, width_);
    const Index last_column = clamp(std::max(a.x(), b.x()) + reach, width_);
    const Index first_row = clamp(std::min(a.y(), b.y()) - reach, height_);
    const Index last_row = clamp(std::max(a.y(), b.y()) + reach, height_);
    const Eigen::Vector2f direction = b - a;
    const float squared_length = std::max(direction.squaredNorm(), 1e-12F);
    for (Index row = first_row; row <= last_row; ++row) {
      for (Index column = first_column; column <= last_column; ++column) {
        const Eigen::Vector2f from_a = Eigen::Vector2f(float(column) + 0.5F, float(row) + 0.5F) - a;
        const float along = std::clamp(from_a.dot(direction) / squared_length, 0.0F, 1.0F);
        const float distance = (from_a - along * direction).norm();
        cover(column, row, std::clamp(0.5F * line_width + 0.5F - distance, 0.0F, 1.0F));
      }
    }
  }

  void paint(const Color& color, float opacity) {
    for (std::size_t i = 0; i < pixels_.size(); ++i) {
      if (coverage_[i] == 0.0F) continue;
      blend(i, color, coverage_[i] * opacity);
      coverage_[i] = 0.0F;
    }
  }

  [[nodiscard]] std::vector<std::uint8_t> samples() const {
    std::vector<std::uint8_t> result;
    result.reserve(3 * pixels_.size());
    for (const Color& pixel : pixels_)
      for (const float channel : pixel) result.push_back(static_cast<std::uint8_t>(std::lround(255.0F * channel)));
    return result;
  }

  [[nodiscard]] Index width() const { return width_; }
  [[nodiscard]] Index height() const { return height_; }

 private:
  static Index clamp(float value, Index count) {
    return static_cast<Index>(std::clamp(value, 0.0F, static_cast<float>(count - 1)));
  }
  [[nodiscard]] bool contains(Index column, Index row) const {
    return column >= 0 && row >= 0 && column < width_ && row < height_;
  }
  void blend(std::size_t pixel, const Color& color, float opacity) {
    pixels_[pixel] += opacity * (color - pixels_[pixel]);
  }
  void cover(Index column, Index row, float coverage) {
    if (contains(column, row)) coverage_[at(column, row)] = std::max(coverage_[at(column, row)], coverage);
  }
  [[nodiscard]] std::size_t at(Index column, Index row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(column);
  }

  Index width_, height_;
  std::vector<Color> pixels_;
  std::vector<float> coverage_;
};

/// Letters of the scale bar, 5 x 7: a row of bits each, the leftmost highest.
std::array<std::uint8_t, 7> glyph(char letter) {
  switch (letter) {
    case '0':
      return {14, 17, 19, 21, 25, 17, 14};
    case '1':
      return {4, 12, 4, 4, 4, 4, 14};
    case '2':
      return {14, 17, 1, 2, 4, 8, 31};
    case '5':
      return {31, 16, 30, 1, 1, 17, 14};
    case 'k':
      return {16, 16, 18, 20, 24, 20, 18};
    case 'm':
      return {0, 0, 26, 21, 21, 21, 21};
    default:
      return {};
  }
}

void draw_text(Canvas& canvas, std::string_view text, Index left, Index top, Index scale, const Color& color) {
  for (const char letter : text) {
    const auto rows = glyph(letter);
    for (Index y = 0; y < 7 * scale; ++y)
      for (Index x = 0; x < 5 * scale; ++x)
        if ((rows[static_cast<std::size_t>(y / scale)] >> (4 - x / scale) & 1) != 0)
          canvas.blend(left + x, top + y, color, 1.0F);
    left += 6 * scale;
  }
}

void draw_points(Canvas& canvas, const MapRaster& raster, const Color& color) {
  for (Index row = 0; row < canvas.height(); ++row) {
    for (Index column = 0; column < canvas.width(); ++column) {
      const Index x =
          std::min(raster.width - 1, static_cast<Index>(std::int64_t{column} * raster.width / canvas.width()));
      const Index y =
          std::min(raster.height - 1, static_cast<Index>(std::int64_t{row} * raster.height / canvas.height()));
      canvas.blend(column, row, color, static_cast<float>(raster.at(x, y)) / 255.0F);
    }
  }
}

/// Draws lines given in metres.
class MapPainter {
 public:
  MapPainter(Canvas& canvas, const MapView& view)
      : canvas_(canvas), view_(view), pixels_per_metre_(canvas.width() / view.width()) {}

  [[nodiscard]] Eigen::Vector2f pixel(const Eigen::Vector3d& p) const {
    return {static_cast<float>((p.x() - view_.min_x) * pixels_per_metre_),
            static_cast<float>((view_.max_y - p.y()) * pixels_per_metre_)};
  }

  void path(const std::vector<Eigen::Vector3d>& positions, std::uint32_t color, float width, float opacity) {
    for (std::size_t i = 1; i < positions.size(); ++i)
      if (is_drawable(positions[i - 1]) && is_drawable(positions[i]))
        canvas_.mark(pixel(positions[i - 1]), pixel(positions[i]), width);
    canvas_.paint(color_of(color), opacity);
  }

  void closures(const ReportData& data, ClosureKind kind, float width) {
    std::vector<Eigen::Vector3d> keyframes;
    for (const ReportSession& session : data.sessions)
      keyframes.insert(keyframes.end(), session.optimized.begin(), session.optimized.end());
    for (const ReportClosure& closure : data.closures) {
      if (closure.kind != kind || std::min(closure.from, closure.to) < 0 ||
          std::max(closure.from, closure.to) >= std::ssize(keyframes))
        continue;
      const Eigen::Vector3d& from = keyframes[static_cast<std::size_t>(closure.from)];
      const Eigen::Vector3d& to = keyframes[static_cast<std::size_t>(closure.to)];
      if (is_drawable(from) && is_drawable(to)) canvas_.mark(pixel(from), pixel(to), width);
    }
    canvas_.paint(color_of(closure_color(kind)), 0.85F);
  }

  void scale_bar(const Color& color, Index text_scale) {
    const double metres = scale_bar_length(view_.width());
    const auto length = static_cast<float>(metres * pixels_per_metre_);
    const auto margin = static_cast<float>(8 * text_scale);
    const float y = static_cast<float>(canvas_.height()) - margin;
    canvas_.mark({margin, y}, {margin + length, y}, 1.2F * static_cast<float>(text_scale));
    for (const float x : {margin, margin + length})
      canvas_.mark({x, y - margin / 3}, {x, y + margin / 3}, 1.2F * static_cast<float>(text_scale));
    canvas_.paint(color, 1.0F);
    const std::string text =
        metres >= 1000 ? std::to_string(std::lround(metres / 1000)) + "km" : std::to_string(std::lround(metres)) + "m";
    draw_text(canvas_, text, static_cast<Index>(margin) + text_scale, static_cast<Index>(y) - 11 * text_scale,
              text_scale, color);
  }

 private:
  Canvas& canvas_;
  const MapView& view_;
  double pixels_per_metre_;
};

}  // namespace

MapView view_of(const ReportData& data) {
  const Range x = shown_range(data, 0), y = shown_range(data, 1);
  return with_least_sides({x.min, y.min, x.max, y.max});
}

MapView with_least_sides(const MapView& view) {
  const double least = std::max(view.width(), view.height()) / 8.0;
  const double x = std::max(0.0, 0.5 * (least - view.width())), y = std::max(0.0, 0.5 * (least - view.height()));
  return {view.min_x - x, view.min_y - y, view.max_x + x, view.max_y + y};
}

MapRaster rasterize(const ReportData& data, const MapView& view, Index largest_side) {
  constexpr Index smallest_side = 160;
  constexpr float full_height = 4.0F;  // metres: a wall
  constexpr double points_per_cell = 1.6;
  Index side = largest_side;
  HeightRaster heights(data, view, side);
  while (side > smallest_side && static_cast<double>(heights.points) < points_per_cell * heights.occupied) {
    side = std::max(smallest_side, static_cast<Index>(side / 1.25));
    heights = HeightRaster(data, view, side);
  }
  MapRaster raster{heights.width, heights.height, {}};
  raster.opacity.resize(heights.lowest.size(), 0);
  for (std::size_t i = 0; i < raster.opacity.size(); ++i) {
    if (heights.lowest[i] > heights.highest[i]) continue;
    const float wall = std::min(1.0F, (heights.highest[i] - heights.lowest[i]) / full_height);
    raster.opacity[i] = static_cast<std::uint8_t>(std::lround(255.0F * (0.16F + 0.74F * wall)));
  }
  return raster;
}

std::string png_bytes(const std::vector<std::uint8_t>& samples, Index width, Index height, int channels) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(width);
  image.height = static_cast<png_uint_32>(height);
  image.format = channels == 3 ? PNG_FORMAT_RGB : (channels == 2 ? PNG_FORMAT_GA : PNG_FORMAT_GRAY);
  if (samples.size() !=
      static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * static_cast<std::size_t>(channels))
    throw std::invalid_argument("png_bytes: samples do not fill the picture");
  std::string bytes(PNG_IMAGE_PNG_SIZE_MAX(image), '\0');
  png_alloc_size_t size = bytes.size();
  if (png_image_write_to_memory(&image, bytes.data(), &size, 0, samples.data(), 0, nullptr) == 0)
    throw std::runtime_error(std::string("libpng: ") + static_cast<const char*>(image.message));
  bytes.resize(size);
  return bytes;
}

double scale_bar_length(double width) {
  const double largest = width / 5.0;
  double length = std::pow(10.0, std::floor(std::log10(largest)));
  if (5.0 * length <= largest) return 5.0 * length;
  if (2.0 * length <= largest) return 2.0 * length;
  return length;
}

// Okabe and Ito 2008, whose colours stay apart for the colour-blind: the sessions take those that read on dark and
// light alike, then darker ones of Brewer's; closures take the other three.
std::uint32_t session_color(std::size_t session) {
  constexpr std::array<std::uint32_t, 8> colors{0x56b4e9, 0xe69f00, 0x009e73, 0x0072b2,
                                                0x999999, 0xa6761d, 0x7570b3, 0x66a61e};
  return colors[session % colors.size()];
}

std::uint32_t closure_color(ClosureKind kind) {
  switch (kind) {
    case ClosureKind::direct:
      return 0xd55e00;
    case ClosureKind::chained:
      return 0xcc79a7;
    case ClosureKind::merge:
      return 0xf0e442;
  }
  return 0;
}

void write_map_picture(const std::filesystem::path& path, const ReportData& data, const MapPictureOptions& options) {
  const MapView view = view_of(data);
  const double scale = options.largest_side / std::max(view.width(), view.height());
  const auto width = std::max<Index>(1, static_cast<Index>(std::lround(scale * view.width())));
  const auto height = std::max<Index>(1, static_cast<Index>(std::lround(scale * view.height())));
  Canvas canvas(width, height, color_of(options.dark ? 0x0d1420 : 0xffffff));
  draw_points(canvas, rasterize(data, view, options.largest_side), color_of(options.dark ? 0x9fb3cc : 0x334155));

  MapPainter painter(canvas, view);
  const float line = std::max(1.0F, static_cast<float>(options.largest_side) / 500.0F);
  for (const ReportSession& session : data.sessions)
    painter.path(session.truth, options.dark ? 0xffffff : 0x000000, 0.5F * line, 0.7F);
  for (const ClosureKind kind : {ClosureKind::chained, ClosureKind::direct, ClosureKind::merge})
    painter.closures(data, kind, kind == ClosureKind::merge ? 2.0F * line : 0.6F * line);
  for (std::size_t i = 0; i < data.sessions.size(); ++i)
    painter.path(data.sessions[i].optimized, session_color(i), line, 0.95F);
  painter.scale_bar(color_of(options.dark ? 0xe2e8f0 : 0x1e293b), std::max<Index>(1, options.largest_side / 500));

  AtomicFile file(path);
  file.write(png_bytes(canvas.samples(), width, height, 3));
  file.commit();
}

}  // namespace chainslam::support
