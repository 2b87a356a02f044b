#pragma once

#include <cstdint>

#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::simulator {

/// The generator of that part of a thing which is drawn anew every day; on day 0 it is `thing` itself.
[[nodiscard]] inline Rng on_day(const Rng& thing, Index day) {
  return day == 0 ? thing : thing.fork(~static_cast<std::uint64_t>(day));  // far from the numbers that parts have
}

/// November to March; day 0 is the first of June.
[[nodiscard]] inline bool is_winter(Index day) { return day % 365 >= 153 && day % 365 < 304; }

}  // namespace chainslam::simulator
