#include "datasets/point_time.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <vector>

using namespace chainslam;
using namespace chainslam::datasets;

namespace {

const Timestamp stamp = Timestamp::from_nanoseconds(1'600'000'000'123'456'789);
constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();

/// n values from `first` to `last`, both included.
std::vector<double> ramp(double first, double last, int n = 1001) {
  std::vector<double> values;
  for (int i = 0; i < n; ++i) values.push_back(first + (last - first) * i / (n - 1));
  return values;
}

std::vector<double> as_float(std::vector<double> values) {
  for (double& value : values) value = static_cast<float>(value);
  return values;
}

void check_bounds(const PointTimes& times) {
  for (const float offset : times.offsets) {
    REQUIRE(offset >= 0.0F);
    REQUIRE(offset <= to_seconds(times.end - times.time));
  }
}

}  // namespace

TEST_SUITE("datasets/point_time") {
  TEST_CASE("Velodyne's driver: float seconds after the stamp") {
    const auto raw = as_float(ramp(0, 0.1));
    const auto found = infer_point_time(raw, stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.unit == TimeUnit::seconds);
    CHECK(found.rule.base == PointTimeBase::relative);
    CHECK(found.stamp == StampPlace::start);
    CHECK(found.sentence ==
          "time per point: s, relative to the scan's stamp, stamp at the sweep's start, sweep of 0.1 s");
    const auto times = apply_point_time(found.rule, raw, stamp);
    CHECK(times.time == stamp);
    CHECK(std::abs(to_seconds(times.end - stamp) - 0.1) < 1e-8);  // 0.1 as float
    CHECK(times.offsets[500] == doctest::Approx(0.05));
    CHECK(times.plausible);
    check_bounds(times);
  }

  TEST_CASE("Velodyne's driver stamped by its last packet: float seconds before the stamp") {
    const auto raw = as_float(ramp(-0.1, 0));
    const auto found = infer_point_time(raw, stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.unit == TimeUnit::seconds);
    CHECK(found.stamp == StampPlace::end);
    const auto times = apply_point_time(found.rule, raw, stamp);
    CHECK(times.end == stamp);
    CHECK(std::abs(to_seconds(stamp - times.time) - 0.1) < 1e-8);
    CHECK(times.offsets.front() == 0.0F);
    check_bounds(times);
  }

  TEST_CASE("community NCLT and UTBM bags: float microseconds") {
    const auto raw = as_float(ramp(0, 99'800));
    const auto found = infer_point_time(raw, stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.unit == TimeUnit::microseconds);
    CHECK(found.sweep == doctest::Approx(0.0998));
  }

  TEST_CASE("milliseconds, as some forks write") {
    const auto found = infer_point_time(ramp(0, 100), stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.unit == TimeUnit::milliseconds);
  }

  TEST_CASE("Ouster's and Livox's messages: whole nanoseconds after the stamp") {
    const auto raw = ramp(0, 99'999'000, 1024);
    const auto found = infer_point_time(raw, stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.unit == TimeUnit::nanoseconds);
    CHECK(found.rule.base == PointTimeBase::relative);
    const auto times = apply_point_time(found.rule, raw, stamp);
    CHECK((times.end - times.time).count() == 99'999'000);
  }

  TEST_CASE("Hesai's and RoboSense's drivers: absolute seconds in double") {
    const double begin = stamp.to_seconds();
    const auto raw = ramp(begin, begin + 0.1);
    const auto found = infer_point_time(raw, stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.unit == TimeUnit::seconds);
    CHECK(found.rule.base == PointTimeBase::absolute);
    CHECK(found.stamp == StampPlace::start);
    const auto times = apply_point_time(found.rule, raw, Timestamp{});
    CHECK(std::abs(to_seconds(times.time - stamp)) < 1e-6);  // a double of 1.6e9 s has steps of 0.24 us
    CHECK(std::abs(to_seconds(times.end - times.time) - 0.1) < 1e-6);
    check_bounds(times);
  }

  TEST_CASE("absolute seconds with the stamp at the sweep's end") {
    const double end = stamp.to_seconds();
    const auto found = infer_point_time(ramp(end - 0.1, end), stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.base == PointTimeBase::absolute);
    CHECK(found.stamp == StampPlace::end);
  }

  TEST_CASE("Livox's PointCloud2: absolute nanoseconds in double") {
    const double begin = static_cast<double>(stamp.nanoseconds());
    const auto raw = ramp(begin, begin + 1e8);
    const auto found = infer_point_time(raw, stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.unit == TimeUnit::nanoseconds);
    CHECK(found.rule.base == PointTimeBase::absolute);
    const auto times = apply_point_time(found.rule, raw, stamp);
    CHECK(std::abs((times.time - stamp).count()) <= 256);
    check_bounds(times);
  }

  TEST_CASE("absolute seconds in float have lost the sweep and are refused") {
    const double begin = stamp.to_seconds();
    CHECK(infer_point_time(as_float(ramp(begin, begin + 0.1)), stamp).status == PointTimeStatus::absent);
  }

  TEST_CASE("an absolute time of another clock is ambiguous until it is stated") {
    const auto raw = ramp(stamp.to_seconds() + 37, stamp.to_seconds() + 37.1);
    const auto found = infer_point_time(raw, stamp);
    CHECK(found.status == PointTimeStatus::ambiguous);
    CHECK(found.sentence.find("another clock") != std::string::npos);
    const auto stated = infer_point_time(raw, stamp, {.base = PointTimeBase::absolute});
    REQUIRE(stated.status == PointTimeStatus::inferred);
    CHECK(infer_point_time(raw, std::nullopt).status == PointTimeStatus::inferred);  // no other clock to disagree with
  }

  TEST_CASE("a recording whose clock starts at zero cannot tell relative from absolute") {
    const auto found = infer_point_time(ramp(0, 0.1), Timestamp::from_seconds(0.05));
    CHECK(found.status == PointTimeStatus::ambiguous);
    CHECK(found.sentence.find("relative or absolute") != std::string::npos);
    CHECK(infer_point_time(ramp(0, 0.1), Timestamp::from_seconds(0.05), {.base = PointTimeBase::relative}).status ==
          PointTimeStatus::inferred);
  }

  TEST_CASE("zeros, equal values, and no values at all are no time") {
    CHECK(infer_point_time(std::vector<double>(100, 0.0), stamp).status == PointTimeStatus::absent);
    CHECK(infer_point_time(std::vector<double>(100, stamp.to_seconds()), stamp).status == PointTimeStatus::absent);
    CHECK(infer_point_time(std::vector<double>{}, stamp).status == PointTimeStatus::absent);
    CHECK(infer_point_time(std::vector<double>(3, not_a_number), stamp).status == PointTimeStatus::absent);
    CHECK(infer_point_time(std::vector<double>{0.05}, stamp).status == PointTimeStatus::absent);
  }

  TEST_CASE("a scan of 10 s, or one made of parts of a sweep, is refused with its values") {
    const auto found = infer_point_time(ramp(0, 10), stamp);
    CHECK(found.status == PointTimeStatus::unusable);
    CHECK(found.sentence.find("from 0 to 10") != std::string::npos);
    CHECK(infer_point_time(ramp(0, 0.001), stamp).status == PointTimeStatus::unusable);
    CHECK(infer_point_time(ramp(0, 1), stamp).status == PointTimeStatus::unusable);  // normalized to 0..1
  }

  TEST_CASE("too wide a hint leaves more than one unit, and stating it decides") {
    const PointTimeHints wide{.shortest_sweep = 1e-4, .longest_sweep = 1};
    CHECK(infer_point_time(ramp(0, 0.5), stamp, wide).status == PointTimeStatus::ambiguous);
    PointTimeHints stated = wide;
    stated.unit = TimeUnit::milliseconds;
    const auto found = infer_point_time(ramp(0, 0.5), stamp, stated);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.rule.unit == TimeUnit::milliseconds);
  }

  TEST_CASE("values that fall from point to point could count back: stated, they do") {
    const auto raw = ramp(0.1, 0);
    CHECK(infer_point_time(raw, stamp).status == PointTimeStatus::ambiguous);
    const auto found = infer_point_time(raw, stamp, {.counts_back = true});
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.stamp == StampPlace::end);
    const auto times = apply_point_time(found.rule, raw, stamp);
    CHECK(times.end == stamp);
    CHECK(times.offsets.front() == 0.0F);
    CHECK(times.offsets.back() == doctest::Approx(0.1));
    check_bounds(times);
  }

  TEST_CASE("points ordered ring by ring are no count back") {
    std::vector<double> raw;
    for (int ring = 0; ring < 16; ++ring)
      for (const double value : ramp(0, 0.1, 100)) raw.push_back(value);
    CHECK(infer_point_time(raw, stamp).status == PointTimeStatus::inferred);
  }

  TEST_CASE("a stamp in the middle of the sweep is kept there") {
    const auto raw = ramp(-0.05, 0.05);
    const auto found = infer_point_time(raw, stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.stamp == StampPlace::inside);
    const auto times = apply_point_time(found.rule, raw, stamp);
    CHECK((stamp - times.time).count() == 50'000'000);
    CHECK((times.end - stamp).count() == 50'000'000);
  }

  TEST_CASE("values that are no numbers are counted and take their predecessor's time") {
    auto raw = ramp(0, 0.1, 11);
    raw[0] = not_a_number;
    raw[5] = std::numeric_limits<double>::infinity();
    const auto found = infer_point_time(raw, stamp);
    REQUIRE(found.status == PointTimeStatus::inferred);
    CHECK(found.not_finite == 2);
    const auto times = apply_point_time(found.rule, raw, stamp);
    CHECK(times.replaced == 2);
    CHECK(times.offsets[5] == times.offsets[4]);
    CHECK(times.offsets[0] == 0.0F);
    check_bounds(times);
  }

  TEST_CASE("a later scan that spans more than a sweep is told apart, and its offsets still hold") {
    const PointTimeRule rule{.unit = TimeUnit::nanoseconds};
    const auto times = apply_point_time(rule, ramp(0, 1e10), stamp);
    CHECK_FALSE(times.plausible);
    check_bounds(times);
    CHECK(apply_point_time(rule, std::vector<double>{}, stamp).end == stamp);
  }

  TEST_CASE("times that no timestamp can state are refused, not wrapped") {
    CHECK_THROWS_AS((void)apply_point_time({.base = PointTimeBase::absolute}, ramp(1e18, 2e18), stamp),
                    std::invalid_argument);
    CHECK_THROWS_AS((void)apply_point_time({}, ramp(0, 9e9), stamp), std::invalid_argument);
    CHECK(infer_point_time(ramp(1e18, 1e18 + 1e17), std::nullopt).status != PointTimeStatus::inferred);
  }
}
