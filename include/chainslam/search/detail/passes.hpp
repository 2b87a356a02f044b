#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Goes through `count` things in their order, 32 at a time in three passes, so that the memory which one waits for is
/// asked for while others are worked on: `locate(i)` says where a thing belongs and asks for what is there,
/// `fetch(place)` for what that points to, and `put(i, place)` alone changes anything.
template <class Locate, class Fetch, class Put>
void in_passes(Index count, Locate&& locate, Fetch&& fetch, Put&& put) {
  constexpr Index at_once = 32;
  std::array<decltype(locate(Index())), static_cast<std::size_t>(at_once)> places;
  for (Index begin = 0; begin < count; begin += at_once) {
    const auto n = static_cast<std::size_t>(std::min(at_once, count - begin));
    for (std::size_t i = 0; i < n; ++i) places[i] = locate(begin + static_cast<Index>(i));
    for (std::size_t i = 0; i < n; ++i) fetch(places[i]);
    for (std::size_t i = 0; i < n; ++i) put(begin + static_cast<Index>(i), places[i]);
  }
}

}  // namespace chainslam::detail
