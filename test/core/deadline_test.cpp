#include "chainslam/core/executor.hpp"

#include <doctest/doctest.h>

namespace chainslam::test {

TEST_SUITE("core/deadline") {
  TEST_CASE("never passes unless it is told to") {
    CHECK_FALSE(Deadline().passed());
    CHECK_FALSE(Deadline(Deadline::Clock::time_point::max()).passed());
    CHECK_FALSE(Deadline::in(std::chrono::hours(1)).passed());
  }

  TEST_CASE("passes with its time") {
    CHECK(Deadline(Deadline::Clock::now()).passed());
    CHECK(Deadline::in(std::chrono::nanoseconds(0)).passed());
    CHECK(Deadline(Deadline::Clock::time_point::min()).passed());
  }

  TEST_CASE("passes when somebody asks to stop, also before its time") {
    std::stop_source source;
    const Deadline open(source.get_token());
    const Deadline later = Deadline::in(std::chrono::hours(1), source.get_token());
    CHECK_FALSE(open.passed());
    CHECK_FALSE(later.passed());
    source.request_stop();
    CHECK(open.passed());
    CHECK(later.passed());
  }
}

}  // namespace chainslam::test
