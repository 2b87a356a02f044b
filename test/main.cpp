#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include "support/terse_checks.hpp"

namespace chainslam::test {

void check_failed(const char* expression, const char* file, int line) {
  ADD_FAIL_CHECK_AT(file, line, doctest::String(expression));
}

void require_failed(const char* expression, const char* file, int line) {
  ADD_FAIL_AT(file, line, doctest::String(expression));
}

}  // namespace chainslam::test
