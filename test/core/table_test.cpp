#include "chainslam/core/table.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using Numbers = detail::Table<Offset>;

/// Knows where it is.
struct Point {
  Point() : Point(-1, -1) {}
  Point(int x_coordinate, int y_coordinate) : x(x_coordinate), y(y_coordinate), own(this) {}
  Point(const Point& other) : Point(other.x, other.y) {}
  Point& operator=(const Point& other) {
    x = other.x;
    y = other.y;
    return *this;
  }

  int x, y;
  const Point* own;
};

bool same(const Numbers& table, const std::vector<Offset>& expected) {
  return std::vector<Offset>(table.begin(), table.end()) == expected && table.empty() == expected.empty();
}

}  // namespace

TEST_SUITE("core/table") {
  TEST_CASE("holds what a vector would, whatever is done to it") {
    for_all(100, [](Rng& rng, int size) {
      Numbers table;
      std::vector<Offset> expected;
      for (int step = 0; step < 3 * size; ++step) {
        const Offset length = rng.uniform_index(size);
        const std::vector<Offset> more(static_cast<std::size_t>(length), step);
        switch (rng.uniform_index(7)) {
          case 0:
            table.resize(length, step);
            expected.resize(more.size(), step);
            break;
          case 1:
            table.append(more);
            expected.insert(expected.end(), more.begin(), more.end());
            break;
          case 2:
            table.assign(length, step);
            expected = more;
            break;
          case 3:
            if (expected.empty()) break;
            table.pop_back();
            expected.pop_back();
            break;
          case 4:
            table.reserve(length);
            break;
          default:
            table.push_back(step);
            expected.push_back(step);
        }
        CHECK(same(table, expected));
      }
    });
  }

  TEST_CASE("a copy is one's own, and one that was moved from is empty") {
    Numbers table(3, 7);
    Numbers copy = table;
    copy[0] = 1;
    CHECK(same(table, {7, 7, 7}));
    CHECK(same(copy, {1, 7, 7}));
    copy = *&copy;  // itself
    CHECK(same(copy, {1, 7, 7}));
    table = Numbers();
    CHECK(table.empty());
    table = copy;
    const Numbers moved = std::move(table);
    CHECK(same(moved, {1, 7, 7}));
    table.clear();
    table.push_back(2);
    CHECK(same(table, {2}));
    copy = std::move(table);
    CHECK(same(copy, {2}));
  }

  TEST_CASE("an element of its own is added to it, though its memory moves") {
    Numbers table(1, 5);
    for (int k = 0; k < 20; ++k) table.push_back(table[0]);
    for (Offset size = 30; size < 3000; size += 40) table.resize(size, table[0]);
    CHECK(same(table, std::vector<Offset>(static_cast<std::size_t>(table.size()), 5)));
  }

  TEST_CASE("keep_if leaves those that are kept, in their order") {
    for_all(20, [](Rng& rng, int size) {
      Numbers table;
      std::vector<Offset> expected;
      for (int k = 0; k < size; ++k) {
        table.push_back(rng.uniform_index(10));
        if (table.back() % 3 != 0) expected.push_back(table.back());
      }
      table.keep_if([](Offset number) { return number % 3 != 0; });
      CHECK(same(table, expected));
    });
  }

  TEST_CASE("elements that have a copy constructor are copied by it, wherever they move") {
    using Points = detail::Table<Point>;
    Points table;
    for (int k = 0; k < 100; ++k) table.push_back({k, k + 1});
    for (int k = 0; k < 20; ++k) table.push_back(table[k]);
    table.emplace_back().x = 5;
    Points copy(3, {7, 7});
    copy = table;
    copy.append(table.range(10, 12));
    REQUIRE(copy.size() == 123);
    for (Offset k = 0; k < 100; ++k) CHECK((copy[k].x == k && copy[k].y == k + 1 && copy[k].own == &copy[k]));
    for (Offset k = 0; k < 20; ++k) CHECK((copy[100 + k].y == k + 1 && copy[100 + k].own == &copy[100 + k]));
    CHECK((copy[120].x == 5 && copy[120].y == -1 && copy[122].x == 11));
    copy.resize(130, copy[11]);
    copy.keep_if([](const Point& point) { return point.x == 11; });
    CHECK(copy.size() == 10);
    CHECK(copy.back().own == &copy.back());
  }

  TEST_CASE("elements lie where they must, in registers of 64 bytes, too") {
    struct alignas(64) Wide {
      std::array<double, 8> numbers;
    };
    detail::Table<Wide> table;
    for (int k = 0; k < 50; ++k) {
      table.push_back({{1.0 * k, 2.0 * k}});
      CHECK(reinterpret_cast<std::uintptr_t>(table.data()) % 64 == 0);
    }
    const detail::Table<Wide> copy = table;
    CHECK(reinterpret_cast<std::uintptr_t>(copy.data()) % 64 == 0);
    for (int k = 0; k < 50; ++k) CHECK(copy[k].numbers[1] == 2.0 * k);
  }

  TEST_CASE("an empty one takes empty lists, and gives them") {
    Numbers table;
    table.append({});
    table.resize(0);
    CHECK(table.all().empty());
    CHECK(Numbers(table).empty());
    CHECK(Numbers(std::span<const Offset>()).empty());
    CHECK(table.range(0, 0).empty());
  }
}
