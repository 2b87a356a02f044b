#pragma once

#include <concepts>
#include <string_view>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// How far a stage has come.
struct StageProgress {
  std::string_view stage;  ///< "odometry", "closures", ...
  Index done = 0;          ///< items done
  Index total = 0;         ///< 0 if unknown
};

/// Callbacks on the progress of a long computation; the library itself prints nothing.
///
/// Called on the thread that computes, between steps: it must be quick, must not throw, and must copy any text it
/// keeps.
template <class O>
concept Observer = requires(O& observer, const StageProgress& progress, std::string_view text) {
  observer.progress(progress);
  observer.warning(text);
};

}  // namespace chainslam
