#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/io/point_file.hpp"
#include "chainslam/sensor/packet.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/point_time.hpp"

namespace chainslam::datasets {

/// How a message is laid out: ROS 1's packed little-endian fields, or ROS 2's CDR, whose numbers stand at multiples of
/// their size behind an encapsulation header of four bytes.
enum class MessageEncoding { ros1, cdr };

/// A message that is not what its type promises; the text says what was found.
struct MessageError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Reads a message's fields one after the other. Lengths are checked against what is left before memory is taken.
class MessageReader {
 public:
  /// @throws MessageError if a CDR message states another encapsulation than plain CDR.
  MessageReader(std::span<const std::byte> bytes, MessageEncoding encoding);

  /// The next number. @throws MessageError if the message ends before.
  template <class T>
  [[nodiscard]] T number(const char* field) {
    if (encoding_ == MessageEncoding::cdr) at_ += (sizeof(T) - at_ % sizeof(T)) % sizeof(T);
    return load_as<T>(take(sizeof(T), field).data(), order_);
  }
  template <std::size_t Count>
  [[nodiscard]] std::array<double, Count> doubles(const char* field) {
    std::array<double, Count> values{};
    for (double& value : values) value = number<double>(field);
    return values;
  }
  [[nodiscard]] std::string text(const char* field);
  /// The number of a sequence's elements, of which each takes `least` bytes or more.
  [[nodiscard]] std::uint32_t count(std::size_t least, const char* field);
  [[nodiscard]] std::span<const std::byte> take(std::size_t size, const char* field);
  [[nodiscard]] std::size_t left() const { return at_ < bytes_.size() ? bytes_.size() - at_ : 0; }  ///< bytes
  [[nodiscard]] MessageEncoding encoding() const { return encoding_; }

 private:
  std::span<const std::byte> bytes_;
  std::size_t at_ = 0;
  MessageEncoding encoding_;
  std::endian order_ = std::endian::little;
};

/// std_msgs/Header: when and in which frame a message was measured.
struct RosHeader {
  Timestamp stamp;
  std::string frame;
};

/// Reads a header, with which most messages begin. @throws MessageError if it is cut short or its stamp is none.
[[nodiscard]] RosHeader read_header(MessageReader& message);

/// A scan as its driver sent it.
struct RosCloud {
  RosHeader header;
  PointFile points;                            ///< `times` as stated
  std::string fields;                          ///< "x f32, y f32, ..., t u32"
  std::optional<PointTimeRule> rule{};         ///< where the message's type leaves no doubt
  std::size_t noise = 0;                       ///< points left out, as the sensor itself marks them as noise
  std::optional<Duration> clock_difference{};  ///< of the sensor's own clock from the stamp, where it was not believed
};

struct RosImu {
  RosHeader header;
  ImuSample sample;  ///< in the message's own units, which should be rad/s and m/s^2
};

struct RosFix {
  RosHeader header;
  int status = -1;  ///< -1 none, 0 plain, 1 satellite based, 2 ground based augmentation
  GeodeticPosition position;
  std::optional<GnssDeviation> deviation;  ///< if the message states one
};

/// What we can do with messages of a type.
enum class MessageKind { other, raw_packets, transforms, cloud, livox, imu, fix };

/// By the type's name, as ROS 1 or ROS 2 writes it: `sensor_msgs/Imu` or `sensor_msgs/msg/Imu`.
[[nodiscard]] MessageKind kind_of_message(std::string_view type);

/// Decoders of the messages, for both encodings.
///
/// Points are found by the names of their fields (see `detail::PointColumns`). Points that a Livox marks as noise, by
/// bits 4 and 5 of its tag, are left out.
/// @throws MessageError if the message is cut short or its sizes do not fit together.
/// @{
[[nodiscard]] RosCloud decode_point_cloud2(MessageReader message);
[[nodiscard]] RosCloud decode_livox(MessageReader message);  ///< CustomMsg of the drivers 1 and 2
[[nodiscard]] RosImu decode_imu(MessageReader message);
[[nodiscard]] RosFix decode_fix(MessageReader message);
/// @}

}  // namespace chainslam::datasets
