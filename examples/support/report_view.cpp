#include "support/report_view.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>

#include "chainslam/cloud/cell_table.hpp"
#include "support/encoding.hpp"
#include "support/map_picture.hpp"

namespace chainslam::support {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::array path_kinds{"optimized", "odometry", "truth"};

const std::vector<Eigen::Vector3d>& path_of(const ReportSession& session, std::size_t kind) {
  return kind == 0 ? session.optimized : (kind == 1 ? session.odometry : session.truth);
}

struct Points {
  std::vector<Eigen::Vector3f> positions;
  std::vector<std::uint8_t> sessions;
};

/// The first point in each cell of this size.
Points first_in_cells(const ReportData& data, double size) {
  Points kept;
  CellTable cells;
  for (std::size_t i = 0; i < data.points.size(); ++i) {
    const std::optional<Cell> cell = cell_of(data.points[i].cast<double>() / size);
    if (!cell || !cells.insert(*cell, 0).second) continue;
    kept.positions.push_back(data.points[i]);
    kept.sessions.push_back(data.point_sessions.empty() ? std::uint8_t{0} : data.point_sessions[i]);
  }
  return kept;
}

/// How many they are, counted no farther than `enough`. Of cells so small most are alone: too sparse for a `CellSet`.
std::size_t occupied_cells(const ReportData& data, double size, std::size_t enough) {
  CellTable cells;
  for (std::size_t i = 0; i < data.points.size() && static_cast<std::size_t>(cells.size()) < enough; ++i)
    if (const std::optional<Cell> cell = cell_of(data.points[i].cast<double>() / size)) cells.insert(*cell, 0);
  return static_cast<std::size_t>(cells.size());
}

/// Thins the points evenly in space until there are few enough. Points lie on surfaces, so that their number goes with
/// the inverse square of the cell.
Points thinned(const ReportData& data, std::size_t largest) {
  double size = 0.05;
  for (std::size_t count; (count = occupied_cells(data, size, 2 * largest + 1)) > largest;) {
    const double excess = static_cast<double>(count) / static_cast<double>(largest);
    size *= std::max(std::sqrt(excess), 1.1);
  }
  return first_in_cells(data, size);
}

struct Box {
  Eigen::Vector3d low = Eigen::Vector3d::Zero();
  Eigen::Vector3d high = Eigen::Vector3d::Zero();
};

Box box_of(const std::vector<Eigen::Vector3f>& points) {
  Box box;
  if (points.empty()) return box;
  Eigen::Vector3f low = points.front(), high = points.front();
  for (const Eigen::Vector3f& point : points) {
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  return {low.cast<double>(), high.cast<double>()};
}

/// Heights between which colours run: all but the outermost fiftieth of the points.
std::array<float, 2> height_range(const std::vector<Eigen::Vector3f>& points, double origin_shift) {
  std::vector<float> heights;
  for (const Eigen::Vector3f& point : points) heights.push_back(point.z() + static_cast<float>(origin_shift));
  if (heights.empty()) return {0.0F, 1.0F};
  std::ranges::sort(heights);
  return {heights[heights.size() / 50], heights[heights.size() - 1 - heights.size() / 50]};
}

/// Edge of the square that each point has for itself on the ground: points draw closed surfaces at this size.
double spacing_of(const std::vector<Eigen::Vector3f>& points) {
  const std::size_t count = points.size();
  if (count < 2) return 0.5;
  for (double size = 0.1; size < 20.0; size *= 1.3) {
    CellSet cells;
    std::size_t inside = 0;
    for (const Eigen::Vector3f& point : points)
      if (const auto cell = cell_of(point.cast<double>() / size)) {
        cells.insert(*cell);
        ++inside;
      }
    if (static_cast<double>(inside) >= 1.5 * static_cast<double>(cells.size())) return size;
  }
  return 20.0;
}

template <class T>
std::string base64_of(const std::vector<T>& values) {
  static_assert(std::endian::native == std::endian::little, "the page reads little-endian arrays");
  return base64(std::as_bytes(std::span(values)));
}

std::string data_block(const char* id, const std::string& type, const std::string& content) {
  return "<script type=\"" + type + "\" id=\"" + id + "\">" + content + "</script>\n";
}

/// JSON that is safe inside a script element: no `<` in it, so no tag.
std::string embedded_json(const Json& json) {
  std::string text;
  for (const char c : json.dump(-1, ' ', false, Json::error_handler_t::replace)) {
    if (c == '<')
      text += "\\u003c";
    else
      text += c;
  }
  return text;
}

/// Values with seven digits: more than a plot or a tooltip shows, and short in JSON.
Json rounded(const std::vector<double>& values) {
  Json array = Json::array();
  for (const double value : values) {
    char buffer[64];
    const auto end = std::to_chars(buffer, std::end(buffer), value, std::chars_format::general, 7).ptr;
    double short_value = 0.0;
    std::from_chars(buffer, end, short_value);
    array.push_back(short_value);
  }
  return array;
}

Json plot_json(const ReportPlot& plot, const PlotDrawing& drawing) {
  Json json{{"x_label", plot.x_label}, {"min_x", drawing.min_x}, {"max_x", drawing.max_x}};
  json["series"] = Json::array();
  for (const ReportSeries& series : drawing.series)
    json["series"].push_back({{"name", series.name}, {"x", rounded(series.x)}, {"y", rounded(series.y)}});
  return json;
}

/// Blocks that hold the sessions' paths, the closures and the points, and what the script must know of them.
class ViewData {
 public:
  ViewData(const ReportData& data, std::size_t max_points, const Eigen::Vector3d& origin) {
    add_paths(data, origin);
    add_closures(data);
    add_points(data, max_points, origin);
    meta_["origin"] = {origin.x(), origin.y(), origin.z()};
  }

  Json& meta() { return meta_; }
  [[nodiscard]] const std::string& blocks() const { return blocks_; }

 private:
  static constexpr const char* binary = "application/octet-stream;base64";

  void add_paths(const ReportData& data, const Eigen::Vector3d& origin) {
    std::vector<float> positions;
    meta_["paths"] = Json::array();
    meta_["session_names"] = Json::array();
    meta_["session_offsets"] = Json::array();
    meta_["session_colors"] = Json::array();
    for (std::size_t i = 0; i < 8; ++i) meta_["session_colors"].push_back(session_color(i));
    for (std::size_t s = 0; s < data.sessions.size(); ++s) {
      const Eigen::Vector3d& offset = data.sessions[s].offset;
      meta_["session_names"].push_back(data.sessions[s].name);
      meta_["session_offsets"].push_back({offset.x(), offset.y(), offset.z()});
      for (std::size_t kind = 0; kind < path_kinds.size(); ++kind) {
        const auto& path = path_of(data.sessions[s], kind);
        if (path.empty()) continue;
        meta_["paths"].push_back({{"session", s},
                                  {"kind", path_kinds[kind]},
                                  {"first", positions.size() / 3},
                                  {"count", path.size()},
                                  {"times", kind == 0 ? rounded(data.sessions[s].times) : Json::array()}});
        for (const Eigen::Vector3d& position : path)
          for (Eigen::Index axis = 0; axis < 3; ++axis)
            positions.push_back(static_cast<float>(position[axis] - origin[axis]));
      }
    }
    blocks_ += data_block("paths", binary, base64_of(positions));
  }

  void add_closures(const ReportData& data) {
    std::vector<std::int32_t> closures;
    for (const ReportClosure& closure : data.closures)
      closures.insert(closures.end(), {closure.from, closure.to, static_cast<std::int32_t>(closure.kind)});
    meta_["closure_kinds"] = Json::array();
    meta_["closure_colors"] = Json::array();
    for (const ClosureKind kind : closure_kinds) {
      meta_["closure_kinds"].push_back(name_of(kind));
      meta_["closure_colors"].push_back(closure_color(kind));
    }
    blocks_ += data_block("closures", binary, base64_of(closures));
  }

  void add_points(const ReportData& data, std::size_t max_points, const Eigen::Vector3d& origin) {
    const Points points = thinned(data, max_points);
    const Eigen::Vector3d shift = data.points_origin - origin;
    const Box box = box_of(points.positions);
    const Eigen::Vector3d step = ((box.high - box.low) / 65535.0).cwiseMax(1e-6);
    std::vector<std::uint16_t> quantized;
    quantized.reserve(3 * points.positions.size());
    for (const Eigen::Vector3f& point : points.positions)
      for (Eigen::Index axis = 0; axis < 3; ++axis)
        quantized.push_back(static_cast<std::uint16_t>(
            std::clamp(std::lround((double{point[axis]} - box.low[axis]) / step[axis]), 0L, 65535L)));
    const auto heights = height_range(points.positions, shift.z());
    meta_["point_count"] = points.positions.size();
    meta_["point_low"] = {box.low.x() + shift.x(), box.low.y() + shift.y(), box.low.z() + shift.z()};
    meta_["point_step"] = {step.x(), step.y(), step.z()};
    meta_["point_size"] = spacing_of(points.positions);
    meta_["height"] = {heights[0], heights[1]};
    blocks_ += data_block("points", binary, base64_of(quantized));
    blocks_ +=
        data_block("point-sessions", binary, data.point_sessions.empty() ? std::string() : base64_of(points.sessions));
  }

  Json meta_ = Json::object();
  std::string blocks_;
};

/// Where the view looks at first: the middle of what `view_of` shows, and half its larger side.
void add_view(Json& meta, const ReportData& data, const Eigen::Vector3d& origin) {
  const MapView view = view_of(data);
  double height = origin.z();
  if (!data.sessions.empty() && !data.sessions.front().optimized.empty())
    height = data.sessions.front().optimized.front().z();
  meta["centre"] = {0.5 * (view.min_x + view.max_x) - origin.x(), 0.5 * (view.min_y + view.max_y) - origin.y(),
                    height - origin.z()};
  meta["low"] = {view.min_x - origin.x(), view.min_y - origin.y()};
  meta["high"] = {view.max_x - origin.x(), view.max_y - origin.y()};
  meta["reach"] = 0.5 * std::max(view.width(), view.height());
}

}  // namespace

std::string view_elements(const ReportData& data, std::size_t max_points, const std::vector<PlotDrawing>& plots) {
  const MapView view = view_of(data);
  const Eigen::Vector3d origin(std::round(0.5 * (view.min_x + view.max_x)), std::round(0.5 * (view.min_y + view.max_y)),
                               std::round(data.points_origin.z()));
  ViewData view_data(data, max_points, origin);
  add_view(view_data.meta(), data, origin);
  view_data.meta()["plots"] = Json::array();
  for (std::size_t i = 0; i < plots.size(); ++i)
    view_data.meta()["plots"].push_back(plot_json(data.plots[i], plots[i]));
  return data_block("meta", "application/json", embedded_json(view_data.meta())) + view_data.blocks();
}

}  // namespace chainslam::support
