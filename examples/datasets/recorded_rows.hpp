#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "chainslam/io/line_fields.hpp"
#include "chainslam/map/frame_record.hpp"
#include "chainslam/sensor/gnss_fix.hpp"

namespace chainslam::datasets {

/// A row of a recording's frames.csv.
struct FrameRow {
  FrameRecord frame{};
  std::int64_t keyframe = -1;  ///< its number; -1: none
};

/// A row of a recording's fixes.csv.
struct FixRow {
  GnssFix fix{};
  std::int64_t frames_before = 0;
};

/// The last columns of `frame_table_head`, which recordings of earlier versions do not have.
inline constexpr std::string_view delta_velocity_columns = ",dv_x,dv_y,dv_z";

[[nodiscard]] std::string frame_table_head();
[[nodiscard]] std::string fix_table_head();
[[nodiscard]] std::string text_of(const FrameRow& row);
[[nodiscard]] std::string text_of(const FixRow& row);

/// @throws IoError naming line and field.
/// @{
[[nodiscard]] FrameRow read_frame_row(LineFields& fields);
[[nodiscard]] FixRow read_fix_row(LineFields& fields);
/// @}

}  // namespace chainslam::datasets
