#pragma once

// Header-only or compiled. With `CHAINSLAM_COMPILED` defined, as the CMake target `chainslam::compiled` does, headers
// declare their common instantiations `extern template`: these are then in that target's library, compiled once, from
// include/chainslam/compiled/. Results are the same to the bit.

#ifdef CHAINSLAM_COMPILED
#include <Eigen/Core>

#include "chainslam/core/thread_pool.hpp"

namespace chainslam::detail {

/// Defined in the library for the alignment that it was compiled with. A program that does not link for lack of it was
/// compiled with other vector instructions (-mavx, -march=...), with which Eigen's matrices lie elsewhere in memory:
/// compile the library with the same, or leave `CHAINSLAM_COMPILED` undefined.
template <int Alignment>
bool compiled_with_alignment();
extern template bool compiled_with_alignment<EIGEN_MAX_STATIC_ALIGN_BYTES>();
inline const bool compiled_alike = compiled_with_alignment<EIGEN_MAX_STATIC_ALIGN_BYTES>();

}  // namespace chainslam::detail
#endif
