#include <doctest/doctest.h>

#include <cmath>
#include <cstddef>
#include <vector>

#include "chainslam/slam/gravity_measurement.hpp"
#include "chainslam/slam/map_graph.hpp"
#include "slam/street.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {
namespace upright {

constexpr double standard = 9.80665;  // m/s^2

/// Where a body is that drives over hills and around bends, a frame each 0.1 s.
SE3d T_world_body(double t) {
  const SO3d heading = SO3d::exp({0, 0, 0.12 * t}),
             lean = SO3d::exp({0.05 * std::sin(0.4 * t), 0.08 * std::cos(0.3 * t), 0});
  return SE3d(heading * lean, {30 * std::sin(0.12 * t), 30 - 30 * std::cos(0.12 * t), 2 * std::sin(0.2 * t)});
}

struct Drive {
  double duration = 60;
  SE3d T_odom_world{};          ///< at the start
  double pitch_drift = 0;       ///< rad/s, of odometry
  double accel_bias = 0;        ///< m/s^2, along x and y of the body
  double position_noise = 0.0;  ///< metres
  bool measured = true;
  std::uint64_t seed = 1;
};

/// Frames of a drive: delta velocities of the true motion, poses as odometry has them.
std::vector<FrameRecord> frames_of(const Drive& drive) {
  constexpr double dt = 0.1, h = 1e-3;
  Rng rng(drive.seed);
  std::vector<FrameRecord> frames;
  SE3d T_odom_body = drive.T_odom_world * T_world_body(0);
  for (int i = 0; i * dt < drive.duration; ++i) {
    const double t = i * dt;
    FrameRecord frame{.session = SessionId{0}, .time = Timestamp::from_seconds(t)};
    frame.covariance = PackedCovariance(Matrix6d(1e-6 * Matrix6d::Identity()));
    if (i > 0) {
      const SE3d step = T_world_body(t - dt).inverse() * T_world_body(t);
      T_odom_body = T_odom_body * step * SE3d(SO3d::exp({0, drive.pitch_drift * dt, 0}), Eigen::Vector3d::Zero());
      const auto velocity = [&](double at) -> Eigen::Vector3d {
        return (T_world_body(at + h).translation() - T_world_body(at - h).translation()) / (2 * h);
      };
      const Eigen::Vector3d gained = velocity(t) - velocity(t - dt) + Eigen::Vector3d(0, 0, standard * dt);
      const Eigen::Vector3d bias(drive.accel_bias * dt, drive.accel_bias * dt, 0);
      if (drive.measured) frame.delta_velocity = (T_world_body(t).rotation().inverse() * gained + bias).cast<float>();
    }
    frame.T_odom_body = T_odom_body;
    for (int axis = 0; axis < 3; ++axis)
      frame.T_odom_body =
          SE3d(frame.T_odom_body.rotation(),
               frame.T_odom_body.translation() + rng.normal(0, drive.position_noise) * Eigen::Vector3d::Unit(axis));
    frames.push_back(frame);
  }
  return frames;
}

/// Adds frames, and every tenth as a keyframe.
template <class Graph>
void add(Graph& graph, const std::vector<FrameRecord>& frames) {
  for (std::size_t i = 0; i < frames.size(); ++i) {
    graph.append(std::span(frames).subspan(i, 1));
    if (i % 10 != 0) continue;
    Keyframe keyframe;
    keyframe.time = frames[i].time;
    keyframe.T_odom_body = frames[i].T_odom_body;
    graph.append(std::move(keyframe));
  }
}

void map(MapGraph<>& graph, const std::vector<FrameRecord>& frames) {
  graph.begin_session("a");
  add(graph, frames);
  REQUIRE(graph.optimize().ok());
  REQUIRE(graph.converge().ok());
}

SlamMap mapped(const std::vector<FrameRecord>& frames, const MapGraphOptions& options = {}) {
  MapGraph<> graph(options);
  map(graph, frames);
  return graph.map();
}

/// A second session, `frames`, that is joined to the graph's first.
void join(MapGraph<>& graph, const std::vector<FrameRecord>& frames) {
  graph.begin_session("b");
  add(graph, frames);
  LoopClosure closure{.from = {30}, .to = {90}, .T_from_to = {}, .kind = ClosureKind::merge};
  closure.sqrt_information = SqrtInformation<6>::Identity() / 0.05;
  graph.join(closure);
  graph.accept(closure);
  REQUIRE(graph.optimize().ok());
  REQUIRE(graph.converge().ok());
}

/// The largest angle between where keyframes of a session have up and where it is, radians.
double most_tilted(const SlamMap& map, Index session = 0) {
  double most = 0;
  for (const Keyframe& one : map.keyframes)
    if (one.session == SessionId{session}) {
      const Eigen::Vector3d up = one.T_map_body.rotation() * (T_world_body(one.time.to_seconds()).rotation().inverse() *
                                                              Eigen::Vector3d(Eigen::Vector3d::UnitZ()));
      most = std::max(most, std::acos(std::min(1.0, up.z())));
    }
  return most;
}

const SE3d leaning(SO3d::exp({0.04, -0.03, 1.0}), {5, 6, 7});

}  // namespace upright
}  // namespace

TEST_SUITE("slam/gravity") {
  using namespace upright;

  TEST_CASE("the direction against gravity, whatever the motion and odometry's frame") {
    test::for_all(20, [](Rng& rng, int) {
      const SE3d T_odom_world = test::random_motion(rng, 100, 3);
      const std::vector<FrameRecord> frames = frames_of({.T_odom_world = T_odom_world});
      const auto begin = static_cast<std::size_t>(rng.uniform_index(400)),
                 length = static_cast<std::size_t>(30 + rng.uniform_index(150));
      const auto window = std::span(frames).subspan(begin, length);
      const auto measured = measure_gravity(window, {});
      REQUIRE(measured);
      CHECK(measured->up.norm() == doctest::Approx(1));
      CHECK((measured->up - T_odom_world.rotation() * Eigen::Vector3d::UnitZ()).norm() <
            1e-3);  // velocities are means of 0.4 s
    });
  }

  TEST_CASE("no direction where the force was not measured, scans were lost, or it cannot be gravity") {
    std::vector<FrameRecord> frames = frames_of({.duration = 10});
    REQUIRE(measure_gravity(frames, {}));
    CHECK_FALSE(measure_gravity(std::span(frames).first(7), {}));
    const auto after = [&](auto change) {
      std::vector<FrameRecord> changed = frames;
      change(changed[50]);
      return measure_gravity(changed, {}).has_value();
    };
    CHECK_FALSE(after([](FrameRecord& frame) { frame.delta_velocity.reset(); }));
    CHECK_FALSE(after([](FrameRecord& frame) { frame.health.status = FrameStatus::lost; }));
    CHECK_FALSE(after([](FrameRecord& frame) { frame.health.map_restarted = true; }));
    CHECK(after([](FrameRecord& frame) { frame.health.status = FrameStatus::degenerate; }));
    for (FrameRecord& frame : frames)
      if (frame.delta_velocity) *frame.delta_velocity *= 0.102F;  // in units of g
    CHECK_FALSE(measure_gravity(frames, {}));
  }

  TEST_CASE("what is stated covers a MEMS accelerometer's bias of 10 mg") {
    double squares = 0;
    int count = 0;
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
      const std::vector<FrameRecord> frames = frames_of(
          {.duration = 10.1, .accel_bias = seed % 2 == 0 ? 0.098 : -0.098, .position_noise = 0.02, .seed = seed});
      const auto measured = measure_gravity(frames, {});
      REQUIRE(measured);
      squares += (measured->up - Eigen::Vector3d::UnitZ()).squaredNorm() / (measured->sigma * measured->sigma) / 2;
      ++count;
    }
    CHECK(squares / count > 0.3);
    CHECK(squares / count < 2.0);
  }

  TEST_CASE("odometry that leans and pitches is held upright, and is not without measurements or when told not to") {
    const Drive drive{.T_odom_world = leaning, .pitch_drift = 0.001};
    const SlamMap held = mapped(frames_of(drive));
    CHECK(most_tilted(held) < 0.015);  // what it drifts by in one and a half windows
    Drive unmeasured = drive;
    unmeasured.measured = false;
    CHECK(most_tilted(mapped(frames_of(unmeasured))) > 0.05);
    CHECK(most_tilted(mapped(frames_of(drive), {.gravity = {.enabled = false}})) > 0.05);
    // Position and heading of the start stay.
    const Keyframe& first = held.keyframes.front();
    CHECK((first.T_map_body.translation() - first.T_odom_body.translation()).norm() < 1e-3);
    const SO3d turned = first.T_odom_body.rotation().inverse() * first.T_map_body.rotation();
    CHECK(std::abs(turned.log().dot(first.T_odom_body.rotation().inverse() *
                                    Eigen::Vector3d(Eigen::Vector3d::UnitZ()))) < 1e-3);
  }

  TEST_CASE("two directions are enough for a frame to stand upright") {
    CHECK(most_tilted(mapped(frames_of({.duration = 25, .T_odom_world = leaning}))) < 1e-3);
  }

  TEST_CASE("a direction far off is an outlier, a doubtful one is not") {
    const auto tilted_by = [](float off) {
      std::vector<FrameRecord> frames = frames_of({});
      for (std::size_t i = 201; i <= 300; ++i) {  // one window
        const Eigen::Vector3f aside = off * Eigen::Vector3f(0.1F * static_cast<float>(standard), 0, 0);
        *frames[i].delta_velocity += aside;
      }
      return most_tilted(mapped(frames));
    };
    CHECK(tilted_by(0.07F) > 0.01);  // it counts
    CHECK(tilted_by(0.13F) < 1e-4);
    CHECK(tilted_by(0.3F) < 1e-4);
  }

  TEST_CASE("sessions that are joined stay upright, and a map that is loaded is held as before") {
    MapGraph<> graph;
    map(graph, frames_of({.T_odom_world = leaning, .pitch_drift = 0.001}));
    join(graph, frames_of({.T_odom_world = leaning.inverse(), .pitch_drift = -0.002}));
    CHECK(most_tilted(graph.map(), 0) < 0.015);
    CHECK(most_tilted(graph.map(), 1) < 0.03);

    MapGraph<> again;
    again.load(graph.map());
    REQUIRE(again.converge().ok());
    for (std::size_t i = 0; i < again.map().keyframes.size(); ++i) {
      const SE3d moved = graph.map().keyframes[i].T_map_body.inverse() * again.map().keyframes[i].T_map_body;
      CHECK(moved.log().norm() < 1e-4);
    }
  }

  TEST_CASE("a session with measurements does not bend a map whose first session has none") {
    MapGraph<> graph;
    map(graph, frames_of({.T_odom_world = leaning, .measured = false}));
    const SlamMap before = graph.map();
    join(graph, frames_of({}));
    for (std::size_t i = 0; i < before.keyframes.size(); ++i)
      CHECK((before.keyframes[i].T_map_body.inverse() * graph.map().keyframes[i].T_map_body).log().norm() < 1e-5);
  }

  TEST_CASE("a delta velocity that is not finite is refused") {
    std::vector<FrameRecord> frames = frames_of({.duration = 1});
    frames[3].delta_velocity->x() = std::nanf("");
    MapGraph<> graph;
    graph.begin_session("a");
    CHECK_THROWS_AS(graph.append(std::span<const FrameRecord>(frames)), std::invalid_argument);
  }
}
}  // namespace chainslam
