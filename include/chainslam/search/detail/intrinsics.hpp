#pragma once

// What a processor's registers can do, as far as this build may use it. Without AVX the narrow header will do: the
// other takes as long to read as half of Eigen.
#if defined(__AVX__)
#include <immintrin.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#elif defined(__aarch64__) && defined(__ARM_NEON)
#include <arm_neon.h>
#endif
