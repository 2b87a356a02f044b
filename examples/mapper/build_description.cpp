#include "build_description.hpp"

#include <zstd.h>

#include <Eigen/Core>

#include "chainslam/core/version.hpp"

namespace chainslam::mapper {

namespace {

#define CHAINSLAM_TEXT_OF(x) #x
#define CHAINSLAM_TEXT(x) CHAINSLAM_TEXT_OF(x)

constexpr const char* version = CHAINSLAM_TEXT(CHAINSLAM_VERSION_MAJOR) "." CHAINSLAM_TEXT(
    CHAINSLAM_VERSION_MINOR) "." CHAINSLAM_TEXT(CHAINSLAM_VERSION_PATCH);

constexpr const char* compiler =
#if defined(__clang__)
    "clang " __clang_version__;
#else
    "g++ " __VERSION__;
#endif

constexpr const char* instruction_set =
#if defined(__AVX512F__)
    "AVX-512";
#elif defined(__AVX2__)
    "AVX2";
#elif defined(__AVX__)
        "AVX";
#elif defined(__x86_64__)
        "x86-64 (SSE2)";
#elif defined(__aarch64__)
        "AArch64";
#else
        "of the compiler's default target";
#endif

constexpr const char* assertions =
#if defined(NDEBUG)
    "assertions off";
#else
    "assertions on";
#endif

/// The build type as CMake has it, and what it was built with beside that.
std::string configuration() {
  const std::string type = CHAINSLAM_BUILD_TYPE, sanitizer = CHAINSLAM_BUILD_SANITIZER;
  return (type.empty() ? "no build type" : type) + ", " + assertions +
         (sanitizer.empty() ? "" : ", " + sanitizer + " sanitizer");
}

}  // namespace

std::string build_description() {
  return std::string("chainslam ") + version + "\n  compiler         " + compiler + "\n  configuration    " +
         configuration() + "\n  instruction set  " + instruction_set +
         "\n  libraries        Eigen " CHAINSLAM_TEXT(EIGEN_WORLD_VERSION) "." CHAINSLAM_TEXT(
             EIGEN_MAJOR_VERSION) "." CHAINSLAM_TEXT(EIGEN_MINOR_VERSION) ", Zstandard " ZSTD_VERSION_STRING;
}

}  // namespace chainslam::mapper
