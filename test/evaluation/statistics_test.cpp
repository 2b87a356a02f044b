#include "chainslam/trajectory/pose_errors.hpp"

#include <doctest/doctest.h>

#include <vector>

using namespace chainslam;

TEST_SUITE("evaluation/statistics") {
  TEST_CASE("of no errors there are none") { CHECK_FALSE(error_statistics({})); }

  TEST_CASE("of one error all are that error, and it does not deviate") {
    const auto found = error_statistics(std::vector{3.0});
    REQUIRE(found);
    CHECK(found->count == 1);
    for (const double value : {found->rmse, found->mean, found->median, found->min, found->max}) CHECK(value == 3);
    CHECK(found->std == 0);
    CHECK(found->sse == 9);
  }

  TEST_CASE("closed forms, whatever the order") {
    const auto found = error_statistics(std::vector{4.0, 1.0, 2.0, 5.0});
    REQUIRE(found);
    CHECK(found->mean == doctest::Approx(3));
    CHECK(found->median == doctest::Approx(3));
    CHECK(found->std == doctest::Approx(std::sqrt(2.5)));
    CHECK(found->rmse == doctest::Approx(std::sqrt(11.5)));
    CHECK(found->sse == doctest::Approx(46));
    CHECK(found->min == 1);
    CHECK(found->max == 5);
    CHECK(error_statistics(std::vector{9.0, 1.0, 2.0})->median == 2);
  }

  TEST_CASE("rmse, mean and deviation belong together: rmse^2 = mean^2 + std^2") {
    std::vector<double> errors;
    for (int i = 0; i < 1000; ++i) errors.push_back(1e3 + std::sin(i));
    const auto found = error_statistics(errors);
    REQUIRE(found);
    CHECK(found->rmse * found->rmse ==
          doctest::Approx(found->mean * found->mean + found->std * found->std).epsilon(1e-12));
  }
}
