#include "chainslam/odometry/detail/imu_record.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "odometry/imu_samples.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

Eigen::Vector3d any_vector(Rng& rng) { return {rng.normal(), rng.normal(), rng.normal()}; }

struct Step {
  double duration;
  Eigen::Vector3d gyro, accel;
};
std::vector<Step> steps_of(const detail::ImuRecord& record, double from, double to) {
  std::vector<Step> steps;
  record.for_each_step(at(from), at(to), [&](const detail::ImuStep& step) {
    REQUIRE(step.reading);
    steps.push_back({step.duration, step.reading->gyro, step.reading->accel});
  });
  return steps;
}

}  // namespace

TEST_SUITE("odometry/imu_record") {
  TEST_CASE("steps next to a sample with a stuck axis are without that sensor, and no others") {
    detail::ImuRecord record;
    for (int i = 0; i < 6; ++i) record.add({.time = at(0.01 * i), .rate_measured = i != 2, .force_measured = i != 4});
    std::string rates, forces;
    record.for_each_step(at(0), at(0.05), [&](const detail::ImuStep& step) {
      REQUIRE(step.reading);
      rates += step.reading->rate_measured ? 'y' : 'n';
      forces += step.reading->force_measured ? 'y' : 'n';
    });
    CHECK(rates == "ynnyy");
    CHECK(forces == "yyynn");
  }

  TEST_CASE("a hole takes bounded work, however far the clock jumped, and its steps make up its whole length") {
    detail::ImuRecord record;
    for (int i = 0; i < 3; ++i) record.add({.time = at(0.01 * i)});
    for (const double length : {0.5, 1.0, 9.9, 10.1, 3600.0, 1e9, 4e9}) {
      CAPTURE(length);
      for (const bool sample_behind : {false, true}) {
        detail::ImuRecord jumped = record;
        if (sample_behind) jumped.add({.time = at(0.02 + length)});
        std::int64_t steps = 0;
        double sum = 0, longest_of_first = 0;
        jumped.for_each_step(at(0.02), at(0.02 + length), [&](const detail::ImuStep& step) {
          CHECK(!step.reading);
          sum += step.duration;
          if (++steps <= 500) longest_of_first = std::max(longest_of_first, step.duration);
        });
        CHECK(steps == static_cast<std::int64_t>(length < 10 ? std::lround(100 * length) : 1001));
        CHECK(longest_of_first <= 0.01 + 1e-9);  // over what a motion can be continued: as finely as ever
        CHECK(sum == doctest::Approx(length).epsilon(1e-12));
      }
    }
  }

  TEST_CASE("a correction holds for the samples kept and for those to come, however often it is changed") {
    for_all(20, [](Rng& rng, int) {
      const ImuCorrection first{rng.normal(0, 0.05), SO3d::exp(any_vector(rng))};
      const ImuCorrection last{rng.normal(0, 0.05), SO3d::exp(any_vector(rng))};
      detail::ImuRecord record, corrected_before;
      for (int i = 0; i < 60; ++i) {
        const ImuSample sample = sample_at(100 + 0.01 * i, any_vector(rng), any_vector(rng));
        if (i == 20) record.correct(first);
        if (i == 40) record.correct(last);
        CHECK(record.add(sample) == detail::ImuRecord::Taken::yes);
        corrected_before.add(last(sample));
      }
      REQUIRE(record.samples().size() == corrected_before.samples().size());
      CHECK(record.correction().time_offset == last.time_offset);
      const std::vector<Step> steps = steps_of(record, 100.1, 100.4),
                              expected = steps_of(corrected_before, 100.1, 100.4);
      REQUIRE(steps.size() == expected.size());
      for (std::size_t i = 0; i < steps.size(); ++i) {
        CHECK(steps[i].duration == doctest::Approx(expected[i].duration).epsilon(1e-6));
        CHECK((steps[i].gyro - expected[i].gyro).norm() < 1e-5);  // times are rounded to a nanosecond
        CHECK((steps[i].accel - expected[i].accel).norm() < 1e-5);
      }
    });
  }

  TEST_CASE("a clock that is put back loses no sample: those that come after continue those before") {
    detail::ImuRecord record;
    for (int i = 0; i < 50; ++i) record.add(sample_at(10.2 + 0.01 * i, {0, 0, 0.1}));
    record.correct({.time_offset = 0.2});
    CHECK_FALSE(record.reaches(at(10.5)));
    CHECK(record.reaches(at(10.49)));
    CHECK(record.add(sample_at(10.7, {0, 0, 0.1})) == detail::ImuRecord::Taken::yes);
    CHECK(record.samples().size() == 51);
    CHECK(record.reaches(at(10.5)));
  }
}
