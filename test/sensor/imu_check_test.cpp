#include "chainslam/sensor/imu_check.hpp"

#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "chainslam/core/random.hpp"
#include "support/real_imu.hpp"

using namespace chainslam;

namespace {

constexpr double one_degree = std::numbers::pi / 180;

/// A rocking and turning body with noise.
std::vector<ImuSample> rocking_body(double rate, double duration, std::uint64_t seed = 3) {
  Rng rng(seed);
  std::vector<ImuSample> samples;
  for (int i = 0; i < static_cast<int>(rate * duration); ++i) {
    const double t = i / rate, roll = 0.2 * std::sin(2 * t);
    const Eigen::AngleAxisd R(roll, Eigen::Vector3d::UnitX());
    const auto noise = [&](double s) { return Eigen::Vector3d(rng.normal(0, s), rng.normal(0, s), rng.normal(0, s)); };
    samples.push_back(
        {Timestamp::from_seconds(100 + t),
         Eigen::Vector3d(0.4 * std::cos(2 * t), 0, 0) + R.inverse() * Eigen::Vector3d(0, 0, 0.3) + noise(1e-3),
         R.inverse() * Eigen::Vector3d(0, 0, 9.81) + noise(0.02)});
  }
  return samples;
}

struct Checked {
  std::vector<ImuSample> samples;
  ImuCheckCounts counts;
  ImuUnits units;
};

Checked checked(const std::vector<ImuSample>& samples, const ImuCheckOptions& options = {}) {
  ImuCheck check(options);
  Checked result;
  for (const ImuSample& sample : samples)
    check.add(sample, [&](const ImuSample& passed) { result.samples.push_back(passed); });
  result.counts = check.counts();
  result.units = check.units();
  return result;
}

/// Largest difference of samples to those of the same time in `truth`, of rate and force.
double largest_error(const std::vector<ImuSample>& samples, const std::vector<ImuSample>& truth) {
  double largest = 0;
  auto of_time = truth.begin();
  for (const ImuSample& sample : samples) {
    while (of_time != truth.end() && of_time->time < sample.time) ++of_time;
    if (of_time == truth.end() || of_time->time != sample.time) return std::numeric_limits<double>::infinity();
    largest = std::max({largest, (sample.gyro - of_time->gyro).norm(), (sample.accel - of_time->accel).norm()});
  }
  return largest;
}

double any_size(Rng& rng) { return (rng.uniform() < 0.5 ? -1 : 1) * std::pow(10.0, 3 + 27 * rng.uniform()); }

bool in_order(const std::vector<ImuSample>& samples) {
  for (std::size_t i = 1; i < samples.size(); ++i)
    if (samples[i].time <= samples[i - 1].time) return false;
  return true;
}

}  // namespace

TEST_SUITE("sensor/imu_check") {
  TEST_CASE("real recordings pass as they are, each sample at once") {
    for (const test::RealImu& stream : test::real_imu_streams()) {
      CAPTURE(stream.name);
      REQUIRE(stream.samples.size() > 1000);
      ImuCheck check;
      std::size_t passed = 0, waited = 0, given = 0;
      bool untouched = true;
      for (const ImuSample& sample : stream.samples) {
        ++given;
        check.add(sample, [&](const ImuSample& out) {
          untouched = untouched && out.rate_measured && out.force_measured &&
                      (out.time != sample.time || (out.gyro == sample.gyro && out.accel == sample.accel));
          ++passed;
        });
        if (passed + static_cast<std::size_t>(check.counts().rejected()) < given) ++waited;
      }
      CHECK(untouched);
      CHECK(waited <= 1);                     // one after these
      CHECK(check.counts().rejected() <= 4);  // LI-Init's IMU stopped for 4 rows
      CHECK(check.counts().rejected() == check.counts().repeated);
      CHECK(check.counts().from_degrees == 0);
      CHECK(check.counts().from_g == 0);
    }
  }

  TEST_CASE("real recordings with one row in a hundred spoilt: all of it goes, and nothing else") {
    for (const test::RealImu& stream : test::real_imu_streams()) {
      CAPTURE(stream.name);
      Rng rng(7);
      std::vector<ImuSample> spoilt = stream.samples;
      std::size_t spikes = 0;
      for (ImuSample& sample : spoilt) {
        if (rng.uniform() > 0.01) continue;
        ++spikes;
        const auto axis = static_cast<Eigen::Index>(rng.uniform() * 6) % 6;
        (axis < 3 ? sample.gyro[axis] : sample.accel[axis - 3]) = any_size(rng);
      }
      const Checked result = checked(spoilt);
      CHECK(static_cast<std::size_t>(result.counts.rejected()) >= spikes);
      CHECK(static_cast<std::size_t>(result.counts.rejected()) <= spikes + 5);
      CHECK(largest_error(result.samples, stream.samples) == 0);
    }
  }

  TEST_CASE("spikes of some strong shocks' size go, too, where the rest is smooth") {
    const auto truth = rocking_body(100, 20);
    auto spoilt = truth;
    int spikes = 0;
    for (std::size_t i = 50; i < spoilt.size(); i += 97, ++spikes)
      (spikes % 2 == 0 ? spoilt[i].gyro : spoilt[i].accel).y() += spikes % 2 == 0 ? 4 : -80;
    const Checked result = checked(spoilt);
    CHECK(result.counts.spikes == spikes);
    CHECK(result.counts.rejected() == spikes);
    CHECK(largest_error(result.samples, truth) == 0);
  }

  TEST_CASE("a pothole's shock, which rings for some samples, passes whole") {
    auto samples = rocking_body(200, 20);
    for (std::size_t hole = 300; hole + 40 < samples.size(); hole += 500)
      for (std::size_t i = 0; i < 40; ++i)
        samples[hole + i].accel.z() += 150 * std::exp(-0.1 * static_cast<double>(i)) * std::cos(static_cast<double>(i));
    CHECK(checked(samples).counts.rejected() == 0);
  }

  TEST_CASE("vibration of any kind is believed within a quarter second") {
    Rng rng(5);
    for (const double amplitude : {20.0, 80.0, 200.0}) {
      auto noise = rocking_body(200, 10), regular = noise, beats = noise;
      for (std::size_t i = 1000; i < noise.size(); ++i) {
        noise[i].accel += Eigen::Vector3d(rng.normal(0, amplitude), rng.normal(0, amplitude), rng.normal(0, amplitude));
        regular[i].accel.z() += i % 3 == 0 ? amplitude : 0;
        beats[i].gyro.x() += i % 10 == 0 ? 0.1 * amplitude : 0;
      }
      CHECK(checked(noise).counts.rejected() == 0);
      CHECK(checked(regular).counts.rejected() <= 17);
      CHECK(checked(beats).counts.rejected() <= 40);  // of 100: rare enough to be errors at first
    }
  }

  TEST_CASE("numbers that are not finite go, wherever they stand") {
    constexpr double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
    const auto truth = rocking_body(100, 2);
    for (const double bad : {nan, inf, -inf})
      for (int axis = 0; axis < 6; ++axis) {
        auto spoilt = truth;
        for (const std::size_t i : {0U, 1U, 2U, 50U, 51U, 199U})
          (axis < 3 ? spoilt[i].gyro[axis] : spoilt[i].accel[axis - 3]) = bad;
        const Checked result = checked(spoilt);
        CHECK(result.counts.not_finite == 6);
        CHECK(result.counts.rejected() == 6);
        CHECK(largest_error(result.samples, truth) == 0);
      }
  }

  TEST_CASE("rows written twice count once, with their own time or a later one") {
    for (const double later : {0.0, 0.004}) {
      const auto truth = rocking_body(100, 5);
      std::vector<ImuSample> doubled;
      for (const ImuSample& sample : truth) {
        doubled.push_back(sample);
        doubled.push_back(sample);
        doubled.back().time = sample.time + seconds(later);
      }
      const Checked result = checked(doubled);
      CHECK(result.counts.repeated == static_cast<std::int64_t>(truth.size()));
      CHECK(result.samples.size() == truth.size());
      CHECK(largest_error(result.samples, truth) == 0);
    }
  }

  TEST_CASE("a spike that is written twice goes") {
    auto spoilt = rocking_body(100, 5);
    const auto truth = spoilt;
    spoilt[100].gyro.x() += 5;
    spoilt.insert(spoilt.begin() + 101, spoilt[100]);
    const Checked result = checked(spoilt);
    CHECK(result.counts.spikes == 1);
    CHECK(result.counts.repeated == 1);
    CHECK(largest_error(result.samples, truth) == 0);
  }

  TEST_CASE("an IMU that stops, and repeats its last row, measures nothing; constant numbers are passed on slowly") {
    auto stopped = rocking_body(100, 5);
    for (std::size_t i = 301; i < 400; ++i) {
      stopped[i].gyro = stopped[300].gyro;
      stopped[i].accel = stopped[300].accel;
    }
    CHECK(checked(stopped).counts.repeated == 99);
    std::vector<ImuSample> constant = rocking_body(100, 5);
    for (ImuSample& sample : constant) {
      sample.gyro = constant[0].gyro;
      sample.accel = constant[0].accel;
    }
    CHECK(checked(constant).samples.size() == 50);
  }

  TEST_CASE("an axis that repeats its value while the others change is not believed until it moves again") {
    for (int axis = 0; axis < 6; ++axis) {
      auto samples = rocking_body(100, 10);
      const auto of = [&](std::size_t i) -> double& {
        return axis < 3 ? samples[i].gyro[axis] : samples[i].accel[axis - 3];
      };
      for (std::size_t i = 301; i < 700; ++i) of(i) = of(300);
      const Checked result = checked(samples);
      CHECK(result.counts.rejected() == 0);
      CHECK((axis < 3 ? result.counts.stuck_gyro : result.counts.stuck_accel) == 700 - 320);
      CHECK((axis < 3 ? result.counts.stuck_accel : result.counts.stuck_gyro) == 0);
      CHECK(result.samples[320].rate_measured == (axis >= 3));
      CHECK(result.samples[320].force_measured == (axis < 3));
      CHECK(result.samples[700].rate_measured);
      CHECK(result.samples[700].force_measured);
    }
  }

  TEST_CASE("axes of coarse resolution, which often repeat their values, are not stuck") {
    auto samples = rocking_body(100, 60);
    for (ImuSample& sample : samples) {
      sample.gyro = (sample.gyro / 0.002).array().round() * 0.002;
      sample.accel = (sample.accel / 0.04).array().round() * 0.04;
    }
    const Checked result = checked(samples);
    CHECK(result.counts.stuck_gyro == 0);
    CHECK(result.counts.stuck_accel == 0);
    CHECK(result.counts.rejected() == result.counts.repeated);
    CHECK(result.counts.repeated < 100);
  }

  TEST_CASE("rows of a second IMU go, of another car or turned by any right angle; the first is kept") {
    const auto streams = test::real_imu_streams();
    if (streams.size() < 2) return;
    const std::vector<ImuSample>& first = streams[0].samples;
    const Eigen::Vector3d x = Eigen::Vector3d::UnitX(), z = Eigen::Vector3d::UnitZ();
    const Eigen::Matrix3d rolled = Eigen::AngleAxisd(std::numbers::pi / 2, x).toRotationMatrix();
    const Eigen::Matrix3d over = Eigen::AngleAxisd(std::numbers::pi, x).toRotationMatrix();
    const Eigen::Matrix3d turned = rolled * Eigen::AngleAxisd(std::numbers::pi, z).toRotationMatrix();
    for (const Eigen::Matrix3d& R : {rolled, over, turned})
      for (const double later : {0.0, 0.005}) {
        std::vector<ImuSample> both;
        for (const ImuSample& sample : first) {
          both.push_back(sample);
          both.push_back({sample.time + seconds(later), R * sample.gyro, R * sample.accel});
        }
        const Checked result = checked(both);
        const auto rows = static_cast<std::int64_t>(first.size());
        CHECK(result.counts.second_imu > rows - 30);
        CHECK(result.counts.rejected() <= rows);
        const std::vector<ImuSample> settled(result.samples.begin() + 60, result.samples.end());
        CHECK(largest_error(settled, first) == 0);
      }
    // With rows missing here and there.
    std::vector<ImuSample> holed;
    for (std::size_t i = 0; i < first.size(); ++i) {
      if (i % 100 != 50) holed.push_back(first[i]);
      if (i % 90 != 45)
        holed.push_back({first[i].time + seconds(0.005), rolled * first[i].gyro, rolled * first[i].accel});
    }
    const Checked of_holed = checked(holed);
    const std::vector<ImuSample> settled(of_holed.samples.begin() + 60, of_holed.samples.end());
    CHECK(largest_error(settled, first) == 0);
    CHECK(static_cast<double>(of_holed.samples.size()) > 0.98 * static_cast<double>(first.size()));
    // Of another drive: alike where both cars drive straight on.
    const std::vector<ImuSample>& other = streams[1].samples;
    std::vector<ImuSample> both;
    for (std::size_t i = 0; i < other.size(); ++i) {
      both.push_back(first[i]);
      both.push_back({first[i].time + seconds(0.004), other[i].gyro, other[i].accel});
    }
    const Checked result = checked(both);
    double wrong = 0;
    for (const ImuSample& sample : result.samples) {
      const auto of_time = std::ranges::lower_bound(first, sample.time, {}, &ImuSample::time);
      if (of_time == first.end() || of_time->time != sample.time) ++wrong;
    }
    MESSAGE("rows of another drive that pass: ", wrong / static_cast<double>(other.size()));
    CHECK(wrong < 0.05 * static_cast<double>(other.size()));
  }

  TEST_CASE("units are inferred on the way or given, for acceleration at the fourth sample") {
    const auto truth = rocking_body(100, 20);
    for (const bool in_g : {false, true})
      for (const bool in_degrees : {false, true}) {
        auto samples = truth;
        for (ImuSample& sample : samples) {
          if (in_g) sample.accel /= 9.80665;
          if (in_degrees) sample.gyro /= one_degree;
        }
        const Checked inferred = checked(samples);
        CHECK(inferred.counts.from_g == (in_g ? 1997 : 0));
        CHECK((inferred.counts.from_degrees > 1600) == in_degrees);
        CHECK((inferred.samples.back().gyro - truth.back().gyro).norm() < 1e-12);
        CHECK((inferred.samples.back().accel - truth.back().accel).norm() < 1e-12);
        ImuUnits units;
        if (in_g) units.accel = AccelUnit::g;
        if (in_degrees) units.gyro = GyroUnit::degrees_per_second;
        const Checked given = checked(samples, {.units = units});
        CHECK(largest_error(given.samples, truth) < 1e-12);
        CHECK(given.counts.from_degrees == (in_degrees ? 2000 : 0));
      }
  }

  TEST_CASE("a time that jumps for one row is that row's error; where time runs on from there, the clock was set") {
    const auto truth = rocking_body(100, 5);
    for (const double off : {-1000.0, -3.0, -0.5, 0.5, 3.0, 1e6}) {
      auto samples = truth;
      samples[200].time = samples[200].time + seconds(off);
      const Checked wrong = checked(samples);
      CHECK(wrong.counts.invalid_times == 1);
      CHECK(wrong.counts.rejected() == 1);
      CHECK(largest_error(wrong.samples, truth) == 0);
      for (std::size_t i = 201; i < samples.size(); ++i) samples[i].time = samples[i].time + seconds(off);
      const Checked set = checked(samples);
      CHECK(set.counts.rejected() == 0);
      CHECK(set.samples.size() == samples.size());
    }
    auto swapped = truth;
    for (std::size_t i = 10; i < 300; i += 20) std::swap(swapped[i], swapped[i + 1]);
    const Checked result = checked(swapped);
    CHECK(result.counts.out_of_order == 15);
    CHECK(in_order(result.samples));
  }

  TEST_CASE("10 Hz to 1 kHz, with gaps: nothing goes, and only the sample after a gap waits") {
    for (const double rate : {10.0, 25.0, 50.0, 100.0, 200.0, 400.0, 1000.0}) {
      CAPTURE(rate);
      auto samples = rocking_body(rate, 30);
      for (ImuSample& sample : samples)
        if (sample.time > Timestamp::from_seconds(110)) sample.time = sample.time + seconds(2.5);
      CHECK(checked(samples).samples.size() == samples.size());
      const std::size_t before_gap = static_cast<std::size_t>(10 * rate) + 1;
      samples.resize(before_gap + 1);
      CHECK(checked(samples).samples.size() == before_gap);
    }
  }

  TEST_CASE("nothing that passes is ever out_of_range or out of order, whatever comes") {
    for (std::uint64_t seed = 0; seed < 200; ++seed) {
      CAPTURE(seed);
      Rng rng(seed);
      auto samples = rocking_body(100, 5, seed);
      for (ImuSample& sample : samples) {
        if (rng.uniform() < 0.2) sample.gyro[static_cast<Eigen::Index>(3 * rng.uniform()) % 3] = any_size(rng);
        if (rng.uniform() < 0.2) sample.accel[static_cast<Eigen::Index>(3 * rng.uniform()) % 3] = any_size(rng);
        if (rng.uniform() < 0.1) sample.time = sample.time + seconds(rng.uniform(-0.1, 0.1));
        if (rng.uniform() < 0.1) sample.accel.x() = std::numeric_limits<double>::quiet_NaN();
      }
      const Checked result = checked(samples, {.units = ImuUnits{}});
      bool plausible = true;
      for (const ImuSample& sample : result.samples)
        plausible = plausible && sample.gyro.cwiseAbs().maxCoeff() <= 100 && sample.accel.cwiseAbs().maxCoeff() <= 1000;
      CHECK(plausible);
      CHECK(in_order(result.samples));
      const auto left = result.counts.received - result.counts.rejected();
      CHECK(left - static_cast<std::int64_t>(result.samples.size()) >= 0);
      CHECK(left - static_cast<std::int64_t>(result.samples.size()) <= 1);  // the last may still wait
    }
  }

  TEST_CASE("no samples, one sample, and a stream of nothing but errors") {
    CHECK(checked({}).samples.empty());
    CHECK(checked({rocking_body(100, 1)[0]}).samples.size() == 1);
    auto samples = rocking_body(100, 1);
    for (ImuSample& sample : samples) sample.gyro.z() = 1e30;
    const Checked result = checked(samples);
    CHECK(result.samples.empty());
    CHECK(result.counts.out_of_range == 100);
  }
}
