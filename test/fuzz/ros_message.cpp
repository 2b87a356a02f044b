#include "datasets/ros_message.hpp"
#include <span>

#include "datasets/ros_bytes.hpp"
#include "datasets/transform_tree.hpp"

// A recording's chunks hide their messages from what mutates bytes. Here the input says which message is made, and
// which of its bytes are then overwritten: a byte that chooses, then an offset of two bytes and a value each.

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace chainslam;
  using test::MessageBytes;
  if (size == 0) return 0;
  const auto layout = static_cast<MessageBytes::Layout>(data[0] % 3);
  const int kind = data[0] / 3 % 5;
  std::string bytes = kind == 0   ? test::velodyne_cloud(layout, 1, 2)
                      : kind == 1 ? test::livox_message(layout, 1, 1'000'000'000)
                      : kind == 2 ? test::imu_message(layout, 1, 2)
                      : kind == 3
                          ? test::fix_message(layout, 1)
                          : test::transform_message(layout, {{"base", "lidar", {1, 2, 3}}, {"base", "imu", {0, 0, 1}}});
  for (std::size_t i = 1; i + 2 < size; i += 3)
    bytes[(data[i] + std::size_t{256} * data[i + 1]) % bytes.size()] = static_cast<char>(data[i + 2]);
  if (size % 3 == 2) bytes.resize(bytes.size() * data[size - 1] / 255);  // and cut
  try {
    const datasets::MessageReader reader(std::as_bytes(std::span(bytes)), layout == MessageBytes::ros1
                                                                              ? datasets::MessageEncoding::ros1
                                                                              : datasets::MessageEncoding::cdr);
    datasets::TransformTree tree;
    if (kind == 0) static_cast<void>(datasets::decode_point_cloud2(reader));
    if (kind == 1) static_cast<void>(datasets::decode_livox(reader));
    if (kind == 2) static_cast<void>(datasets::decode_imu(reader));
    if (kind == 3) static_cast<void>(datasets::decode_fix(reader));
    if (kind == 4) tree.add(reader);
    static_cast<void>(tree.between("imu", "lidar"));
  } catch (const datasets::MessageError&) {
  }
  return 0;
}
