#include "chainslam/core/compiled.hpp"

namespace chainslam::detail {

template <int Alignment>
bool compiled_with_alignment() {
  return true;
}
template bool compiled_with_alignment<EIGEN_MAX_STATIC_ALIGN_BYTES>();

}  // namespace chainslam::detail
