#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/io/atomic_file.hpp"

namespace chainslam {

/// One point of a LAS file.
struct LasPoint {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  ///< metres, in the file's coordinate system
  double gps_time = 0;                                 ///< seconds, as `LasLayout::adjusted_standard_time` says
  std::uint16_t intensity = 0;                         ///< 0 to 65535
  std::uint16_t source = 0;                            ///< point source ID
};

/// What holds for all points of a LAS file.
struct LasLayout {
  double scale = 0.001;                              ///< metres: coordinates are whole multiples of it from `offset`
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< metres; points lie within 2^31 scales of it
  bool adjusted_standard_time = false;               ///< GPS seconds minus 1e9; else GPS week time, or a clock's own
  std::string wkt{};                                 ///< the coordinate system in OGC's WKT; empty: none is stated
  std::string software{};                            ///< the first 31 bytes are written
};

/// Number and bounds of points, which stand at the beginning of a LAS file: to be taken before the points are written.
class LasExtent {
 public:
  using Units = std::array<std::int32_t, 3>;  ///< of `LasLayout::scale`, from its offset

  explicit LasExtent(const LasLayout& layout) : layout_(layout) {}  ///< starts without positions

  /// A position as the file has it; nothing if 32 bits do not hold it.
  [[nodiscard]] std::optional<Units> units(const Eigen::Vector3d& position) const {
    Units result{};
    for (std::size_t k = 0; k < 3; ++k) {
      const auto axis = static_cast<Eigen::Index>(k);
      const double value = std::round((position[axis] - layout_.offset[axis]) / layout_.scale);
      if (!(std::abs(value) <= std::numeric_limits<std::int32_t>::max())) return std::nullopt;
      result[k] = static_cast<std::int32_t>(value);
    }
    return result;
  }

  /// Takes a point in. @returns whether 32 bits hold it.
  bool add(const Eigen::Vector3d& position) {
    const auto place = units(position);
    if (!place) return false;
    for (std::size_t k = 0; k < 3; ++k) {
      least_[k] = std::min(least_[k], (*place)[k]);
      most_[k] = std::max(most_[k], (*place)[k]);
    }
    ++points_;
    return true;
  }

  [[nodiscard]] const LasLayout& layout() const { return layout_; }                 ///< as given
  [[nodiscard]] std::uint64_t points() const { return points_; }                    ///< taken in
  [[nodiscard]] double least(std::size_t k) const { return metres(k, least_[k]); }  ///< bound on an axis; 0 if empty
  [[nodiscard]] double most(std::size_t k) const { return metres(k, most_[k]); }    ///< bound on an axis; 0 if empty

 private:
  [[nodiscard]] double metres(std::size_t k, std::int32_t units) const {
    return points_ == 0 ? 0 : units * layout_.scale + layout_.offset[static_cast<Eigen::Index>(k)];
  }

  LasLayout layout_;
  Units least_ = filled(std::numeric_limits<std::int32_t>::max());
  Units most_ = filled(std::numeric_limits<std::int32_t>::min());
  std::uint64_t points_ = 0;

  static Units filled(std::int32_t value) { return {value, value, value}; }
};

/// Writes a LAS 1.4 file of point data record format 6, point by point: no more of it is in memory than a buffer. It
/// has no date of creation, so that the same points give the same bytes.
/// Format: ASPRS, LAS specification 1.4-R15 (2019): header (table 3), variable length records (table 9), point data
/// record format 6 (tables 16, 17), coordinate systems as WKT (LASF_Projection, record 2112).
template <class System = RealFileSystem>
class LasWriter {
 public:
  /// @param extent  of all points that will be written. @throws IoError if the file cannot be made.
  LasWriter(const FileTarget& target, LasExtent extent) : extent_(std::move(extent)), file_(target) { write_header(); }

  /// @throws std::invalid_argument if 32 bits do not hold its position; IoError if the disk fails.
  void add(const LasPoint& point) {
    const auto place = extent_.units(point.position);
    if (!place) throw std::invalid_argument("LasWriter: a point too far from the offset");
    record_.clear();
    for (const std::int32_t coordinate : *place) append_bytes(record_, coordinate);
    append_bytes(record_, point.intensity);
    append_bytes(record_, std::uint8_t{0x11});  // return 1 of 1
    append_zeros(5);                            // flags, class: never classified, user data, scan angle
    append_bytes(record_, point.source);
    append_bytes(record_, point.gps_time);
    file_.write(record_);
    ++written_;
  }

  /// Gives the file its name.
  /// @throws std::invalid_argument if the extent had another number of points; IoError if the disk fails.
  void commit() {
    if (written_ != extent_.points()) throw std::invalid_argument("LasWriter: not the points of the extent");
    file_.commit();
  }

 private:
  static constexpr std::uint16_t header_bytes = 375, record_bytes = 30;

  void append_zeros(std::size_t count) { record_.insert(record_.end(), count, std::byte{0}); }
  /// Text in a field of so many bytes, of which the last is 0.
  void append_text(std::string_view text, std::size_t field) {
    text = text.substr(0, field - 1);
    for (const char c : text) record_.push_back(static_cast<std::byte>(c));
    append_zeros(field - text.size());
  }

  void write_header() {
    const LasLayout& layout = extent_.layout();
    const std::size_t wkt_bytes = layout.wkt.empty() ? 0 : layout.wkt.size() + 1;
    const auto encoding = static_cast<std::uint16_t>((layout.adjusted_standard_time ? 1 : 0) | 16);  // bit 4: WKT
    append_text("LASF", 5);
    record_.pop_back();
    append_bytes(record_, std::uint16_t{0});  // file source ID
    append_bytes(record_, encoding);
    append_zeros(16);  // project ID
    append_bytes(record_, std::uint8_t{1});
    append_bytes(record_, std::uint8_t{4});
    append_text("OTHER", 32);
    append_text(layout.software, 32);
    append_zeros(4);  // day and year of creation
    append_bytes(record_, header_bytes);
    append_bytes(record_, static_cast<std::uint32_t>(header_bytes + (wkt_bytes > 0 ? 54 + wkt_bytes : 0)));
    append_bytes(record_, std::uint32_t{wkt_bytes > 0 ? 1U : 0U});
    append_bytes(record_, std::uint8_t{6});
    append_bytes(record_, record_bytes);
    append_zeros(24);  // legacy numbers of points: 0 in this format
    for (int k = 0; k < 3; ++k) append_bytes(record_, layout.scale);
    for (int k = 0; k < 3; ++k) append_bytes(record_, double{layout.offset[k]});
    for (std::size_t k = 0; k < 3; ++k) {
      append_bytes(record_, extent_.most(k));
      append_bytes(record_, extent_.least(k));
    }
    append_zeros(20);  // waveforms and extended records: none
    append_bytes(record_, extent_.points());
    append_bytes(record_, extent_.points());  // of the first return
    append_zeros(14 * sizeof(std::uint64_t));
    if (wkt_bytes > 0) {
      append_zeros(2);
      append_text("LASF_Projection", 16);
      append_bytes(record_, std::uint16_t{2112});
      append_bytes(record_, static_cast<std::uint16_t>(wkt_bytes));
      append_text("OGC coordinate system WKT", 32);
      append_text(layout.wkt, wkt_bytes);
    }
    file_.write(record_);
  }

  LasExtent extent_;
  BasicAtomicFile<System> file_;
  std::vector<std::byte> record_;
  std::uint64_t written_ = 0;
};

}  // namespace chainslam
