#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/detail/text.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/point_file.hpp"

namespace chainslam {

namespace detail {

struct PlyProperty {
  std::string name;
  ScalarType type = ScalarType::float32;
  std::optional<ScalarType> count;  ///< of a list: the type of its length
};

struct PlyElement {
  std::string name;
  std::uint64_t count = 0;
  std::vector<PlyProperty> properties;

  [[nodiscard]] bool has_lists() const {
    return std::any_of(properties.begin(), properties.end(), [](const PlyProperty& p) { return p.count.has_value(); });
  }
  /// Bytes of one row in binary, lists counted as empty.
  [[nodiscard]] std::size_t least_bytes() const {
    std::size_t sum = 0;
    for (const PlyProperty& p : properties) sum += size_of(p.count.value_or(p.type));
    return sum;
  }
};

struct PlyHeader {
  std::vector<PlyElement> elements;
  bool ascii = false;
  std::endian order = std::endian::little;
};

inline ScalarType ply_type(const LineFields& fields, std::string_view name) {
  constexpr std::array<std::array<std::string_view, 2>, 10> names{{{"char", "int8"},
                                                                   {"uchar", "uint8"},
                                                                   {"short", "int16"},
                                                                   {"ushort", "uint16"},
                                                                   {"int", "int32"},
                                                                   {"uint", "uint32"},
                                                                   {"long", "int64"},
                                                                   {"ulong", "uint64"},
                                                                   {"float", "float32"},
                                                                   {"double", "float64"}}};
  for (std::size_t i = 0; i < names.size(); ++i)
    if (name == names[i][0] || name == names[i][1]) return static_cast<ScalarType>(i);
  fields.fail("type", shown(name), "use char, uchar, short, ushort, int, uint, float or double");
}

inline void read_ply_property(LineFields& fields, PlyHeader& header) {
  if (header.elements.empty()) fields.fail("property", "a property before any element", "the header is damaged");
  PlyProperty property;
  std::string_view type = fields.text("type");
  if (type == "list") {
    property.count = ply_type(fields, fields.text("list length type"));
    if (!is_integer(*property.count)) fields.fail("list length type", "no whole number", "the header is damaged");
    type = fields.text("list type");
  }
  property.type = ply_type(fields, type);
  property.name = fields.text("name");
  header.elements.back().properties.push_back(std::move(property));
}

inline PlyHeader read_ply_header(InputFile& file) {
  const auto magic = file.read_line();
  if (!magic || trimmed(*magic) != "ply") file.fail("line 1", "no 'ply'", "this is no PLY file");
  PlyHeader header;
  bool formatted = false;
  while (const auto line = file.read_line()) {
    LineFields fields(file, *line);
    if (!fields.more()) continue;
    const std::string_view keyword = fields.text("keyword");
    if (keyword == "end_header") {
      if (!formatted) file.fail(file.place_of_line(), "no format line", "the header is damaged");
      return header;
    }
    if (keyword == "format") {
      const std::string_view format = fields.text("format");
      header.ascii = format == "ascii";
      if (format == "binary_big_endian") header.order = std::endian::big;
      formatted = header.ascii || format == "binary_big_endian" || format == "binary_little_endian";
      if (!formatted) fields.fail("format", shown(format), "use ascii, binary_little_endian or binary_big_endian");
    } else if (keyword == "element") {
      PlyElement element;
      element.name = fields.text("name");
      const std::int64_t count = fields.integer("count");
      if (count < 0 || count > std::numeric_limits<Index>::max())
        fields.fail("count", std::to_string(count), "elements number 0 to 2^31 - 1: the header is damaged");
      element.count = static_cast<std::uint64_t>(count);
      header.elements.push_back(std::move(element));
    } else if (keyword == "property") {
      read_ply_property(fields, header);
    } else if (keyword != "comment" && keyword != "obj_info") {
      fields.fail("keyword", shown(keyword), "this is no PLY file, or its header is damaged");
    }
  }
  file.fail(file.place_of_line(), "no end_header", "this is no PLY file, or it was cut short");
}

/// Reads rows of one element, in the file's order; `values` holds one number for each property, 0 for lists.
class PlyRows {
 public:
  PlyRows(InputFile& file, const PlyHeader& header, const PlyElement& element)
      : file_(file), header_(header), element_(element), values_(element.properties.size()) {}

  std::span<const double> next() {
    if (header_.ascii)
      next_line();
    else
      next_record();
    return values_;
  }

 private:
  void next_line() {
    auto line = file_.read_line();
    while (line && trimmed(*line).empty()) line = file_.read_line();
    if (!line)
      file_.fail(file_.place_of_line(), "the end of the file within element '" + element_.name + "'",
                 "the file was cut short: copy or record it again");
    LineFields fields(file_, *line);
    for (std::size_t i = 0; i < values_.size(); ++i) {
      const char* name = element_.properties[i].name.c_str();
      if (!element_.properties[i].count)
        values_[i] = fields.number_or_nan(name);
      else
        for (std::int64_t left = fields.integer(name); left > 0; --left) static_cast<void>(fields.number_or_nan(name));
    }
    fields.end("one row of its element");
  }

  void next_record() {
    std::array<std::byte, 8> bytes{};
    for (std::size_t i = 0; i < values_.size(); ++i) {
      const PlyProperty& property = element_.properties[i];
      const ScalarType type = property.count.value_or(property.type);
      file_.read(std::span(bytes).first(size_of(type)), "a row");
      const double value = load_as_double(type, bytes.data(), header_.order);
      if (!property.count) {
        values_[i] = value;
        continue;
      }
      if (value < 0 || value > 4294967295.0)
        file_.fail(file_.place_of_byte(), "a list of " + std::to_string(value) + " entries", "the file is damaged");
      file_.skip(static_cast<std::uint64_t>(value) * size_of(property.type), "a list");
    }
  }

  InputFile& file_;
  const PlyHeader& header_;
  const PlyElement& element_;
  std::vector<double> values_;
};

}  // namespace detail

/// Reads the vertices of a PLY file: ascii, binary little or big endian, with each point's time as the file states it.
///
/// Properties are found by name, in any order and of any type: x y z, and where present nx ny nz (or normal_x ...),
/// intensity (or scalar_intensity) and t (or time, timestamp, ...). Other properties, lists among them, and other
/// elements are skipped. Points are kept as they are, NaN among them. Sizes are checked before memory is taken.
/// Format: Turk 1994, the Stanford polygon file format.
/// @throws IoError naming line or byte: damaged header, no vertices with x y z, too few rows, not a number.
[[nodiscard]] inline PointFile read_ply_file(const std::filesystem::path& path) {
  InputFile file(path);
  const detail::PlyHeader header = detail::read_ply_header(file);
  for (const detail::PlyElement& element : header.elements) {
    detail::PlyRows rows(file, header, element);
    const bool vertices = element.name == "vertex";
    file.require(element.count, header.ascii ? 1 : element.least_bytes(), element.name.c_str());
    if (!vertices) {
      if (!header.ascii && !element.has_lists())
        file.skip(element.count * element.least_bytes(), element.name.c_str());
      else
        for (std::uint64_t i = 0; i < element.count; ++i) static_cast<void>(rows.next());
      continue;
    }
    std::vector<std::string> names;
    for (const auto& property : element.properties) names.push_back(property.count ? "" : property.name);
    detail::PointColumns points(names);
    if (!points.has_positions())
      file.fail("element vertex", "no properties x, y and z", "write them under these names");
    points.reserve(element.count);
    for (std::uint64_t i = 0; i < element.count; ++i) {
      const std::span<const double> row = rows.next();
      points.add([&](std::size_t k) { return row[k]; });
    }
    PointFile result = points.take();
    if (const auto time = points.time_field())
      result.integer_times = detail::is_integer(element.properties[*time].type);
    return result;
  }
  file.fail("the header", "no element named vertex", "this PLY file holds no points");
}

/// Reads the vertices of a PLY file as a cloud; times as in `read_pcd`. See `read_ply_file`.
[[nodiscard]] inline PointCloud<float> read_ply(const std::filesystem::path& path) {
  return detail::with_plain_times(read_ply_file(path));
}

/// Red, green, blue; 0 to 255.
using Color = std::array<std::uint8_t, 3>;

/// Writes a cloud as binary little-endian PLY: x y z and, where present, intensity, nx ny nz and red green blue.
/// @param colors  none, or one for each point.
/// @throws std::invalid_argument if their number is another; IoError if it cannot be written, the old file then stays.
inline void write_ply(const FileTarget& target, const PointCloud<float>& cloud, std::span<const Color> colors = {}) {
  if (!colors.empty() && colors.size() != cloud.size())
    throw std::invalid_argument("write_ply: give one colour for each point, or none");
  AtomicFile file(target);
  std::string header = "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(cloud.size()) +
                       "\nproperty float x\nproperty float y\nproperty float z\n";
  if (cloud.has_intensities()) header += "property float intensity\n";
  if (cloud.has_normals()) header += "property float nx\nproperty float ny\nproperty float nz\n";
  if (!colors.empty()) header += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
  file.write(header += "end_header\n");
  std::vector<std::byte> record;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    record.clear();
    for (int k = 0; k < 3; ++k) append_bytes(record, cloud.positions[i][k]);
    if (cloud.has_intensities()) append_bytes(record, cloud.intensities[i]);
    if (cloud.has_normals())
      for (int k = 0; k < 3; ++k) append_bytes(record, cloud.normals[i][k]);
    if (!colors.empty())
      for (const std::uint8_t channel : colors[i]) append_bytes(record, channel);
    file.write(record);
  }
  file.commit();
}

/// Writes points one by one, for clouds that are larger than memory, as `write_ply` does a cloud of positions.
/// @param count  how many. @param for_each  calls its argument with the position of each, metres.
/// @throws std::invalid_argument if they are more or fewer; IoError if it cannot be written. The old file then stays.
template <class ForEach>
void write_ply(const FileTarget& target, std::size_t count, const ForEach& for_each) {
  AtomicFile file(target);
  file.write("ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(count) +
             "\nproperty float x\nproperty float y\nproperty float z\nend_header\n");
  std::size_t written = 0;
  std::vector<std::byte> record;
  for_each([&](const Eigen::Vector3f& position) {
    record.clear();
    for (int k = 0; k < 3; ++k) append_bytes(record, position[k]);
    file.write(record);
    ++written;
  });
  if (written != count)
    throw std::invalid_argument("write_ply: " + std::to_string(written) + " points, not " + std::to_string(count));
  file.commit();
}

}  // namespace chainslam
