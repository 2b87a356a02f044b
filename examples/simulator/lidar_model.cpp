#include "simulator/lidar_model.hpp"

#include <algorithm>
#include <array>
#include <chrono>

namespace chainslam::simulator {

namespace {

using std::chrono::nanoseconds;

LidarModel numbered(LidarModel model) {
  for (LidarChannel& channel : model.channels)
    channel.ring = static_cast<std::uint8_t>(std::ranges::count_if(
        model.channels, [&](const LidarChannel& other) { return other.elevation_deg < channel.elevation_deg; }));
  return model;
}

LidarModel hdl_32e() {
  LidarModel model{.name = "HDL-32E",
                   .channels = {},
                   .firings_per_revolution = 2160,  // 2170 at a true 10 Hz; whole packets here
                   .firings_per_packet = 12,
                   .range_of_tenth = 100.0};
  // Even lasers from the lowest up, odd ones from the middle up.
  constexpr double spacing = 4.0 / 3.0;
  for (Index laser = 0; laser < 32; ++laser) {
    const double lowest = laser % 2 == 0 ? -92.0 / 3.0 : -28.0 / 3.0;
    model.channels.push_back({lowest + spacing * (laser / 2), 0.0, nanoseconds(laser * 1152), 0});
  }
  return numbered(std::move(model));
}

LidarModel vlp_16() {
  LidarModel model{.name = "VLP-16",
                   .channels = {},
                   .firings_per_revolution = 1800,  // 1808 at a true 10 Hz
                   .firings_per_packet = 24,
                   .range_of_tenth = 60.0};
  for (Index laser = 0; laser < 16; ++laser)
    model.channels.push_back({laser % 2 == 0 ? -15.0 + laser : laser, 0.0, nanoseconds(laser * 2304), 0});
  return numbered(std::move(model));
}

LidarModel os1_64() {
  LidarModel model{.name = "OS1-64",
                   .channels = {},
                   .firings_per_revolution = 1024,
                   .firings_per_packet = 16,
                   .range_of_tenth = 60.0};
  constexpr std::array offsets{3.164, 1.055, -1.055, -3.164};
  for (Index pixel = 0; pixel < 64; ++pixel)
    model.channels.push_back(
        {16.611 - pixel * (2.0 * 16.611 / 63.0), offsets[static_cast<std::size_t>(pixel % 4)], Duration(0), 0});
  return numbered(std::move(model));
}

LidarModel vls_128() {
  static constexpr std::array elevations{
      -11.742, -1.99, 3.4,   -5.29,  -0.78, 4.61,  -4.08, 1.31,    -6.5,  -1.11,   4.28,   -4.41, 0.1,     6.48,  -3.2,
      2.19,    -3.86, 1.53,  -9.244, -1.77, 2.74,  -5.95, -0.56,   4.83,  -2.98,   2.41,   -6.28, -0.89,   3.62,  -5.07,
      0.32,    7.58,  -0.34, 5.18,   -3.64, 1.75,  -25.0, -2.43,   2.96,  -5.73,   0.54,   9.7,   -2.76,   2.63,  -7.65,
      -1.55,   3.84,  -4.85, 3.18,   -5.51, -0.12, 5.73,  -4.3,    1.09,  -16.042, -2.21,  4.06,  -4.63,   0.76,  15.0,
      -3.42,   1.97,  -6.85, -1.33,  -5.62, -0.23, 5.43,  -3.53,   0.98,  -19.582, -2.32,  3.07,  -4.74,   0.65,  11.75,
      -2.65,   1.86,  -7.15, -1.44,  3.95,  -2.1,  3.29,  -5.4,    -0.01, 4.5,     -4.19,  1.2,   -13.565, -1.22, 4.17,
      -4.52,   0.87,  6.08,  -3.31,  2.08,  -6.65, 1.42,  -10.346, -1.88, 3.51,    -6.06,  -0.67, 4.72,    -3.97, 2.3,
      -6.39,   -1.0,  4.39,  -5.18,  0.21,  6.98,  -3.09, 4.98,    -3.75, 1.64,    -8.352, -2.54, 2.85,    -5.84, -0.45,
      8.43,    -2.87, 2.52,  -6.17,  -1.66, 3.73,  -4.96, 0.43};
  static constexpr std::array offsets{-6.354, -4.548, -2.732, -0.911, 0.911, 2.732, 4.548, 6.354};
  static_assert(elevations.size() == 128);
  LidarModel model{.name = "VLS-128",
                   .channels = {},
                   .firings_per_revolution = 1875,  // 1876.2 in a tenth of a second
                   .firings_per_packet = 3,
                   .range_of_tenth = 220.0};
  for (std::size_t laser = 0; laser < elevations.size(); ++laser) {
    const auto group = static_cast<Index>(laser / 8);
    model.channels.push_back({elevations[laser], offsets[laser % 8], nanoseconds((group + group / 8) * 2665), 0});
  }
  return numbered(std::move(model));
}

LidarModel hdl_64e() {
  LidarModel model{.name = "HDL-64E",
                   .channels = {},
                   .firings_per_revolution = 2082,  // 2083.3 in a tenth of a second
                   .firings_per_packet = 6,
                   .range_of_tenth = 50.0};
  for (Index pair = 0; pair < 32; ++pair) {  // one laser of each block after the other, from the highest down
    model.channels.push_back({2.0 - pair / 3.0, 0.0, nanoseconds(pair * 1500), 0});
    model.channels.push_back({-8.83 - pair / 2.0, 0.0, nanoseconds(pair * 1500 + 750), 0});
  }
  return numbered(std::move(model));
}

const std::array<LidarModel, 5>& lidar_models() {
  static const std::array models{hdl_32e(), vlp_16(), os1_64(), vls_128(), hdl_64e()};
  return models;
}

char upper(char letter) { return letter >= 'a' && letter <= 'z' ? static_cast<char>(letter - 'a' + 'A') : letter; }

}  // namespace

const LidarModel& lidar_model(LidarKind kind) { return lidar_models()[static_cast<std::size_t>(kind)]; }

std::optional<LidarKind> lidar_kind(std::string_view name) {
  const auto& models = lidar_models();
  const auto found = std::ranges::find_if(
      models, [&](const LidarModel& model) { return std::ranges::equal(model.name, name, {}, {}, upper); });
  return found == models.end() ? std::nullopt : std::optional(static_cast<LidarKind>(found - models.begin()));
}

std::string lidar_names() {
  std::string names;
  for (const LidarModel& model : lidar_models()) names += (names.empty() ? "" : ", ") + std::string(model.name);
  return names;
}

}  // namespace chainslam::simulator
