#include "chainslam/core/types.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

TEST_SUITE("core/ranked") {
  TEST_CASE("the least rank comes first, and equal ones by their index") {
    for_all(20, [](Rng& rng, int size) {
      std::vector<Ranked> all;
      for (Index index = 10 * size; index-- > 0;) all.push_back({static_cast<double>(rng.uniform_index(5)), index});
      const std::size_t count = all.size();
      sort_ranked(all);
      CHECK(all.size() == count);
      for (std::size_t k = 1; k < all.size(); ++k) {
        CHECK(all[k - 1].rank <= all[k].rank);
        if (all[k - 1].rank == all[k].rank) CHECK(all[k - 1].index < all[k].index);
      }
    });
  }
}
