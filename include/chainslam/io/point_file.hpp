#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/io/detail/scalar_type.hpp"

namespace chainslam {

/// A point file's contents: what `PointCloud` holds, and each point's time as the file states it.
struct PointFile {
  PointCloud<float> cloud;     ///< `time_offsets` empty: their unit and zero are the caller's to decide
  std::string time_field;      ///< name of the time field; empty if there is none
  bool integer_times = false;  ///< whether that field holds whole numbers
  std::vector<double> times;   ///< as stored, one for each point; 64-bit integers beyond 2^53 are rounded
};

namespace detail {

/// Gathers points whose fields come in any order and under the names that point files use.
class PointColumns {
 public:
  /// @param names  the file's fields, in its order.
  explicit PointColumns(std::span<const std::string> names) {
    for (std::size_t role = 0; role < roles; ++role)
      for (const std::string_view wanted : names_of(role))
        for (std::size_t i = 0; i < names.size() && !wanted.empty() && !field_[role]; ++i)
          if (names[i] == wanted) field_[role] = i;
    if (field_[time]) file_.time_field = names[*field_[time]];
  }

  [[nodiscard]] bool has_positions() const { return field_[x] && field_[y] && field_[z]; }
  [[nodiscard]] std::optional<std::size_t> time_field() const { return field_[time]; }

  void reserve(std::size_t count) {
    file_.cloud.positions.reserve(count);
    if (has_normals()) file_.cloud.normals.reserve(count);
    if (field_[intensity]) file_.cloud.intensities.reserve(count);
    if (field_[time]) file_.times.reserve(count);
  }

  /// Adds a point whose field i is the double `value(i)`.
  template <class Value>
  void add(const Value& value) {
    const auto as_float = [&](Role role) { return to_float(value(*field_[role])); };
    file_.cloud.positions.emplace_back(as_float(x), as_float(y), as_float(z));
    if (has_normals()) file_.cloud.normals.emplace_back(as_float(normal_x), as_float(normal_y), as_float(normal_z));
    if (field_[intensity]) file_.cloud.intensities.push_back(as_float(intensity));
    if (field_[time]) file_.times.push_back(value(*field_[time]));
  }

  [[nodiscard]] PointFile take() { return std::move(file_); }

 private:
  enum Role : std::size_t { x, y, z, normal_x, normal_y, normal_z, intensity, time, roles };

  static std::array<std::string_view, 5> names_of(std::size_t role) {
    constexpr std::array<std::array<std::string_view, 5>, roles> table{{
        {"x"},
        {"y"},
        {"z"},
        {"normal_x", "nx"},
        {"normal_y", "ny"},
        {"normal_z", "nz"},
        {"intensity", "scalar_intensity", "scalar_Intensity", "i", "reflectivity"},
        {"t", "time", "timestamp", "time_stamp", "offset_time"},
    }};
    return table[role];
  }

  [[nodiscard]] bool has_normals() const { return field_[normal_x] && field_[normal_y] && field_[normal_z]; }

  std::array<std::optional<std::size_t>, roles> field_;
  PointFile file_;
};

/// Time offsets in seconds, where the field's type and name are unambiguous: whole numbers are nanoseconds, floating
/// numbers of at most a day are seconds. Larger ones are stamps, not offsets, and give none.
inline PointCloud<float> with_plain_times(PointFile file) {
  if (file.time_field.empty()) return std::move(file.cloud);
  const double unit = file.integer_times ? 1e-9 : 1;
  std::vector<float> offsets;
  offsets.reserve(file.times.size());
  for (const double value : file.times) {
    if (!(value * unit <= 86400 && value * unit >= -86400)) return std::move(file.cloud);
    offsets.push_back(static_cast<float>(value * unit));
  }
  file.cloud.time_offsets = std::move(offsets);
  return std::move(file.cloud);
}

}  // namespace detail
}  // namespace chainslam
