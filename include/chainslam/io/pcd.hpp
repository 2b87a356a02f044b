#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/detail/lzf.hpp"
#include "chainslam/io/detail/text.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/point_file.hpp"

namespace chainslam {

/// How a PCD file stores its points.
enum class PcdEncoding { ascii, binary, binary_compressed };

namespace detail {

struct PcdHeader {
  std::vector<std::string> names;
  std::vector<ScalarType> types;
  std::vector<std::size_t> counts;   ///< values in the field
  std::vector<std::size_t> offsets;  ///< bytes from the start of a point's record
  std::size_t stride = 0;            ///< bytes in a point's record
  std::size_t points = 0;
  PcdEncoding encoding = PcdEncoding::ascii;

  [[nodiscard]] std::size_t bytes(std::size_t field) const { return size_of(types[field]) * counts[field]; }
  /// Characters of a point's line at least: a digit for each value, and what separates it from the next.
  [[nodiscard]] std::size_t least_characters() const {
    std::size_t values = 0;
    for (const std::size_t count : counts) values += count;
    return 2 * values - 1;
  }
};

class PcdHeaderReader {
 public:
  explicit PcdHeaderReader(InputFile& file) : file_(file) {}

  PcdHeader read() {
    while (const auto line = file_.read_line()) {
      const std::string_view text = trimmed(*line);
      if (text.empty() || text.starts_with('#')) continue;
      LineFields fields(file_, text);
      const std::string keyword(fields.text("keyword"));
      if (keyword == "DATA") {
        header_.encoding = encoding(fields.text("DATA"));
        return finish();
      }
      take(keyword, fields);
    }
    file_.fail("the end of the header", "no line that starts with DATA", "this is no PCD file, or it was cut short");
  }

 private:
  void take(const std::string& keyword, LineFields& fields) {
    if (keyword == "FIELDS" || keyword == "COLUMNS")
      while (fields.more()) header_.names.emplace_back(fields.text("FIELDS"));
    else if (keyword == "SIZE")
      while (fields.more()) sizes_.push_back(fields.integer("SIZE"));
    else if (keyword == "TYPE")
      while (fields.more()) letters_ += fields.text("TYPE").substr(0, 1);
    else if (keyword == "COUNT")
      while (fields.more()) header_.counts.push_back(checked("COUNT", fields.integer("COUNT"), 1, 1 << 16));
    else if (keyword == "WIDTH")
      width_ = checked("WIDTH", fields.integer("WIDTH"), 0, most_points);
    else if (keyword == "HEIGHT")
      height_ = checked("HEIGHT", fields.integer("HEIGHT"), 0, most_points);
    else if (keyword == "POINTS")
      points_ = checked("POINTS", fields.integer("POINTS"), 0, most_points);
    else if (keyword != "VERSION" && keyword != "VIEWPOINT")
      fields.fail("keyword", shown(keyword), "this is no PCD file, or its header is damaged");
  }

  PcdHeader finish() {
    const std::size_t fields = header_.names.size();
    if (header_.counts.empty()) header_.counts.assign(fields, 1);
    if (sizes_.size() != fields || letters_.size() != fields || header_.counts.size() != fields || fields == 0)
      fail(std::to_string(fields) + " FIELDS, " + std::to_string(sizes_.size()) + " SIZE, " +
               std::to_string(letters_.size()) + " TYPE, " + std::to_string(header_.counts.size()) + " COUNT",
           "give each field a size, a type and a count");
    for (std::size_t i = 0; i < fields; ++i) {
      header_.types.push_back(type(letters_[i], sizes_[i]));
      header_.offsets.push_back(header_.stride);
      header_.stride += header_.bytes(i);
    }
    if (!points_ && !width_) fail("neither POINTS nor WIDTH and HEIGHT", "state the number of points");
    const std::size_t grid = width_.value_or(0) * height_.value_or(1);
    header_.points = points_.value_or(grid);
    if ((width_ && grid != header_.points) || header_.points > static_cast<std::size_t>(most_points))
      fail("POINTS " + std::to_string(header_.points) + ", WIDTH * HEIGHT " + std::to_string(grid),
           "make POINTS equal to WIDTH * HEIGHT, below 2^31");
    return std::move(header_);
  }

  PcdEncoding encoding(std::string_view name) {
    if (name == "ascii") return PcdEncoding::ascii;
    if (name == "binary") return PcdEncoding::binary;
    if (name == "binary_compressed") return PcdEncoding::binary_compressed;
    fail("DATA " + shown(name), "use ascii, binary or binary_compressed");
  }

  ScalarType type(char letter, std::int64_t size) {
    const std::string both = letter + std::to_string(size);
    constexpr std::array<std::pair<std::string_view, ScalarType>, 10> table{{{"I1", ScalarType::int8},
                                                                             {"U1", ScalarType::uint8},
                                                                             {"I2", ScalarType::int16},
                                                                             {"U2", ScalarType::uint16},
                                                                             {"I4", ScalarType::int32},
                                                                             {"U4", ScalarType::uint32},
                                                                             {"I8", ScalarType::int64},
                                                                             {"U8", ScalarType::uint64},
                                                                             {"F4", ScalarType::float32},
                                                                             {"F8", ScalarType::float64}}};
    for (const auto& [name, scalar] : table)
      if (both == name) return scalar;
    fail("a field of TYPE " + shown(std::string_view(&letter, 1)) + " and SIZE " + std::to_string(size),
         "use I or U with 1, 2, 4 or 8 bytes, F with 4 or 8");
  }

  std::size_t checked(const char* keyword, std::int64_t value, std::int64_t least, std::int64_t most) {
    if (value < least || value > most)
      fail(std::string(keyword) + " " + std::to_string(value), "the header is damaged");
    return static_cast<std::size_t>(value);
  }

  [[noreturn]] void fail(std::string found, std::string remedy) const {
    file_.fail(file_.place_of_line(), std::move(found), std::move(remedy));
  }

  static constexpr std::int64_t most_points = std::numeric_limits<Index>::max();

  InputFile& file_;
  PcdHeader header_;
  std::vector<std::int64_t> sizes_;
  std::string letters_;
  std::optional<std::size_t> width_, height_, points_;
};

inline void read_pcd_ascii(InputFile& file, const PcdHeader& header, PointColumns& points) {
  file.require(header.points, header.least_characters(), "points");
  points.reserve(header.points);
  std::vector<double> values(header.names.size());
  for (std::size_t n = 0; n < header.points;) {
    const auto line = file.read_line();
    if (!line)
      file.fail(file.place_of_line(),
                "the end of the file after " + std::to_string(n) + " of " + std::to_string(header.points) + " points",
                "the file was cut short: copy or record it again");
    if (trimmed(*line).empty()) continue;
    LineFields fields(file, *line);
    for (std::size_t i = 0; i < values.size(); ++i)
      for (std::size_t k = 0; k < header.counts[i]; ++k) {
        const double value = fields.number_or_nan(header.names[i].c_str());
        if (k == 0) values[i] = value;
      }
    fields.end("as many numbers as FIELDS and COUNT ask for");
    points.add([&](std::size_t i) { return values[i]; });
    ++n;
  }
}

inline void read_pcd_binary(InputFile& file, const PcdHeader& header, PointColumns& points) {
  if (header.points == 0) return;
  file.require(header.points, header.stride, "points");
  points.reserve(header.points);
  std::vector<std::byte> record(header.stride);
  for (std::size_t n = 0; n < header.points; ++n) {
    file.read(record, "a point");
    points.add([&](std::size_t i) { return load_as_double(header.types[i], record.data() + header.offsets[i]); });
  }
}

/// Compressed points are stored field by field: all x, then all y, ...
inline void read_pcd_compressed(InputFile& file, const PcdHeader& header, PointColumns& points) {
  std::array<std::byte, 8> sizes{};
  file.read(sizes, "the sizes of the compressed points");
  const std::uint64_t packed = load_as<std::uint32_t>(sizes.data()), plain = load_as<std::uint32_t>(sizes.data() + 4);
  if (header.points == 0 ? plain != 0 : plain % header.points != 0 || plain / header.points != header.stride)
    file.fail(file.place_of_byte(),
              std::to_string(plain) + " bytes of points, where the header asks for " + std::to_string(header.points) +
                  " points of " + std::to_string(header.stride) + " bytes",
              "the file is damaged: copy or record it again");
  file.require(packed, "compressed points");
  // Coordinates hardly compress. A small file that claims to become a large one must not cost memory.
  constexpr std::uint64_t any_file = std::uint64_t{8} << 20, largest_ratio = 16;
  if (plain > std::max(any_file, largest_ratio * packed))
    file.fail(file.place_of_byte(), std::to_string(packed) + " bytes that claim to unpack to " + std::to_string(plain),
              "the file is damaged: copy or record it again, or write the points as DATA binary");
  std::vector<std::byte> in(packed), out(plain);
  file.read(in, "compressed points");
  if (!lzf_decompress(in, out))
    file.fail(file.place_of_byte(), "compressed points that do not unpack to their size",
              "the file is damaged: copy or record it again");
  points.reserve(header.points);
  for (std::size_t n = 0; n < header.points; ++n)
    points.add([&](std::size_t i) {
      return load_as_double(header.types[i], out.data() + header.offsets[i] * header.points + n * header.bytes(i));
    });
}

}  // namespace detail

/// Reads a PCD file, version 0.7 or older, in any of its encodings, with each point's time as the file states it.
///
/// Fields are found by name, in any order and of any type: x y z, and where present normal_x normal_y normal_z,
/// intensity (or i, reflectivity) and t (or time, timestamp, time_stamp, offset_time). Others are skipped. Points are
/// kept as they are, NaN among them, and in float; VIEWPOINT is not applied. Sizes are checked before memory is taken.
/// Format: Rusu and Cousins 2011, the Point Cloud Library's file format.
/// @throws IoError naming line or byte: damaged header, missing field, too few points, not a number.
[[nodiscard]] inline PointFile read_pcd_file(const std::filesystem::path& path) {
  InputFile file(path);
  const detail::PcdHeader header = detail::PcdHeaderReader(file).read();
  detail::PointColumns points(header.names);
  if (!points.has_positions()) file.fail("FIELDS", "no fields x, y and z", "write the coordinates under these names");
  if (header.encoding == PcdEncoding::ascii) detail::read_pcd_ascii(file, header, points);
  if (header.encoding == PcdEncoding::binary) detail::read_pcd_binary(file, header, points);
  if (header.encoding == PcdEncoding::binary_compressed) detail::read_pcd_compressed(file, header, points);
  PointFile result = points.take();
  if (const auto time = points.time_field()) result.integer_times = detail::is_integer(header.types[*time]);
  return result;
}

/// Reads a PCD file as a cloud. Times of whole numbers are taken as nanoseconds and others as seconds from the scan's
/// stamp, as Ouster's and Velodyne's drivers write them; absolute stamps are left out. See `read_pcd_file`.
[[nodiscard]] inline PointCloud<float> read_pcd(const std::filesystem::path& path) {
  return detail::with_plain_times(read_pcd_file(path));
}

namespace detail {

/// The cloud's columns by PCD's names, in the order of the file.
inline std::vector<std::string> pcd_names(const PointCloud<float>& cloud) {
  std::vector<std::string> names{"x", "y", "z"};
  if (cloud.has_intensities()) names.emplace_back("intensity");
  if (cloud.has_normals()) names.insert(names.end(), {"normal_x", "normal_y", "normal_z"});
  if (cloud.has_times()) names.emplace_back("time");
  return names;
}

/// Point i's values in the order of `pcd_names`; gives their number.
inline std::size_t pcd_values(const PointCloud<float>& cloud, std::size_t i, std::array<float, 8>& values) {
  std::size_t n = 0;
  for (int k = 0; k < 3; ++k) values[n++] = cloud.positions[i][k];
  if (cloud.has_intensities()) values[n++] = cloud.intensities[i];
  if (cloud.has_normals())
    for (int k = 0; k < 3; ++k) values[n++] = cloud.normals[i][k];
  if (cloud.has_times()) values[n++] = cloud.time_offsets[i];
  return n;
}

inline std::string pcd_header(const PointCloud<float>& cloud, PcdEncoding encoding) {
  const std::vector<std::string> names = pcd_names(cloud);
  const auto row = [&](const std::string& keyword, const std::string& value) {
    std::string line = keyword;
    for (std::size_t i = 0; i < names.size(); ++i) line += ' ' + (value.empty() ? names[i] : value);
    return line + '\n';
  };
  const std::string size = std::to_string(cloud.size());
  constexpr std::array<const char*, 3> encodings{"ascii", "binary", "binary_compressed"};
  return "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n" + row("FIELDS", "") + row("SIZE", "4") +
         row("TYPE", "F") + row("COUNT", "1") + "WIDTH " + size + "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " +
         size + "\nDATA " + encodings[static_cast<std::size_t>(encoding)] + '\n';
}

}  // namespace detail

/// Writes a cloud as PCD 0.7, all fields as 32-bit floats: x y z and, where present, intensity, normal_x normal_y
/// normal_z and time (seconds). Text is as short as reads back the same.
/// @throws std::invalid_argument if the cloud is too large for the format; IoError if it cannot be written, the old
/// file
///   then stays.
inline void write_pcd(const FileTarget& target, const PointCloud<float>& cloud,
                      PcdEncoding encoding = PcdEncoding::binary) {
  const std::size_t count = cloud.size();
  static_cast<void>(to_index(count, "write_pcd: the number of points"));
  const std::size_t fields = detail::pcd_names(cloud).size();
  if (encoding == PcdEncoding::binary_compressed && count > std::numeric_limits<std::uint32_t>::max() / (8 * fields))
    throw std::invalid_argument("write_pcd: binary_compressed holds at most 4 GiB; use binary");
  AtomicFile file(target);
  file.write(detail::pcd_header(cloud, encoding));
  std::array<float, 8> values{};
  std::vector<std::byte> bytes;
  std::string line;
  for (std::size_t i = 0; i < count && encoding != PcdEncoding::binary_compressed; ++i) {
    bytes.clear();
    line.clear();
    const std::size_t n = detail::pcd_values(cloud, i, values);
    for (std::size_t k = 0; k < n; ++k) {
      if (encoding == PcdEncoding::binary) append_bytes(bytes, values[k]);
      if (encoding == PcdEncoding::ascii) detail::append_number(line, values[k]), line += k + 1 < n ? ' ' : '\n';
    }
    file.write(bytes);
    file.write(line);
  }
  if (encoding == PcdEncoding::binary_compressed) {
    for (std::size_t k = 0; k < fields; ++k)
      for (std::size_t i = 0; i < count; ++i) {
        detail::pcd_values(cloud, i, values);
        append_bytes(bytes, values[k]);
      }
    const std::vector<std::byte> packed = detail::lzf_compress(bytes);
    std::vector<std::byte> sizes;
    append_bytes(sizes, static_cast<std::uint32_t>(packed.size()));
    append_bytes(sizes, static_cast<std::uint32_t>(bytes.size()));
    file.write(sizes);
    file.write(packed);
  }
  file.commit();
}

}  // namespace chainslam
