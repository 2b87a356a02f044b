#include "chainslam/odometry/detail/scan_clock.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

#include "chainslam/core/random.hpp"

using namespace chainslam;

namespace {

/// A body on a winding way, its scans by a clock that jitters, and what its accelerometer measures.
struct JitteringScans {
  double jitter = 0;                        ///< deviation of a scan's time, seconds
  double offset = 0;                        ///< that all are late by, seconds
  double registration = 0;                  ///< deviation of the scans' positions, metres
  double speed = 8;                         ///< m/s
  double interval = 0.1;                    ///< seconds from scan to scan
  Eigen::Vector3d bias{0.05, -0.03, 0.04};  ///< of the specific force, m/s^2
  Rng rng{5};
  double time = 0;

  static constexpr double pace = 0.2;  ///< rad/s, of the turns
  [[nodiscard]] Eigen::Vector3d position(double t) const {
    return speed / pace * Eigen::Vector3d(std::sin(pace * t), std::cos(pace * t), 0);
  }
  [[nodiscard]] Eigen::Vector3d velocity(double t) const {
    return speed * Eigen::Vector3d(std::cos(pace * t), -std::sin(pace * t), 0);
  }
  [[nodiscard]] Eigen::Vector3d noise(double deviation) {
    return {rng.normal(0, deviation), rng.normal(0, deviation), rng.normal(0, deviation)};
  }

  /// Goes on to the next scan.
  void follow(detail::ScanClock& clock) {
    const Eigen::Vector3d up(0, 0, 9.81);
    const double begin = time, dt = interval;
    time += dt;
    const Eigen::Vector3d gain = velocity(time) - velocity(begin);
    const Eigen::Vector3d way = position(time) - position(begin) - dt * velocity(begin);
    const detail::ImuComparison comparison{.interval = dt,
                                           .force = gain / dt + up + bias,
                                           .force_way = way + 0.5 * dt * dt * (up + bias),
                                           .up = up,
                                           .expected_up = up};
    const double taken = time + offset + rng.normal(0, jitter);
    clock.follow(comparison, position(taken) + noise(registration), velocity(time));
  }
};

double deviation_after(double seconds, JitteringScans scans, const ScanClockOptions& options = {}) {
  detail::ScanClock clock(options);
  for (int i = 0; i < std::lround(seconds / scans.interval); ++i) scans.follow(clock);
  return clock.deviation();
}

/// Equations of a pose, of a time error and of both, r = r0 + A (pose, time).
struct PoseAndTime {
  Eigen::Matrix<double, 20, 6> A;
  Eigen::Matrix<double, 20, 1> r0;
  Vector6d twist;
  double deviation = 0.02;

  explicit PoseAndTime(Rng& rng) {
    for (int i = 0; i < A.size(); ++i) A.data()[i] = rng.normal(0, 30);
    for (int i = 0; i < 20; ++i) r0[i] = rng.normal(0, 1);
    for (int i = 0; i < 6; ++i) twist[i] = rng.normal(0, i < 3 ? 5 : 0.3);
  }
  /// Squared error of a step of the pose with a time error.
  [[nodiscard]] double cost(const Vector6d& step, double time) const {
    return (r0 + A * (step + time * twist)).squaredNorm() + time * time / (deviation * deviation);
  }
  /// The time error at which that is least.
  [[nodiscard]] double best_time(const Vector6d& step) const {
    const Eigen::Matrix<double, 20, 1> by_time = A * twist;
    return -by_time.dot(r0 + A * step) / (by_time.squaredNorm() + 1 / (deviation * deviation));
  }
};

}  // namespace

TEST_SUITE("odometry/scan_clock") {
  TEST_CASE("a pose later on the way, and how it changes with time") {
    const detail::MomentaryMotion motion{.velocity = {3, -2, 0.5}, .rate = {0.1, -0.2, 0.7}};
    const SE3d T(SO3d::exp({0.3, -0.5, 1.1}), {1, 2, 3});
    CHECK((motion.later(T, 0).inverse() * T).log().norm() == 0);
    for (const double time : {-0.04, 0.0, 0.03}) {
      constexpr double h = 1e-5;
      const Vector6d change = motion.later(T, time - h).local(motion.later(T, time + h)) / (2 * h);
      CHECK((change - motion.twist(motion.later(T, time).rotation())).norm() < 1e-6);
    }
  }

  TEST_CASE("equations freed of the time error cost what the best time error leaves") {
    Rng rng(3);
    for (int run = 0; run < 20; ++run) {
      const PoseAndTime problem(rng);
      Matrix6d H = problem.A.transpose() * problem.A;
      Vector6d g = -problem.A.transpose() * problem.r0;
      double squared_error = problem.r0.squaredNorm();
      detail::TimeError time(problem.deviation);
      time.eliminate(problem.twist, H, g, squared_error);
      CHECK(time.step() == doctest::Approx(problem.best_time(zeros<Vector6d>())));
      Vector6d step;
      for (int i = 0; i < 6; ++i) step[i] = rng.normal(0, 0.1);
      const double best = problem.best_time(step);
      CHECK(squared_error - 2 * g.dot(step) + step.dot(H * step) == doctest::Approx(problem.cost(step, best)));
      time.follow(step);
      CHECK(time.value() == doctest::Approx(best));
      CHECK(time.squared_error() == doctest::Approx(std::pow(best / problem.deviation, 2)));

      // From there on, the residuals are those at that time error.
      H = problem.A.transpose() * problem.A;
      const Eigen::Matrix<double, 20, 1> r = problem.r0 + problem.A * (step + best * problem.twist);
      g = -problem.A.transpose() * r;
      squared_error = r.squaredNorm();
      time.eliminate(problem.twist, H, g, squared_error);
      CHECK(time.step() == doctest::Approx(0).scale(1e-6));
      CHECK(squared_error == doctest::Approx(problem.cost(step, best)));
    }
  }

  TEST_CASE("an exact time changes nothing") {
    Rng rng(3);
    const PoseAndTime problem(rng);
    const Matrix6d before = problem.A.transpose() * problem.A;
    Matrix6d H = before;
    Vector6d g = -problem.A.transpose() * problem.r0;
    double squared_error = 1;
    detail::TimeError time;
    time.eliminate(problem.twist, H, g, squared_error);
    time.follow(problem.twist);
    CHECK(time.exact());
    CHECK(H == before);
    CHECK(squared_error == 1);
    CHECK(time.value() == 0);
    CHECK(time.step() == 0);
    CHECK(time.squared_error() == 0);
  }

  TEST_CASE("jitter is found, whatever the speed and the rate of the scans; an offset does not count") {
    for (const double interval : {0.05, 0.1, 0.2})
      for (const double speed : {1.3, 10.0})
        for (const double jitter : {0.008, 0.015}) {
          CAPTURE(interval);
          CAPTURE(speed);
          const double learned = deviation_after(
              300, {.jitter = jitter, .offset = 0.02, .registration = 0.003, .speed = speed, .interval = interval},
              {.memory = 150});
          CHECK(std::abs(learned / jitter - 1) < 0.12);
        }
  }

  TEST_CASE("it is known in two seconds") {
    CHECK(detail::ScanClock().deviation() == 0);
    CHECK(deviation_after(2, {.jitter = 0.015}) > 0.009);
    CHECK(deviation_after(10, {.jitter = 0.015}) > 0.012);
  }

  TEST_CASE("a clock that is right is known as such, whatever registration leaves") {
    CHECK(deviation_after(10, {}) == 0);
    for (const double registration : {0.003, 0.01}) {
      CHECK(deviation_after(60, {.registration = registration}) == 0);
      CHECK(deviation_after(60, {.registration = registration, .speed = 1.3}) < 4e-3);
      CHECK(deviation_after(60, {.registration = registration, .speed = 1e-3}) == 0);
    }
    CHECK(deviation_after(60, {.jitter = 1e-3}) == 0);  // as much as registration leaves at 3 m/s
    CHECK(deviation_after(60, {.jitter = 3e-3}) > 2.4e-3);
    for (std::uint64_t seed = 1; seed <= 50; ++seed) {  // nor is it blamed for the first scans of a slow start
      CAPTURE(seed);
      for (const double seconds : {1.0, 2.0, 3.0})
        CHECK(deviation_after(seconds, {.registration = 0.003, .speed = 0.3, .rng = Rng(seed)}) < 0.01);
    }
  }

  TEST_CASE("jitter that comes or ceases is followed within half a minute") {
    detail::ScanClock clock;
    JitteringScans scans{.registration = 0.003};
    for (int i = 0; i < 600; ++i) scans.follow(clock);
    scans.jitter = 0.015;
    for (int i = 0; i < 300; ++i) scans.follow(clock);
    CHECK(clock.deviation() > 0.011);
    scans.jitter = 0;
    for (int i = 0; i < 900; ++i) scans.follow(clock);
    CHECK(clock.deviation() < 0.005);
  }

  TEST_CASE("one scan that is registered to a wrong place does not make the clock unusable") {
    detail::ScanClock clock;
    JitteringScans scans{.registration = 0.003};
    for (int i = 0; i < 300; ++i) scans.follow(clock);
    detail::ImuComparison comparison{.interval = 0.1, .force = {0, 0, 9.81}, .expected_up = {0, 0, 9.81}};
    clock.follow(comparison, scans.position(scans.time) + 20 * scans.velocity(scans.time).normalized(),
                 scans.velocity(scans.time));
    scans.time += 0.1;
    for (int i = 0; i < 3; ++i) scans.follow(clock);
    CHECK(clock.deviation() < 0.006);
    CHECK(deviation_after(60, {.jitter = 0.2}) <= ScanClockOptions{}.largest);
  }

  TEST_CASE("positions on both sides of an interruption are not compared") {
    detail::ScanClock clock;
    JitteringScans scans;
    for (int i = 0; i < 100; ++i) scans.follow(clock);
    const auto jump = [&](const auto& interrupt) {
      scans.time += 5;
      interrupt();
      for (int i = 0; i < 5; ++i) scans.follow(clock);
      CHECK(clock.deviation() == 0);
    };
    jump([&] { clock.interrupt(); });
    jump([&] { clock.follow({}, scans.position(scans.time), scans.velocity(scans.time)); });
    jump([&] {  // too long for an acceleration to say where the body was
      const detail::ImuComparison gap{.interval = 0.3, .force = {0, 0, 9.81}, .expected_up = {0, 0, 9.81}};
      clock.follow(gap, scans.position(scans.time), scans.velocity(scans.time));
    });
  }

  TEST_CASE("it can be left out") { CHECK(deviation_after(60, {.jitter = 0.015}, {.largest = 0}) == 0); }
}
