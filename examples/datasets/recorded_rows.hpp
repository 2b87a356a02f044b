#pragma once

#include <cstdint>
#include <string>

#include "chainslam/io/input_file.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/packet.hpp"

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

[[nodiscard]] std::string frame_table_head();
/// That of earlier versions, which did not record `FrameRecord::delta_velocity`.
[[nodiscard]] std::string earlier_frame_table_head();
[[nodiscard]] std::string fix_table_head();
[[nodiscard]] std::string text_of(const FrameRow& row);
[[nodiscard]] std::string text_of(const FixRow& row);

/// @throws IoError naming line and field.
/// @{
[[nodiscard]] FrameRow read_frame_row(LineFields& fields);
[[nodiscard]] FrameRow read_earlier_frame_row(LineFields& fields);
[[nodiscard]] FixRow read_fix_row(LineFields& fields);
/// @}

}  // namespace chainslam::datasets
