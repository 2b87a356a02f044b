#pragma once

#include <doctest/doctest.h>

/// A test case that ThreadSanitizer is to look at, in the suite `threads: <suite>`. Its build defines
/// CHAINSLAM_THREADS_ONLY, by which every other TEST_CASE becomes a template that nobody instantiates: most of what
/// these files take to compile.
#define THREADS_TEST_CASE(suite, decorators) DOCTEST_TEST_CASE(decorators* doctest::test_suite("threads: " suite))

#ifdef CHAINSLAM_THREADS_ONLY
#pragma clang diagnostic ignored "-Wunused-function"  // what the others alone would call
#pragma clang diagnostic ignored "-Wunneeded-internal-declaration"
#undef TEST_CASE
#define TEST_CASE(decorators) \
  template <int>              \
  static void DOCTEST_ANONYMOUS(CHAINSLAM_NOT_FOR_THREADS_)()
#endif
