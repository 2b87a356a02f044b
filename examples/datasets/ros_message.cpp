#include "datasets/ros_message.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "chainslam/core/types.hpp"
#include "chainslam/io/detail/scalar_type.hpp"

namespace chainslam::datasets {
namespace {

using detail::ScalarType;

constexpr std::size_t most_fields = 256;
constexpr std::size_t most_points = std::size_t{1} << 22;  ///< of a scan: eight times what the largest LiDARs send

/// sensor_msgs/PointField: one column of a PointCloud2.
struct PointField {
  std::string name;
  std::size_t offset = 0;
  ScalarType type = ScalarType::float32;
};

std::optional<ScalarType> type_of(std::uint8_t datatype) {
  constexpr std::array<ScalarType, 8> types{ScalarType::int8,    ScalarType::uint8,  ScalarType::int16,
                                            ScalarType::uint16,  ScalarType::int32,  ScalarType::uint32,
                                            ScalarType::float32, ScalarType::float64};
  if (datatype < 1 || datatype > types.size()) return std::nullopt;
  return types[datatype - 1U];
}

std::string text_of_fields(const std::vector<PointField>& fields) {
  constexpr std::array<const char*, 10> names{"i8", "u8", "i16", "u16", "i32", "u32", "i64", "u64", "f32", "f64"};
  std::string text;
  for (const PointField& field : fields)
    text += (text.empty() ? "" : ", ") + field.name + ' ' + names[static_cast<std::size_t>(field.type)];
  return text;
}

std::vector<PointField> read_fields(MessageReader& message) {
  const std::uint32_t count = message.count(9, "fields");
  if (count > most_fields)
    throw MessageError(std::to_string(count) + " fields; " + std::to_string(most_fields) + " are the most");
  std::vector<PointField> fields(count);
  for (PointField& field : fields) {
    field.name = message.text("fields.name");
    field.offset = message.number<std::uint32_t>("fields.offset");
    const auto datatype = message.number<std::uint8_t>("fields.datatype");
    const auto type = type_of(datatype);
    if (!type) throw MessageError("field " + field.name + " of the unknown datatype " + std::to_string(datatype));
    field.type = *type;
    static_cast<void>(message.number<std::uint32_t>("fields.count"));  // we read the first of several
  }
  return fields;
}

/// Where a PointCloud2's points lie in its data.
struct PointGrid {
  std::size_t rows = 0, columns = 0, point_step = 0, row_step = 0;
};

/// @throws MessageError if they lie elsewhere. A grid without points then has no rows either, however many it stated.
void check(PointGrid& grid, const std::vector<PointField>& fields, std::size_t size) {
  for (const PointField& field : fields)
    if (field.offset + detail::size_of(field.type) > grid.point_step)
      throw MessageError("field " + field.name + " at byte " + std::to_string(field.offset) + " of points of " +
                         std::to_string(grid.point_step) + " bytes");
  if (grid.rows == 0 || grid.columns == 0) {
    grid.rows = grid.columns = 0;
    return;
  }
  // The factors are below 2^32, the products below 2^64; rows that overlap would make many points of few bytes.
  const std::size_t row = grid.columns * grid.point_step;
  const bool fits = grid.point_step > 0 && row <= size && (grid.rows == 1 || grid.row_step >= row) &&
                    (grid.rows == 1 || (size - row) / grid.row_step >= grid.rows - 1);
  if (!fits)
    throw MessageError(std::to_string(size) + " bytes of points for " + std::to_string(grid.rows) + " rows of " +
                       std::to_string(grid.columns) + " points of " + std::to_string(grid.point_step) + " bytes");
  if (grid.columns > most_points / grid.rows)  // fields may share bytes, so that points take more than their message
    throw MessageError(std::to_string(grid.rows) + " rows of " + std::to_string(grid.columns) +
                       " points; 2^22 points are the most");
}

/// A Livox's tag: bits 4 and 5 say how sure the point is; 0 and 1 are good (Livox SDK, point tag).
bool is_noise(std::uint8_t tag) { return (tag & 0x30U) > 0x10U; }

/// A livox_ros_driver2's PointCloud2 has the fields `tag` and `line`.
const PointField* find_livox_tag(const std::vector<PointField>& fields) {
  const auto find = [&](const char* name) {
    return std::ranges::find_if(fields, [&](const PointField& field) { return field.name == name; });
  };
  const auto tag = find("tag");
  return tag != fields.end() && tag->type == ScalarType::uint8 && find("line") != fields.end() ? &*tag : nullptr;
}

}  // namespace

MessageReader::MessageReader(std::span<const std::byte> bytes, MessageEncoding encoding)
    : bytes_(bytes), encoding_(encoding) {
  if (encoding == MessageEncoding::ros1) return;
  const auto encapsulation = load_as<std::uint16_t>(take(4, "encapsulation").data(), std::endian::big);
  if (encapsulation > 1)
    throw MessageError("encapsulation " + std::to_string(encapsulation) + "; plain CDR, 0 or 1, is read");
  order_ = encapsulation == 1 ? std::endian::little : std::endian::big;
  bytes_ = bytes.subspan(4);  // alignment counts from here
  at_ = 0;
}

RosHeader read_header(MessageReader& message) {
  if (message.encoding() == MessageEncoding::ros1) static_cast<void>(message.number<std::uint32_t>("header.seq"));
  const auto seconds = static_cast<std::int64_t>(message.number<std::uint32_t>("header.stamp"));
  const auto nanoseconds = static_cast<std::int64_t>(message.number<std::uint32_t>("header.stamp"));
  if (nanoseconds >= 1'000'000'000) throw MessageError("a stamp of " + std::to_string(nanoseconds) + " ns in a second");
  return {Timestamp::from_nanoseconds(seconds * 1'000'000'000 + nanoseconds), message.text("header.frame_id")};
}

std::span<const std::byte> MessageReader::take(std::size_t size, const char* field) {
  if (size > left())
    throw MessageError("the message ends after " + std::to_string(left()) + " of " + std::to_string(size) +
                       " bytes of " + field);
  const auto part = bytes_.subspan(at_, size);
  at_ += size;
  return part;
}

std::string MessageReader::text(const char* field) {
  const auto bytes = take(number<std::uint32_t>(field), field);
  std::string text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (encoding_ == MessageEncoding::cdr && text.ends_with('\0')) text.pop_back();
  return text;
}

std::uint32_t MessageReader::count(std::size_t least, const char* field) {
  const auto count = number<std::uint32_t>(field);
  if (count > left() / least)
    throw MessageError("the message promises " + std::to_string(count) + " " + field + " in its last " +
                       std::to_string(left()) + " bytes");
  return count;
}

MessageKind kind_of_message(std::string_view type) {
  const std::string_view package = type.substr(0, type.find('/'));
  const std::string_view name = type.substr(type.rfind('/') + 1);
  if (package == "sensor_msgs") {
    if (name == "PointCloud2") return MessageKind::cloud;
    if (name == "Imu") return MessageKind::imu;
    if (name == "NavSatFix") return MessageKind::fix;
  }
  if ((package == "tf2_msgs" && name == "TFMessage") || (package == "tf" && name == "tfMessage"))
    return MessageKind::transforms;
  if (name == "CustomMsg" && package.starts_with("livox")) return MessageKind::livox;
  for (const char* raw : {"VelodyneScan", "PacketMsg", "RslidarScan", "rslidarScan", "RslidarPacket", "HesaiScan",
                          "PandarScan", "UdpFrame"})
    if (name == raw) return MessageKind::raw_packets;
  return MessageKind::other;
}

RosCloud decode_point_cloud2(MessageReader message) {
  RosCloud cloud;
  cloud.header = read_header(message);
  PointGrid grid;
  grid.rows = message.number<std::uint32_t>("height");
  grid.columns = message.number<std::uint32_t>("width");
  const std::vector<PointField> fields = read_fields(message);
  cloud.fields = text_of_fields(fields);
  const std::endian order = message.number<std::uint8_t>("is_bigendian") != 0 ? std::endian::big : std::endian::little;
  grid.point_step = message.number<std::uint32_t>("point_step");
  grid.row_step = message.number<std::uint32_t>("row_step");
  const auto data = message.take(message.count(1, "data"), "data");
  check(grid, fields, data.size());

  std::vector<std::string> names;
  for (const PointField& field : fields) names.push_back(field.name);
  detail::PointColumns points(names);
  if (!points.has_positions()) throw MessageError("no fields x, y and z among: " + cloud.fields);
  const PointField* tag = find_livox_tag(fields);
  points.reserve(grid.rows * grid.columns);
  for (std::size_t row = 0; row < grid.rows; ++row)
    for (std::size_t column = 0; column < grid.columns; ++column) {
      const std::byte* point = data.data() + row * grid.row_step + column * grid.point_step;
      if (tag != nullptr && is_noise(load_as<std::uint8_t>(point + tag->offset))) {
        ++cloud.noise;
        continue;
      }
      points.add([&](std::size_t i) { return load_as_double(fields[i].type, point + fields[i].offset, order); });
    }
  const auto time = points.time_field();
  cloud.points = points.take();
  cloud.points.integer_times = time && is_integer(fields[*time].type);
  return cloud;
}

RosCloud decode_livox(MessageReader message) {
  RosCloud cloud;
  cloud.header = read_header(message);
  const auto timebase = message.number<std::uint64_t>("timebase");
  static_cast<void>(message.number<std::uint32_t>("point_num"));  // the sequence states its length itself
  static_cast<void>(message.take(4, "lidar_id"));                 // and three bytes reserved
  const std::uint32_t count = message.count(19, "points");
  cloud.fields = "offset_time u32, x f32, y f32, z f32, reflectivity u8, tag u8, line u8";
  cloud.points.time_field = "offset_time";
  cloud.points.integer_times = true;
  for (std::uint32_t i = 0; i < count; ++i) {
    const auto offset = message.number<std::uint32_t>("points.offset_time");
    Eigen::Vector3f position;
    for (int k = 0; k < 3; ++k) position[k] = message.number<float>("points.x");
    const auto reflectivity = message.number<std::uint8_t>("points.reflectivity");
    const auto tag = message.number<std::uint8_t>("points.tag");
    static_cast<void>(message.number<std::uint8_t>("points.line"));
    if (is_noise(tag)) {
      ++cloud.noise;
      continue;
    }
    cloud.points.cloud.positions.push_back(position);
    cloud.points.cloud.intensities.push_back(static_cast<float>(reflectivity));
    cloud.points.times.push_back(static_cast<double>(offset));
  }
  cloud.rule = PointTimeRule{.unit = TimeUnit::nanoseconds};
  // Offsets count from the time base. A sensor without time synchronization counts that from its start, not from 1970.
  constexpr double tolerance = 1e9;
  const double difference = static_cast<double>(timebase) - static_cast<double>(cloud.header.stamp.nanoseconds());
  if (std::abs(difference) <= tolerance)
    cloud.header.stamp = Timestamp::from_nanoseconds(static_cast<std::int64_t>(timebase));
  else
    cloud.clock_difference = Duration(static_cast<std::int64_t>(std::clamp(difference, -9e18, 9e18)));
  return cloud;
}

RosImu decode_imu(MessageReader message) {
  RosImu imu;
  imu.header = read_header(message);
  static_cast<void>(message.doubles<13>("orientation"));  // quaternion and covariance
  const auto rate = message.doubles<3>("angular_velocity");
  static_cast<void>(message.doubles<9>("angular_velocity_covariance"));
  const auto force = message.doubles<3>("linear_acceleration");
  imu.sample = {.time = imu.header.stamp, .gyro = {rate[0], rate[1], rate[2]}, .accel = {force[0], force[1], force[2]}};
  return imu;
}

RosFix decode_fix(MessageReader message) {
  RosFix fix;
  fix.header = read_header(message);
  fix.status = message.number<std::int8_t>("status.status");
  static_cast<void>(message.number<std::uint16_t>("status.service"));
  const auto position = message.doubles<3>("latitude, longitude, altitude");
  fix.position = {.latitude_deg = position[0], .longitude_deg = position[1], .altitude = position[2]};
  const auto covariance = message.doubles<9>("position_covariance");
  const bool known = message.number<std::uint8_t>("position_covariance_type") != 0;
  const double horizontal = 0.5 * (covariance[0] + covariance[4]);
  if (known && horizontal > 0 && is_finite(horizontal) && covariance[8] > 0 && is_finite(covariance[8]))
    fix.deviation = GnssDeviation{.horizontal = std::sqrt(horizontal), .vertical = std::sqrt(covariance[8])};
  return fix;
}

}  // namespace chainslam::datasets
