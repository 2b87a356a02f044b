#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

#include "program/run_program.hpp"

#include <doctest/doctest.h>

namespace chainslam::test {

/// A LAS 1.4 file, read by the offsets in the tables of the ASPRS specification (1.4-R15), without the writer's code.
struct LasFile {
  std::string bytes;
  std::uint64_t points = 0;
  std::size_t first = 0, record = 0;

  template <class T>
  [[nodiscard]] T at(std::size_t offset) const {
    T value;
    REQUIRE(offset + sizeof value <= bytes.size());
    std::memcpy(&value, bytes.data() + offset, sizeof value);  // the machines of the tests are little-endian
    return value;
  }

  explicit LasFile(const fs::path& path) : bytes(read_text(path)) {
    REQUIRE(bytes.size() >= 375);
    CHECK(bytes.substr(0, 4) == "LASF");
    CHECK(at<std::uint8_t>(24) == 1);
    CHECK(at<std::uint8_t>(25) == 4);
    CHECK(at<std::uint16_t>(94) == 375);
    CHECK(at<std::uint8_t>(104) == 6);
    first = at<std::uint32_t>(96);
    record = at<std::uint16_t>(105);
    CHECK(record == 30);
    points = at<std::uint64_t>(247);
    CHECK(at<std::uint64_t>(255) == points);  // of the first return
    for (std::size_t i = 1; i < 15; ++i) CHECK(at<std::uint64_t>(255 + 8 * i) == 0);
    for (std::size_t i = 0; i < 6; ++i) CHECK(at<std::uint32_t>(107 + 4 * i) == 0);  // legacy numbers
    CHECK(at<std::uint64_t>(227) == 0);
    CHECK(at<std::uint64_t>(235) == 0);
    CHECK(at<std::uint32_t>(243) == 0);
    REQUIRE(bytes.size() == first + points * record);
  }

  [[nodiscard]] bool has_bit(int bit) const { return ((at<std::uint16_t>(6) >> bit) & 1) != 0; }
  [[nodiscard]] double scale(std::size_t axis) const { return at<double>(131 + 8 * axis); }
  [[nodiscard]] double offset(std::size_t axis) const { return at<double>(155 + 8 * axis); }
  [[nodiscard]] double most(std::size_t axis) const { return at<double>(179 + 16 * axis); }
  [[nodiscard]] double least(std::size_t axis) const { return at<double>(187 + 16 * axis); }

  [[nodiscard]] double coordinate(std::uint64_t i, std::size_t axis) const {
    return at<std::int32_t>(first + i * record + 4 * axis) * scale(axis) + offset(axis);
  }
  [[nodiscard]] int intensity(std::uint64_t i) const { return at<std::uint16_t>(first + i * record + 12); }
  [[nodiscard]] int returns(std::uint64_t i) const { return at<std::uint8_t>(first + i * record + 14); }
  [[nodiscard]] int source(std::uint64_t i) const { return at<std::uint16_t>(first + i * record + 20); }
  [[nodiscard]] double gps_time(std::uint64_t i) const { return at<double>(first + i * record + 22); }

  /// The coordinate system, of the one variable length record; empty if there is none.
  [[nodiscard]] std::string wkt() const {
    if (at<std::uint32_t>(100) == 0) {
      CHECK(first == 375);
      return "";
    }
    CHECK(at<std::uint32_t>(100) == 1);
    CHECK(std::string(bytes.c_str() + 377) == "LASF_Projection");
    CHECK(at<std::uint16_t>(393) == 2112);
    const std::size_t length = at<std::uint16_t>(395);
    CHECK(first == 375 + 54 + length);
    CHECK(bytes[first - 1] == '\0');
    return bytes.substr(429, length - 1);
  }
};

}  // namespace chainslam::test
