#pragma once

#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Calls both, at the same time where the executor has threads for it.
template <Executor Exec, class First, class Second>
void call_both(const Exec& executor, First&& first, Second&& second) {
  executor.for_chunks(2, 1, [&](Index begin, Index /*end*/) {
    if (begin == 0)
      first();
    else
      second();
  });
}

}  // namespace chainslam::detail
