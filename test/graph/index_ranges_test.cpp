#include "chainslam/graph/index_ranges.hpp"

#include <doctest/doctest.h>

#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;

TEST_SUITE("graph/index_ranges") {
  TEST_CASE("the range of an index is the one that a look at all of them finds, gaps and empty ranges among them") {
    for_all(200, [](Rng& rng, int size) {
      IndexRanges ranges;
      Index end = 0;
      for (int i = 0; i < size; ++i) {
        const Index first = end + (rng.uniform() < 0.3 ? rng.uniform_index(5) : 0);
        end = first + (rng.uniform() < 0.3 ? 0 : rng.uniform_index(6));
        CHECK(ranges.add({first, end}) == i);
        if (rng.uniform() < 0.3) ranges.extend(end += rng.uniform_index(3));
      }
      REQUIRE(ranges.size() == size);
      for (Index index = -2; index < end + 3; ++index) {
        std::optional<Index> expected;
        for (Index i = 0; i < ranges.size(); ++i)
          if (ranges[i].first <= index && index < ranges[i].end) expected = i;
        CHECK(ranges.range_of(index) == expected);
      }
    });
  }

  TEST_CASE("ranges that overlap, descend or shrink are refused") {
    IndexRanges ranges;
    CHECK_THROWS_AS(ranges.extend(3), std::invalid_argument);
    CHECK_THROWS_AS(ranges.add({-1, 3}), std::invalid_argument);
    ranges.add({2, 5});
    CHECK_THROWS_AS(ranges.add({4, 8}), std::invalid_argument);
    CHECK_THROWS_AS(ranges.add({7, 6}), std::invalid_argument);
    CHECK_THROWS_AS(ranges.extend(4), std::invalid_argument);
    CHECK(ranges.size() == 1);
    CHECK(ranges[0] == IndexRange{2, 5});
    CHECK(ranges[0].size() == 3);
    CHECK_FALSE(ranges.range_of(5).has_value());
    CHECK_FALSE(IndexRanges().range_of(0).has_value());
  }
}

}  // namespace
}  // namespace chainslam
