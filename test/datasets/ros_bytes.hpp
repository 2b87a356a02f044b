#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "datasets/dataset.hpp"
#include "support/files.hpp"

namespace chainslam::test {

/// A ROS message's bytes, made field by field as its definition says: packed for ROS 1, or CDR with its encapsulation.
class MessageBytes {
 public:
  enum Layout { ros1, cdr_little, cdr_big };
  explicit MessageBytes(Layout layout) : layout_(layout) {}

  template <class T>
  MessageBytes& operator<<(T value) {
    while (layout_ != ros1 && bytes_.size() % sizeof(T) != 0) bytes_ += '\0';
    bytes_ += layout_ == cdr_big ? big(value) : little(value);
    return *this;
  }
  MessageBytes& operator<<(const std::string& text) {
    const std::string ended = layout_ == ros1 ? text : text + '\0';
    *this << static_cast<std::uint32_t>(ended.size());
    bytes_ += ended;
    return *this;
  }
  MessageBytes& operator<<(const char* text) { return *this << std::string(text); }
  MessageBytes& raw(const std::string& data) {
    bytes_ += data;
    return *this;
  }

  /// std_msgs/Header; only ROS 1's has a sequence number.
  MessageBytes& header(std::uint32_t seconds, std::uint32_t nanoseconds, const char* frame) {
    if (layout_ == ros1) *this << std::uint32_t{17};
    return *this << seconds << nanoseconds << frame;
  }

  [[nodiscard]] bool is_ros1() const { return layout_ == ros1; }
  [[nodiscard]] std::string str() const {
    if (layout_ == ros1) return bytes_;
    return std::string(1, '\0') + (layout_ == cdr_little ? '\1' : '\0') + std::string(2, '\0') + bytes_;
  }

 private:
  Layout layout_;
  std::string bytes_;
};

struct FieldOf {
  const char* name;
  std::uint32_t offset;
  std::uint8_t datatype;  ///< 2 u8, 4 u16, 6 u32, 7 f32, 8 f64
};

/// sensor_msgs/PointCloud2 of so many points in one row.
inline std::string point_cloud2(MessageBytes::Layout layout, std::uint32_t seconds, std::uint32_t nanoseconds,
                                const std::vector<FieldOf>& fields, std::uint32_t point_step, const std::string& data) {
  MessageBytes message(layout);
  const auto points = static_cast<std::uint32_t>(data.size() / point_step);
  message.header(seconds, nanoseconds, "lidar")
      << std::uint32_t{1} << points << static_cast<std::uint32_t>(fields.size());
  for (const FieldOf& field : fields) message << field.name << field.offset << field.datatype << std::uint32_t{1};
  message << std::uint8_t{0} << point_step << static_cast<std::uint32_t>(data.size());  // is_bigendian, row_step
  message << static_cast<std::uint32_t>(data.size());
  return message.raw(data).raw("\1").str();
}

/// Eleven points x y z intensity ring time of 22 bytes, 10 ms apart, as Velodyne's driver packs them.
inline std::string velodyne_cloud(MessageBytes::Layout layout, std::uint32_t seconds, std::uint32_t nanoseconds) {
  std::string data;
  for (int i = 0; i < 11; ++i)
    data += little(static_cast<float>(i)) + little(2.0F) + little(-1.5F) + little(static_cast<float>(10 * i)) +
            little(static_cast<std::uint16_t>(i)) + little(0.01F * static_cast<float>(i));
  return point_cloud2(layout, seconds, nanoseconds,
                      {{"x", 0, 7}, {"y", 4, 7}, {"z", 8, 7}, {"intensity", 12, 7}, {"ring", 16, 4}, {"time", 18, 7}},
                      22, data);
}

/// sensor_msgs/Imu: level, at rest, turning by 0.25 rad/s about z.
inline std::string imu_message(MessageBytes::Layout layout, std::uint32_t seconds, std::uint32_t nanoseconds,
                               double gravity = 9.75) {
  MessageBytes message(layout);
  message.header(seconds, nanoseconds, "imu");
  for (const double value : {0.0, 0.0, 0.0, 1.0}) message << value;  // orientation
  for (int i = 0; i < 9; ++i) message << 0.5;
  for (const double value : {0.0, 0.0, 0.25}) message << value;
  for (int i = 0; i < 9; ++i) message << 0.5;
  for (const double value : {0.0, 0.0, gravity}) message << value;
  for (int i = 0; i < 9; ++i) message << 0.5;
  return message.str();
}

/// sensor_msgs/NavSatFix with a deviation of 0.5 m along the ground and 2 m upwards.
inline std::string fix_message(MessageBytes::Layout layout, std::uint32_t seconds, int status = 0,
                               double latitude = 42.293) {
  MessageBytes message(layout);
  message.header(seconds, 0, "gps") << static_cast<std::int8_t>(status) << std::uint16_t{1};
  for (const double value : {latitude, -83.709, 270.0}) message << value;
  for (int i = 0; i < 9; ++i) message << (i == 8 ? 4.0 : i % 4 == 0 ? 0.25 : 0.0);
  message << std::uint8_t{2};
  return message.str();
}

/// livox_ros_driver/CustomMsg: eleven points 10 ms apart, of which the one in the middle is noise by its tag.
inline std::string livox_message(MessageBytes::Layout layout, std::uint32_t seconds, std::uint64_t timebase) {
  MessageBytes message(layout);
  message.header(seconds, 0, "livox_frame") << timebase << std::uint32_t{11} << std::uint8_t{1};
  message.raw(std::string(3, '\0')) << std::uint32_t{11};
  for (std::uint32_t i = 0; i < 11; ++i)
    message << 10'000'000 * i << static_cast<float>(i) << 2.0F << 3.0F << static_cast<std::uint8_t>(10 * i)
            << static_cast<std::uint8_t>(i == 5 ? 0x20 : 0x10) << std::uint8_t{1};
  return message.str();
}

/// Where one frame sits in another, not turned but by half a turn about z if `turned`.
struct TransformOf {
  const char* parent;
  const char* child;
  std::array<double, 3> translation;
  bool turned = false;
};

/// tf2_msgs/TFMessage.
inline std::string transform_message(MessageBytes::Layout layout, const std::vector<TransformOf>& transforms) {
  MessageBytes message(layout);
  message << static_cast<std::uint32_t>(transforms.size());
  for (const TransformOf& one : transforms) {
    message.header(5, 6, one.parent) << one.child;
    for (const double value : one.translation) message << value;
    for (const double value : {0.0, 0.0, one.turned ? 1.0 : 0.0, one.turned ? 0.0 : 1.0}) message << value;
  }
  return message.str();
}

/// An LZ4 frame of one stored block (LZ4 frame format 1.6.2): 0x82 is its descriptor's checksum.
inline std::string lz4_frame(const std::string& bytes) {
  return std::string("\x04\x22\x4D\x18\x60\x40\x82", 7) +
         little(static_cast<std::uint32_t>(bytes.size()) | 0x80000000U) + bytes + little(std::uint32_t{0});
}

inline std::vector<Packet> packets_of(datasets::Dataset& dataset) {
  std::vector<Packet> packets;
  while (auto packet = dataset.next()) packets.push_back(std::move(*packet));
  return packets;
}

inline std::array<int, 3> counts_of(const std::vector<Packet>& packets) {
  std::array<int, 3> counts{};
  for (const Packet& packet : packets) ++counts[packet.index()];
  return counts;
}

inline bool any_says(const std::vector<std::string>& sentences, const std::string& part) {
  return std::ranges::any_of(sentences, [&](const std::string& sentence) { return says(sentence, part); });
}

}  // namespace chainslam::test
