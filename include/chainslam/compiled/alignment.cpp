#include "chainslam/core/compiled.hpp"

template <>
bool chainslam::detail::compiled_with_alignment<EIGEN_MAX_STATIC_ALIGN_BYTES>() {
  return true;
}
