#include "chainslam/core/lanes.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "support/property.hpp"

namespace chainslam::detail {
namespace {

using Numbers = std::array<float, lane_count>;

FloatLanes lanes_of(const Numbers& numbers) {
  FloatLanes lanes;
  load(numbers.data(), lanes);
  return lanes;
}

Numbers numbers_of(const FloatLanes& lanes) {
  Numbers numbers;
  store(lanes, numbers.data());
  return numbers;
}

}  // namespace

TEST_SUITE("core/lanes") {
  TEST_CASE("lanes are chosen and negated where the mask is true") {
    test::for_all(50, [](Rng& rng, int) {
      Numbers yes, no, chosen, negated;
      MaskLanes mask;
      std::int32_t count = 0;
      for (std::size_t i = 0; i < lane_count; ++i) {
        yes[i] = static_cast<float>(rng.normal()), no[i] = static_cast<float>(rng.normal());
        const bool here = rng.uniform() < 0.3;
        mask[i] = here ? -1 : 0;
        count -= here ? 1 : 0;
        chosen[i] = here ? yes[i] : no[i];
        negated[i] = here ? -yes[i] : yes[i];
      }
      FloatLanes result;
      choose(mask, lanes_of(yes), lanes_of(no), result);
      CHECK(numbers_of(result) == chosen);
      negate_where(mask, lanes_of(yes), result);
      CHECK(numbers_of(result) == negated);
      CHECK(sum(mask) == count);
      CHECK(any(mask) == (count != 0));
    });
  }

  TEST_CASE("a single lane that is true is found in each place") {
    for (std::size_t i = 0; i < lane_count; ++i) {
      MaskLanes mask{};
      CHECK_FALSE(any(mask));
      mask[i] = -1;
      CHECK(any(mask));
    }
  }

  TEST_CASE("inverse roots are right to the last bits of float") {
    test::for_all(50, [](Rng& rng, int) {
      Numbers x;
      for (float& value : x) value = static_cast<float>(std::pow(10.0, rng.uniform(-30, 30)));
      FloatLanes root;
      inverse_root(lanes_of(x), root);
      // Three steps from within 3.5 %: 5e-12 in exact arithmetic; each step rounds five times.
      for (std::size_t i = 0; i < lane_count; ++i)
        CHECK(root[i] * std::sqrt(static_cast<double>(x[i])) == doctest::Approx(1).epsilon(4e-7));
    });
    FloatLanes root;
    inverse_root(FloatLanes{}, root);
    for (std::size_t i = 0; i < lane_count; ++i) CHECK(std::isfinite(root[i]));
  }

  TEST_CASE("whole lanes are the next multiple") {
    CHECK(whole_lanes(0) == 0);
    CHECK(whole_lanes(1) == lane_count);
    CHECK(whole_lanes(lane_count) == lane_count);
    CHECK(whole_lanes(lane_count + 1) == 2 * lane_count);
  }
}

}  // namespace chainslam::detail
