#include "chainslam/search/detail/pack.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "chainslam/search/detail/point_lanes.hpp"
#include "support/property.hpp"

namespace chainslam::detail {
namespace {

template <class Scalar>
struct alignas(64) Eight {
  std::array<Scalar, pack_width> values;

  [[nodiscard]] Pack<Scalar> pack() const { return Pack<Scalar>::load(values.data()); }
};

std::size_t any_lane(Rng& rng) { return static_cast<std::size_t>(rng.uniform_index(pack_width)); }

/// What distances may be: ties, zeros, the smallest numbers, the largest, and infinities.
template <class Scalar>
Scalar distance(Rng& rng) {
  using Limits = std::numeric_limits<Scalar>;
  const std::array<Scalar, 6> special{0, Limits::denorm_min(), Limits::min(), 1, Limits::max(), Limits::infinity()};
  const auto kind = static_cast<std::size_t>(rng.uniform_index(12));
  return kind < special.size() ? special[kind]
         : kind < 9            ? static_cast<Scalar>(rng.uniform_index(4))
                               : static_cast<Scalar>(rng.uniform(0, 100));
}

template <class Scalar>
Eight<Scalar> distances(Rng& rng) {
  Eight<Scalar> eight;
  for (Scalar& value : eight.values) value = distance<Scalar>(rng);
  return eight;
}

/// NaN compared with NaN is equal here, and 0 differs from -0.
template <class Scalar>
void check_bits(const Pack<Scalar>& pack, const std::array<Scalar, pack_width>& expected) {
  Eight<Scalar> found;
  pack.store(found.values.data());
  for (std::size_t i = 0; i < pack_width; ++i) {
    CAPTURE(i);
    CHECK(std::bit_cast<KeyBits<Scalar>>(found.values[i]) == std::bit_cast<KeyBits<Scalar>>(expected[i]));
  }
}

template <class Scalar, class Holds>
unsigned mask_of(const Eight<Scalar>& eight, Holds&& holds) {
  unsigned mask = 0;
  for (std::size_t i = 0; i < pack_width; ++i) mask |= (holds(eight.values[i]) ? 1U : 0U) << i;
  return mask;
}

}  // namespace

// Whatever registers this build uses, one number after the other says what comes out, to the bit.
TEST_SUITE("search/pack") {
  TEST_CASE_TEMPLATE("arithmetic is that of single numbers", Scalar, float, double) {
    test::for_all(50, [](Rng& rng, int) {
      Eight<Scalar> a, b;
      for (std::size_t i = 0; i < pack_width; ++i) {
        a.values[i] = static_cast<Scalar>(rng.normal()) * distance<Scalar>(rng);
        b.values[i] = static_cast<Scalar>(rng.normal());
      }
      b.values[any_lane(rng)] = std::numeric_limits<Scalar>::quiet_NaN();
      a.values[any_lane(rng)] = 0;
      b.values[any_lane(rng)] = -Scalar{0};
      std::array<Scalar, pack_width> sum, difference, product, least, most;
      for (std::size_t i = 0; i < pack_width; ++i) {
        const Scalar x = a.values[i], y = b.values[i];
        sum[i] = x + y, difference[i] = x - y, product[i] = x * y;
        least[i] = x < y ? x : y, most[i] = x > y ? x : y;
      }
      check_bits(a.pack() + b.pack(), sum);
      check_bits(a.pack() - b.pack(), difference);
      check_bits(a.pack() * b.pack(), product);
      check_bits(min(a.pack(), b.pack()), least);
      check_bits(max(a.pack(), b.pack()), most);
    });
  }

  TEST_CASE_TEMPLATE("comparisons give a bit for each lane", Scalar, float, double) {
    test::for_all(100, [](Rng& rng, int) {
      const auto eight = distances<Scalar>(rng);
      const Scalar bound = rng.uniform() < 0.5 ? eight.values[any_lane(rng)] : distance<Scalar>(rng);
      CHECK(eight.pack().below(bound) == mask_of(eight, [&](Scalar value) { return value < bound; }));
      CHECK(eight.pack().at_most(bound) == mask_of(eight, [&](Scalar value) { return value <= bound; }));
      CHECK(eight.pack().at_least(bound) == mask_of(eight, [&](Scalar value) { return value >= bound; }));
      alignas(64) std::array<Scalar, 24> many;
      for (Scalar& value : many) value = distance<Scalar>(rng);
      std::uint32_t expected = 0;
      for (std::size_t i = 0; i < many.size(); ++i) expected |= (many[i] < bound ? 1U : 0U) << i;
      CHECK(lanes_below(many, bound) == expected);
    });
  }

  TEST_CASE_TEMPLATE("the smallest, the k-th and the next are those of the sorted numbers", Scalar, float, double) {
    test::for_all(100, [](Rng& rng, int) {
      const auto eight = distances<Scalar>(rng);
      auto sorted = eight.values;
      std::sort(sorted.begin(), sorted.end());
      CHECK(eight.pack().smallest() == sorted[0]);
      for (std::size_t k = 0; k < pack_width; ++k) {
        CHECK(eight.pack().smallest(static_cast<int>(k) + 1) == sorted[k]);
        const auto first = std::find(eight.values.begin(), eight.values.end(), sorted[k]);
        CHECK(eight.pack().find(sorted[k]) == static_cast<unsigned>(first - eight.values.begin()));
        const auto next = std::upper_bound(sorted.begin(), sorted.end(), sorted[k]);
        CHECK(eight.pack().smallest_above(sorted[k]) ==
              (next == sorted.end() ? far_key<Scalar> : std::min(*next, far_key<Scalar>)));
      }
    });
  }

  TEST_CASE_TEMPLATE("keys carry their lanes and are at most the numbers", Scalar, float, double) {
    test::for_all(50, [](Rng& rng, int) {
      const auto eight = distances<Scalar>(rng);
      std::array<Scalar, pack_width> expected;
      for (std::size_t i = 0; i < pack_width; ++i) {
        const auto bits = std::bit_cast<KeyBits<Scalar>>(std::min(eight.values[i], far_key<Scalar>));
        expected[i] = std::bit_cast<Scalar>(static_cast<KeyBits<Scalar>>(bits / 8 * 8 + i));
        CHECK(lane_of(expected[i]) == i);
      }
      check_bits(eight.pack().keys(), expected);
    });
  }
}

}  // namespace chainslam::detail
