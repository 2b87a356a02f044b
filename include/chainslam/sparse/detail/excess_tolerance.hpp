#pragma once

#include <algorithm>

#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// By how much a solution may exceed the minimum of the squared error. A front may take in proportion to the blocks of
/// its columns, since solving for them costs that, but no more than half of what is left.
struct ExcessTolerance {
  double left = 0.0;      ///< of what all may take
  double of_block = 0.0;  ///< what a front may take, for each block of its columns

  /// What a front may take, of some block columns of its own and block rows below them.
  [[nodiscard]] double of_front(Index columns, Index rows) const {
    return std::min(0.5 * left, of_block * columns * (columns + rows));
  }
};

}  // namespace chainslam::detail
