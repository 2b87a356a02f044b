// Compiled as a hostile parent project would: here the compiler takes NaN and infinity not to exist.
#ifdef __clang__
#pragma float_control(precise, off)
#else
#pragma GCC optimize("fast-math")
#endif
#include "chainslam/core/types.hpp"

#include <doctest/doctest.h>

#include <cstdlib>
#include <limits>
#include <string>

namespace chainslam {
namespace {

/// Numbers that the optimizer cannot see through.
float parse_float(const char* text) { return std::strtof(text, nullptr); }
double parse_double(const char* text) { return std::strtod(text, nullptr); }

TEST_SUITE("core/finite") {
  TEST_CASE("NaN and infinities of both signs are not finite") {
    for (const char* text : {"nan", "-nan", "inf", "-inf"}) {
      CAPTURE(text);
      CHECK_FALSE(is_finite(parse_float(text)));
      CHECK_FALSE(is_finite(parse_double(text)));
    }
  }

  TEST_CASE("zeros, denormals and the largest numbers are finite") {
    for (const char* text : {"0", "-0", "1", "-1", "1e-45", "3.4028234e38", "-3.4028234e38"}) {
      CAPTURE(text);
      CHECK(is_finite(parse_float(text)));
      CHECK(is_finite(parse_double(text)));
    }
    CHECK(is_finite(parse_double("1.7976931348623157e308")));
    CHECK(is_finite(parse_double("5e-324")));
  }

  TEST_CASE("one bad coefficient makes a matrix not finite, expressions included") {
    Eigen::Matrix3d matrix = Eigen::Matrix3d::Identity();
    CHECK(is_finite(matrix));
    CHECK(is_finite(2.0 * matrix));
    matrix(2, 1) = parse_double("nan");
    CHECK_FALSE(is_finite(matrix));
    CHECK_FALSE(is_finite(matrix.col(1)));
    CHECK(is_finite(matrix.col(0)));
    CHECK(is_finite(Eigen::VectorXf(0)));
  }

  TEST_CASE("works in constant expressions") {
    static_assert(is_finite(1.0F) && !is_finite(std::numeric_limits<double>::quiet_NaN()));
  }
}

}  // namespace
}  // namespace chainslam
