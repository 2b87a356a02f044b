#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "datasets/ros_message.hpp"

namespace chainslam::datasets {

/// A topic of a recording.
struct RosTopic {
  std::string name;
  std::string type;  ///< as the recording names it
  MessageEncoding encoding = MessageEncoding::ros1;
};

/// A message as it was recorded; its bytes are valid until the next one is read.
struct RosMessage {
  const RosTopic* topic = nullptr;
  Timestamp time;  ///< of the recording, not of the measurement
  std::span<const std::byte> data;
  std::string_view unit;  ///< what `at` counts: "byte" or "row"
  std::uint64_t at = 0;   ///< of the message or of the chunk that holds it
};

/// A recording of ROS messages, read once from its start to its end in the order of its file.
///
/// Damage costs what is damaged, not what is whole: a chunk that cannot be unpacked is passed over, and where the file
/// ends too early, or its records cannot be told apart any more, the recording ends.
class RosRecording {
 public:
  RosRecording() = default;
  RosRecording(const RosRecording&) = delete;
  RosRecording& operator=(const RosRecording&) = delete;
  virtual ~RosRecording() = default;

  /// The next message. @throws IoError if the file cannot be read on; damage is no such case.
  [[nodiscard]] virtual std::optional<RosMessage> next() = 0;

  /// What could not be read so far, with its place, a sentence each.
  [[nodiscard]] const std::vector<std::string>& losses() const { return losses_; }

 protected:
  void lose(std::string sentence) {
    constexpr std::size_t most = 20;
    if (losses_.size() < most) losses_.push_back(std::move(sentence));
  }

 private:
  std::vector<std::string> losses_;
};

/// Openers of each kind of file. @throws IoError if the file is of another kind.
/// @{
[[nodiscard]] std::unique_ptr<RosRecording> open_ros1_bag(const std::filesystem::path& path);
[[nodiscard]] std::unique_ptr<RosRecording> open_mcap(const std::filesystem::path& path);
[[nodiscard]] std::unique_ptr<RosRecording> open_db3(const std::filesystem::path& path);  ///< rosbag2's SQLite
/// @}

/// The recording's files: the file itself, or a folder's files of one kind, in the order of the numbers in their names.
/// Empty if there are none.
[[nodiscard]] std::vector<std::filesystem::path> recording_files(const std::filesystem::path& path);

/// Opens a file by its extension: .bag, .mcap or .db3.
[[nodiscard]] std::unique_ptr<RosRecording> open_recording(const std::filesystem::path& file);

}  // namespace chainslam::datasets
