#include "chainslam/core/table.hpp"

#include <doctest/doctest.h>

#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using Numbers = detail::Table<Offset>;

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
