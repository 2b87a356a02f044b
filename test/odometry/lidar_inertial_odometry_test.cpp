#include "chainslam/odometry/lidar_inertial_odometry.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <limits>
#include <numbers>
#include <optional>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "odometry/inertial_trip.hpp"
#include "support/quick.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using Lio = LidarInertialOdometry<>;

SE3d placed(double x, double y, double z, double wx, double wy, double wz) {
  return SE3d(SO3d::exp({wx, wy, wz}), {x, y, z});
}
/// Rises smoothly from 0 to slope 1 at t = 0 ... 1 s.
double ramp(double t) { return t <= 0 ? 0.0 : t < 1 ? t * t * t * (1 - 0.5 * t) : t - 0.5; }
/// From rest through the hall, turning and nodding: up to 1.6 m/s and 0.7 rad/s.
SE3d stroll(double t) {
  const double s = ramp(t);
  return placed(1.5 * s - 0.1 * std::sin(3 * s), 1.2 * std::sin(0.5 * s), 0.1 * std::sin(2 * s), 0.03 * std::sin(2 * s),
                0.04 * std::sin(3 * s), 0.6 * std::sin(1.1 * s));
}
SE3d still(double) { return placed(1, 0, 0.2, 0.02, -0.03, 0.4); }
SE3d fast_start(double t) {
  return placed(-8 + 8 * t + 0.5 * t * t, 0.3 * std::sin(t), 0, 0, 0, 0.1 * std::sin(2 * t));
}
/// On the spot, about all axes.
SE3d tumbling(double t) {
  return placed(0.5 * std::sin(1.3 * t), 0.5 * std::sin(1.7 * t), 0.2 * std::sin(2.1 * t), 0.5 * std::sin(1.9 * t),
                0.4 * std::sin(2.3 * t), 0.6 * std::sin(1.1 * t));
}
SE3d upside_down(double t) { return stroll(t) * placed(0, 0, 0, std::numbers::pi, 0, 0); }
SE3d along_corridor(double t) {
  const double s = ramp(t);
  return placed(2 * s, 0.1 * std::sin(s), 0, 0, 0, 0.05 * std::sin(s));
}

double seconds_in(const Packet& packet) { return available_at(packet).to_seconds() - 10; }
/// Round and round the hall's middle at 2 m/s, once in `round` seconds, nodding; it starts in motion.
constexpr double round_time = 12;
SE3d rounds(double t) {
  const double a = 2 * std::numbers::pi / round_time * t;
  return placed(3 + 5 * std::cos(a), 1 + 4 * std::sin(a), 0.1 * std::sin(2 * a), 0, 0, a) *
         placed(0, 0, 0, 0.03 * std::sin(2 * a), 0.03 * std::cos(3 * a), 0);
}

/// Processes what a trip of `period` seconds yields over and over, each time that much later, and hands the frames to
/// `take`.
template <class Take>
void repeat(const InertialTrip& trip, double period, int times, Lio& odometry, Take&& take) {
  const std::vector<Packet> packets = trip.packets();
  for (int k = 0; k < times; ++k)
    for (Packet packet : packets) {
      if (seconds_in(packet) <= 0 && k > 0) continue;
      if (seconds_in(packet) > period + 1e-6) continue;
      const Duration later = seconds(k * period);
      if (auto* sample = std::get_if<ImuSample>(&packet)) sample->time = sample->time + later;
      if (auto* scan = std::get_if<LidarScan>(&packet)) {
        scan->time = scan->time + later;
        scan->end = scan->end + later;
      }
      if (auto frame = odometry.process(packet)) take(*frame);
    }
}

/// Takes packets as they are and after some mischief.
template <class Mischief>
std::vector<Packet> spoiled(std::vector<Packet> packets, Mischief&& mischief) {
  std::vector<Packet> kept;
  for (Packet& packet : packets)
    if (mischief(packet)) kept.push_back(std::move(packet));
  return kept;
}

struct Followed : TripOutcome {
  LidarInertialOdometryCounts counts;
};
Followed follow_stroll(const InertialTrip& trip, const std::vector<Packet>& packets, const Lio::Options& given = {}) {
  Lio::Options options = given;
  options.T_body_lidar = trip.T_body_lidar;
  Lio odometry(options);
  Followed followed;
  static_cast<TripOutcome&>(followed) = follow_trip(trip, packets, odometry);
  followed.counts = odometry.counts();
  MESSAGE("frames ", followed.frames.size(), ", lost ", followed.counts.lost_scans, ", max error ", followed.max_error,
          " m, ", followed.max_angle, " rad, at the end ", followed.last_error, " m, tilt ", followed.tilt);
  CHECK(followed.finite);
  return followed;
}

/// Frames that say so of the IMU.
auto count_use(const std::vector<Frame>& frames, std::optional<ImuUse> use) {
  return std::ranges::count_if(frames, [&](const Frame& frame) { return frame.health.imu_use == use; });
}

const InertialTrip& strolling() {
  static const InertialTrip trip{.pose = stroll, .T_body_lidar = placed(0.1, -0.05, 0.2, 0.02, 0.01, 0.5)};
  return trip;
}
const std::vector<Packet>& stroll_packets() {
  static const std::vector<Packet> packets = strolling().packets();
  return packets;
}

}  // namespace

TEST_SUITE("odometry/lidar_inertial_odometry") {
  TEST_CASE("a walk through a hall, with readings at 100 Hz") {
    const Followed run = follow_stroll(strolling(), stroll_packets());
    CHECK(run.frames.size() == 50);
    CHECK(run.counts.lost_scans == 0);
    CHECK(run.counts.unmeasured_scans == 0);
    CHECK(count_use(run.frames, std::nullopt) == 1);  // the first
    CHECK(count_use(run.frames, ImuUse::all) == 49);
    CHECK(run.max_error < 0.03);
    CHECK(run.max_angle < 0.006);
    CHECK(run.tilt < 0.02);
  }

  // As of a scanner that is not wired to the clock. Its times are off by up to 0.3 m of the way.
  TEST_CASE("the times of scans jitter by 15 ms at up to 6 m/s") {
    const InertialTrip trip{.pose =
                                [](double t) {
                                  return SE3d(SO3d::exp({0, 0, 0.5 * std::sin(0.7 * t)}),
                                              {6 * std::sin(t), 0.5 * std::sin(0.6 * t), 0.1 * std::sin(t)});
                                },
                            .scans = 100,
                            .clock_jitter = 0.015};
    const std::vector<Packet> packets = trip.packets();
    const auto followed = [&](double largest) {
      Lio::Options options;
      options.scan_clock.largest = largest;
      Lio odometry(options);
      TripOutcome run = follow_trip(trip, packets, odometry);
      double squared = 0;
      for (const Frame& frame : run.frames)
        squared +=
            (trip.truth(frame.time).inverse() * run.T_world_odom * frame.T_odom_body).translation().squaredNorm();
      run.last_error = std::sqrt(squared / static_cast<double>(run.frames.size()));
      MESSAGE("rms ", run.last_error, ", largest ", run.max_error, " m, IMU in ", count_use(run.frames, ImuUse::all),
              " of 100 frames, deviation ", odometry.scan_time_deviation());
      return std::pair(run, odometry.scan_time_deviation());
    };
    const auto [with, learned] = followed(ScanClockOptions{}.largest);
    const auto [without, none] = followed(0);
    CHECK(count_use(with.frames, ImuUse::all) > 95);
    CHECK(with.last_error < 0.1);
    CHECK(with.last_error < 0.7 * without.last_error);
    CHECK(std::abs(learned - 0.015) < 0.004);
    CHECK(none == 0);
  }

  TEST_CASE("by the gyroscope alone, as settings ask for: no frame is doubtful") {
    const Followed run = follow_stroll(strolling(), stroll_packets(), {.imu_use = ImuUse::gyroscope});
    CHECK(run.counts.lost_scans == 0);
    CHECK(count_use(run.frames, ImuUse::gyroscope) == 49);
    CHECK(run.counts.rejected_accelerations == 0);
    CHECK(std::ranges::count_if(run.frames, [](const Frame& frame) { return frame.health.doubtful(); }) == 0);
    CHECK(run.max_error < 0.03);
  }

  TEST_CASE("a walk with readings at 10 Hz, and with none at all" * doctest::skip(quick())) {
    InertialTrip slow = strolling();
    slow.imu_rate = 10;
    const Followed ten = follow_stroll(slow, slow.packets());
    CHECK(ten.counts.unmeasured_scans == 0);
    CHECK(ten.max_error < 0.03);
    InertialTrip blind = strolling();
    blind.imu_rate = 0;
    const Followed none = follow_stroll(blind, blind.packets());
    CHECK(none.frames.size() == 50);
    CHECK(none.counts.unmeasured_scans == 49);
    CHECK(count_use(none.frames, std::nullopt) == 50);
    CHECK(none.counts.lost_scans == 0);
    CHECK(none.max_error < 0.05);
  }

  TEST_CASE("the same bits on one thread and on two") {
    InertialTrip trip = strolling();
    trip.scans = 12;
    const std::vector<Packet> packets = trip.packets();
    Lio serial, parallel;
    const ThreadPool pool(2);
    const TripOutcome a = follow_trip(trip, packets, serial), b = follow_trip(trip, packets, parallel, pool);
    REQUIRE(a.frames.size() == b.frames.size());
    for (std::size_t i = 0; i < a.frames.size(); ++i) {
      CHECK(a.frames[i].T_odom_body == b.frames[i].T_odom_body);
      CHECK(a.frames[i].covariance == b.frames[i].covariance);
      CHECK(a.frames[i].cloud.positions == b.frames[i].cloud.positions);
    }
  }

  TEST_CASE("the preset of FAST-LIO2 walks as well, on its own map" * doctest::skip(quick())) {
    CHECK(fast_lio2_options().motion.rest_share == 1);  // quiet readings are of rest, as in its code
    using Map = IkdTree<float, NearestToCenter>;
    LidarInertialOdometryOptions<Trivial, NearestToCenter> options = fast_lio2_options();
    options.T_body_lidar = strolling().T_body_lidar;
    LidarInertialOdometry<Map, Trivial> odometry(options);
    const TripOutcome run = follow_trip(strolling(), stroll_packets(), odometry);
    MESSAGE("max error ", run.max_error, " m, ", run.max_angle, " rad");
    CHECK(run.max_error < 0.1);
  }

  TEST_CASE("a second without readings: scans alone carry the motion on" * doctest::skip(quick())) {
    const auto packets = spoiled(stroll_packets(), [](const Packet& packet) {
      return !std::holds_alternative<ImuSample>(packet) || seconds_in(packet) < 2 || seconds_in(packet) > 3;
    });
    const Followed run = follow_stroll(strolling(), packets);
    CHECK(run.frames.size() == 50);
    CHECK(run.counts.unmeasured_scans >= 8);
    CHECK(count_use(run.frames, ImuUse::none) == run.counts.unmeasured_scans);
    CHECK(run.counts.lost_scans == 0);
    CHECK(run.max_error < 0.05);
  }

  TEST_CASE("the unit's clock jumps, back and forth" * doctest::skip(quick())) {
    const auto packets = spoiled(stroll_packets(), [](Packet& packet) {
      auto* sample = std::get_if<ImuSample>(&packet);
      if (sample == nullptr) return true;
      const double t = seconds_in(packet);
      if (t > 1.5 && t < 2.2) sample->time = sample->time + seconds(100);  // which leaves those after in the past
      if (t > 3.5 && t < 3.7) sample->time = sample->time - seconds(1);
      return true;
    });
    const Followed run = follow_stroll(strolling(), packets);
    CHECK(run.frames.size() == 50);
    CHECK(run.counts.imu_restarts == 2);
    CHECK(run.counts.lost_scans == 0);
    CHECK(run.max_error < 0.05);
  }

  TEST_CASE("scans come twice, late and from the future" * doctest::skip(quick())) {
    std::vector<Packet> packets;
    for (const Packet& packet : stroll_packets()) {
      packets.push_back(packet);
      const auto* scan = std::get_if<LidarScan>(&packet);
      if (scan == nullptr || static_cast<int>(std::lround(10 * seconds_in(packet))) % 7 != 0) continue;
      packets.push_back(packet);
      LidarScan late = *scan;
      late.time = late.time - seconds(3);
      late.end = late.end - seconds(3);
      packets.emplace_back(late);
    }
    const Followed run = follow_stroll(strolling(), packets);
    CHECK(run.frames.size() == 50);
    CHECK(run.counts.out_of_order_scans >= 12);
    CHECK(run.max_error < 0.03);
  }

  TEST_CASE("three scans of ten are lost on the way" * doctest::skip(quick())) {
    Rng rng(41);
    const auto packets = spoiled(stroll_packets(), [&](const Packet& packet) {
      return !std::holds_alternative<LidarScan>(packet) || rng.uniform() > 0.3;
    });
    const Followed run = follow_stroll(strolling(), packets);
    CHECK(run.frames.size() < 45);
    CHECK(run.counts.lost_scans == 0);
    CHECK(run.max_error < 0.04);
  }

  TEST_CASE("broken points are left out, broken scans and readings give no frame") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    int index = 0;
    const auto packets = spoiled(stroll_packets(), [&](Packet& packet) {
      if (auto* sample = std::get_if<ImuSample>(&packet)) {
        if (++index % 50 == 0) sample->gyro.x() = std::numeric_limits<double>::infinity();
        return true;
      }
      auto& points = std::get<LidarScan>(packet).cloud.positions;
      const bool whole = static_cast<int>(std::lround(10 * seconds_in(packet))) % 10 == 0;
      for (std::size_t i = 0; i < points.size(); i += whole ? 1 : 9) points[i].y() = nan;
      return true;
    });
    const Followed run = follow_stroll(strolling(), packets);
    CHECK(run.frames.size() == 45);
    CHECK(run.counts.empty_scans == 5);
    CHECK(run.counts.imu.not_finite == 12);
    CHECK(run.max_error < 0.04);
  }

  TEST_CASE("a gyroscope at the end of its range counts for little" * doctest::skip(quick())) {
    constexpr double range = 0.3;  // of a motion of up to 0.7 rad/s
    const auto clipped = spoiled(stroll_packets(), [&](Packet& packet) {
      if (auto* sample = std::get_if<ImuSample>(&packet)) sample->gyro = sample->gyro.cwiseMax(-range).cwiseMin(range);
      return true;
    });
    Lio::Options options;
    options.motion.imu.gyro_range = range;
    const Followed known = follow_stroll(strolling(), clipped, options);
    CHECK(known.counts.clipped_imu_samples > 100);
    CHECK(known.counts.lost_scans == 0);
    CHECK(known.max_error < 0.05);
  }

  TEST_CASE("a corridor without ends: its direction is reported, and held by the inertial unit" *
            doctest::skip(quick())) {
    InertialTrip trip{.world = corridor(), .pose = along_corridor, .scans = 40};
    const Followed run = follow_stroll(trip, trip.packets());
    CHECK(run.counts.degenerate_scans >= 25);
    const Matrix6d& covariance = run.frames.back().covariance;
    CHECK(covariance(0, 0) > 20 * covariance(1, 1));  // along against across
    const SE3d end = run.T_world_odom * run.frames.back().T_odom_body;
    CHECK(std::abs(end.translation().y() - trip.truth(run.frames.back().time).translation().y()) < 0.03);
    CHECK(run.max_error < 1.1);  // of 7 m, by an accelerometer with a bias of 5 cm/s^2
    CHECK(std::abs(trip.truth(run.frames.back().time).translation().x() - end.translation().x()) <
          4 * std::sqrt(covariance(0, 0)));
  }

  // Ten with CHAINSLAM_FULL, else four.
  TEST_CASE("standing still for minutes, nothing creeps and nothing grows" * doctest::skip(quick())) {
    InertialTrip trip{.pose = still, .scans = 60, .spinner = {.rings = 16, .columns = 60}};
    Lio odometry;
    std::vector<std::size_t> points, memory;
    std::optional<SE3d> first;
    double error = 0, angle = 0;
    const int times = full() ? 100 : 40;
    repeat(trip, 6, times, odometry, [&](const Frame& frame) {
      if (!first) first = frame.T_odom_body;
      const Vector6d moved = first->local(frame.T_odom_body);
      error = std::max(error, moved.head<3>().norm());
      angle = std::max(angle, moved.tail<3>().norm());
      points.push_back(odometry.local_map().size());
      memory.push_back(odometry.local_map().memory());
    });
    MESSAGE("max error ", error, " m, ", angle, " rad; map ", points.front(), ", ", points[600], ", ", points.back());
    CHECK(to_index(points.size()) == times * trip.scans);
    CHECK(odometry.counts().lost_scans == 0);
    CHECK(error < 0.01);
    CHECK(angle < 2e-3);
    CHECK(memory.back() == memory[600]);
    CHECK(static_cast<double>(points.back()) < 1.05 * static_cast<double>(points[600]));
  }

  // Twelve hours at 10 Hz with CHAINSLAM_FULL, else four minutes.
  TEST_CASE("for hours, from a start in motion: neither memory nor time grow" * doctest::skip(quick())) {
    InertialTrip trip{.pose = rounds, .scans = 120, .spinner = {.rings = 16, .columns = 48}};
    const int times = full() ? 3600 : 20;
    Lio odometry;
    std::vector<double> seconds_by_round;
    std::size_t points = 0, memory = 0;
    std::optional<SE3d> T_world_odom;
    const double way = 28.4 * times;  // metres
    double error = 0, error_in_map = 0;
    int frames = 0;
    timespec last{};
    repeat(trip, round_time, times, odometry, [&](const Frame& frame) {
      const SE3d truth = trip.truth(frame.time);
      if (!T_world_odom) T_world_odom = truth * frame.T_odom_body.inverse();
      const auto off = [&](const SE3d& T) { return (truth.translation() - *T_world_odom * T.translation()).norm(); };
      error = std::max(error, off(frame.T_odom_body));
      error_in_map = std::max(error_in_map, off(odometry.T_odom_map().inverse() * frame.T_odom_body));
      if (++frames % trip.scans != 0) return;
      timespec now{};
      clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
      seconds_by_round.push_back(static_cast<double>(now.tv_sec - last.tv_sec) +
                                 1e-9 * static_cast<double>(now.tv_nsec - last.tv_nsec));
      last = now;
      if (to_index(seconds_by_round.size()) != times / 10) return;
      points = odometry.local_map().size();
      memory = odometry.local_map().memory();
    });
    const auto tenth = static_cast<std::ptrdiff_t>(times / 10);
    std::nth_element(seconds_by_round.begin() + tenth, seconds_by_round.begin() + tenth * 3 / 2,
                     seconds_by_round.begin() + 2 * tenth);
    std::nth_element(seconds_by_round.end() - tenth, seconds_by_round.end() - tenth / 2, seconds_by_round.end());
    const double early = *(seconds_by_round.begin() + tenth * 3 / 2), late = *(seconds_by_round.end() - tenth / 2);
    MESSAGE(frames, " frames, lost ", odometry.counts().lost_scans, ", max error ", error, " m, in the map ",
            error_in_map, " m, map ", points, " to ", odometry.local_map().size(), " points, ", memory, " to ",
            odometry.local_map().memory(), " bytes, ", 1e3 * early / trip.scans, " to ", 1e3 * late / trip.scans,
            " ms a scan");
    CHECK(frames == times * trip.scans);
    CHECK(odometry.counts().lost_scans == 0);
    // Its map holds the body for ever. Levelled, each step is turned by what gravity's direction is taken for then: a
    // thousandth of a degree off makes 1.7 m of the 100 km of twelve hours.
    CHECK(error_in_map < 0.05);
    CHECK(error < 0.05 + 2e-5 * way);
    CHECK(odometry.local_map().memory() == memory);
    CHECK(static_cast<double>(odometry.local_map().size()) < 1.05 * static_cast<double>(points));
    CHECK(late < (full() ? 1.5 : 3.0) * early);  // of minutes, what else the machine does is a large part
  }

  TEST_CASE("what levels a map turns it about the body, by as much as up has moved since the start") {
    InertialState x;
    x.get<Inertial::position>() = R3d(Eigen::Vector3d(100, -50, 3));
    x.get<Inertial::up>() = S2d::from_vector({0.01, 0.02, 1});
    x.get<Inertial::tilt>() = R2d(Eigen::Vector2d(0.004, -0.003));
    detail::TiltCorrection tilt_correction;
    tilt_correction.follow(x);
    CHECK((tilt_correction.T_odom_map() * x.get<Inertial::position>().value() - x.get<Inertial::position>().value())
              .norm() < 1e-9);
    const Eigen::Vector3d turned = tilt_correction.T_odom_map().rotation() * x.get<Inertial::up>().direction();
    const Eigen::Vector3d moved = x.get<Inertial::up>().direction() - turned;
    CHECK((moved.head<2>() - x.get<Inertial::tilt>().value()).norm() < 1e-4);
  }

  TEST_CASE("mounted upside down, odom's +z still points up" * doctest::skip(quick())) {
    InertialTrip trip{.pose = upside_down, .scans = 30};
    const Followed run = follow_stroll(trip, trip.packets());
    CHECK(run.tilt < 0.02);
    CHECK(run.counts.lost_scans == 0);
    CHECK(run.max_error < 0.03);
  }

  TEST_CASE("a start at full speed, speeding up") {
    InertialTrip trip{.pose = fast_start, .scans = 20};
    const Followed run = follow_stroll(trip, trip.packets());
    CHECK(run.counts.lost_scans == 0);
    CHECK(run.max_error < 0.06);
    CHECK(run.tilt < 0.12);  // it speeds up by 1 m/s^2 where only the mean force tells what is up
  }

  TEST_CASE("too many points: the farthest go, and are counted" * doctest::skip(quick())) {
    InertialTrip trip = strolling();
    trip.scans = 20;
    Lio::Options options;
    options.local_map.max_points = 2000;
    options.T_body_lidar = trip.T_body_lidar;
    Lio odometry(options);
    const TripOutcome run = follow_trip(trip, trip.packets(), odometry);
    CHECK(odometry.local_map().size() <= 2000);
    CHECK(odometry.counts().evicted_points > 0);
    CHECK(run.max_error < 0.1);
  }

  TEST_CASE("a mounting that is a little off is found while the body turns" * doctest::skip(quick())) {
    InertialTrip trip{.pose = tumbling, .T_body_lidar = strolling().T_body_lidar};
    const std::vector<Packet> packets = trip.packets();
    Lio::Options options;
    for (const double off : {0.005, 0.02, 0.03}) {  // radians about each of two axes: 0.4, 1.6 and 2.4 degrees in all
      CAPTURE(off);
      options.T_body_lidar = trip.T_body_lidar * placed(0, 0, 0, 0.0, off, -off);
      Lio odometry(options);
      static_cast<void>(follow_trip(trip, packets, odometry));
      const double left = T_body_lidar(odometry.state()).rotation().local(trip.T_body_lidar.rotation()).norm();
      MESSAGE("mounting: ", left, " rad of ", std::sqrt(2.0) * off, " left, gyroscope doubted in ",
              odometry.counts().rejected_rates, " scans");
      CHECK(left < 0.004);
      CHECK(odometry.counts().mounting_resets == 0);
      CHECK(odometry.counts().rejected_rates <= 8);  // of 50
    }
    options.max_mounting_rotation = 1e-4;
    Lio bounded(options);
    static_cast<void>(follow_trip(trip, packets, bounded));
    CHECK(bounded.counts().mounting_resets >= 1);
    CHECK(T_body_lidar(bounded.state()) == options.T_body_lidar);
  }
}
