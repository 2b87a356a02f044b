#pragma once

#include <doctest/doctest.h>

// doctest's assertions without the values of both sides, which the build without sanitizers reports: taking an
// expression apart costs up to a third of what clang needs to compile a test under AddressSanitizer.

namespace chainslam::test {

/// Counts a failure of the running test, as CHECK does.
void check_failed(const char* expression, const char* file, int line);

/// Ends the running test as failed, as REQUIRE does.
void require_failed(const char* expression, const char* file, int line);

}  // namespace chainslam::test

#undef CHECK
#undef CHECK_FALSE
#undef REQUIRE
#undef REQUIRE_FALSE
#define CHECK(...) \
  (static_cast<bool>(__VA_ARGS__) ? void() : chainslam::test::check_failed(#__VA_ARGS__, __FILE__, __LINE__))
#define CHECK_FALSE(...) \
  (static_cast<bool>(__VA_ARGS__) ? chainslam::test::check_failed("not " #__VA_ARGS__, __FILE__, __LINE__) : void())
#define REQUIRE(...) \
  (static_cast<bool>(__VA_ARGS__) ? void() : chainslam::test::require_failed(#__VA_ARGS__, __FILE__, __LINE__))
#define REQUIRE_FALSE(...) \
  (static_cast<bool>(__VA_ARGS__) ? chainslam::test::require_failed("not " #__VA_ARGS__, __FILE__, __LINE__) : void())
