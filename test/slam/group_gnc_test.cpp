#include "chainslam/slam/group_gnc.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/slam/map_graph.hpp"

namespace chainslam {
namespace {

/// Rounds of a block, 5 m between keyframes: truth, and odometry that turns by `bend` radians a step too much, and once
/// slips and turns if `broken_at` is set.
struct Rounds {
  static constexpr Index a_round = 40;
  std::vector<SE3d> truth;
  std::vector<SE3d> odometry;

  explicit Rounds(Index keyframes, std::optional<Index> broken_at = {}, double bend = 0) {
    Rng rng(3);
    SE3d T_odom_body;
    for (Index i = 0; i < keyframes; ++i) {
      const double angle = 2 * 3.14159265358979 * i / a_round, radius = 5.0 * a_round / 6.283185307;
      truth.emplace_back(SO3d::exp({0, 0, angle}),
                         Eigen::Vector3d(radius * std::sin(angle), -radius * std::cos(angle), 0));
      if (i > 0) {
        Vector6d noise;
        for (int k = 0; k < 6; ++k) noise[k] = rng.normal(0, k < 3 ? 0.03 : 0.001);
        noise[5] += bend;
        if (i == broken_at) noise += (Vector6d() << 3, 2, 0, 0, 0, 0.5).finished();
        T_odom_body = T_odom_body * (truth[truth.size() - 2].inverse() * truth.back()).retract(noise);
      }
      odometry.push_back(T_odom_body);
    }
  }
};

/// A map that grows along a drive, with closures one round apart.
struct Growing {
  explicit Growing(const Rounds& drive, const MapGraphOptions& options = {}, const GroupGnc& gnc = {})

      : rounds(drive), graph(options, gnc) {}

  void drive_to(Index end, const Eigen::Vector3d* fix_bias = nullptr) {
    for (Index i = to_index(graph.map().keyframes.size()); i < end; ++i) {
      Keyframe keyframe{.time = Timestamp(seconds(i)), .T_odom_body = rounds.odometry[static_cast<std::size_t>(i)]};
      if (fix_bias) keyframe.gnss = fix(i, *fix_bias);
      graph.append(keyframe);
      if (graph.waiting_fixes() >= 10) CHECK(graph.optimise().ok());  // as the back end does
    }
  }
  [[nodiscard]] GnssFix fix(Index i, const Eigen::Vector3d& bias) {
    constexpr double earth_radius = 6378137;
    Eigen::Vector3d p = rounds.truth[static_cast<std::size_t>(i)].translation() + bias;
    for (int k = 0; k < 3; ++k) p[k] += rng.normal(0, 1.0);
    return {.position_ecef = {earth_radius + p.z(), p.x(), p.y()}, .quality = GnssQuality::three_dimensional};
  }
  /// @returns its position among the map's closures.
  Index close(Index from, Index to, const Eigen::Vector3d& off = Eigen::Vector3d::Zero(), Index cause = -1) {
    LoopClosure closure;
    closure.from = KeyframeId{from};
    closure.to = KeyframeId{to};
    closure.T_from_to = rounds.truth[static_cast<std::size_t>(from)].inverse() *
                        rounds.truth[static_cast<std::size_t>(to)] * SE3d(SO3d(), off);
    Vector6d sigmas;
    sigmas << 0.05, 0.05, 0.05, 0.005, 0.005, 0.005;
    closure.sqrt_information = NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
    closure.kind = cause < 0 ? ClosureKind::direct : ClosureKind::chained;
    closure.cause = cause;
    return graph.accept(closure);
  }
  /// Largest error along the drive, metres, under the best alignment.
  [[nodiscard]] double worst() const {
    std::vector<Eigen::Vector3d> estimates, truth;
    for (const Keyframe& keyframe : graph.map().keyframes) {
      estimates.push_back(keyframe.T_map_body.translation());
      truth.push_back(rounds.truth[static_cast<std::size_t>(keyframe.id.value)].translation());
    }
    const Sim3d aligned = umeyama(estimates, truth, false).value();
    double most = 0;
    for (std::size_t i = 0; i < truth.size(); ++i) most = std::max(most, (aligned * estimates[i] - truth[i]).norm());
    return most;
  }
  [[nodiscard]] ClosureVerdict verdict(Index closure) const {
    return graph.map().closures[static_cast<std::size_t>(closure)].verdict;
  }

  const Rounds& rounds;
  MapGraph<> graph;
  Rng rng{7};
};

const Eigen::Vector3d parallel_street(0, 8, 0);

}  // namespace

TEST_SUITE("slam/group_gnc") {
  TEST_CASE("a closure into a parallel street is left out with its chain, and does not move the map") {
    const Rounds rounds(70);
    Growing map(rounds);
    map.drive_to(41);
    map.close(0, 40);
    map.drive_to(46);
    map.close(5, 45);
    map.drive_to(51);
    const Index seed = map.close(10, 50, parallel_street);
    std::vector<Index> wrong{seed};
    for (Index k = 0; k < 12; ++k) wrong.push_back(map.close(k < 10 ? k : k + 1, 50, parallel_street, seed));
    REQUIRE(map.graph.optimise().ok());
    for (const Index closure : wrong) CHECK(map.verdict(closure) == ClosureVerdict::inconsistent);
    CHECK(map.worst() < 0.6);
    map.drive_to(60);
    const Index right = map.close(20, 59, {});
    REQUIRE(map.graph.converge().ok());
    CHECK(map.verdict(right) == ClosureVerdict::accepted);
    for (const Index closure : wrong) CHECK(map.verdict(closure) == ClosureVerdict::inconsistent);
    CHECK(map.worst() < 0.6);
  }

  TEST_CASE("least squares takes the same closures at their word") {
    const Rounds rounds(70);
    Growing map(rounds, {}, {.closures = 0, .odometry = 0});
    map.drive_to(41);
    map.close(0, 40);
    map.drive_to(51);
    map.close(10, 50, parallel_street);
    REQUIRE(map.graph.converge().ok());
    CHECK(map.worst() > 2);
  }

  TEST_CASE("where odometry broke, the second closure that says so is believed, and the one before it") {
    const Rounds rounds(75, 48);
    Growing map(rounds);
    map.drive_to(41);
    map.close(0, 40);
    std::vector<Index> after;
    for (const Index at : {55, 60, 65}) {
      map.drive_to(at + 1);
      after.push_back(map.close(at - Rounds::a_round, at));
      REQUIRE(map.graph.optimise().ok());
      if (after.size() < 2) CHECK(map.verdict(after.back()) == ClosureVerdict::inconsistent);
    }
    for (const Index closure : after) CHECK(map.verdict(closure) == ClosureVerdict::accepted);
    CHECK(map.worst() < 1.0);
  }

  TEST_CASE("fixes hold a drive that bends, whatever one of them says") {
    const Rounds rounds(240, {}, 0.002);
    const Eigen::Vector3d bias(1, -1, 2);
    double worst[2];
    for (const bool held : {false, true}) {
      MapGraphOptions options;
      options.gnss.enabled = held;
      Growing map(rounds, options);
      map.drive_to(60, &bias);
      map.graph.set_gnss(KeyframeId{59}, map.fix(59, {300, 0, 0}));
      map.drive_to(240, &bias);
      REQUIRE(map.graph.converge().ok());
      worst[held ? 1 : 0] = map.worst();
    }
    CHECK(worst[0] > 6);
    CHECK(worst[1] < 0.8 * worst[0]);
  }

  TEST_CASE("a map that is saved and loaded keeps what was decided") {
    const Rounds rounds(60);
    Growing map(rounds);
    map.drive_to(41);
    map.close(0, 40);
    map.drive_to(51);
    const Index wrong = map.close(10, 50, parallel_street);
    REQUIRE(map.graph.converge().ok());
    REQUIRE(map.verdict(wrong) == ClosureVerdict::inconsistent);
    MapGraph<> loaded;
    loaded.load(map.graph.map());
    REQUIRE(loaded.converge().ok());
    CHECK(loaded.map().closures[static_cast<std::size_t>(wrong)].verdict == ClosureVerdict::inconsistent);
    for (std::size_t i = 0; i < loaded.map().keyframes.size(); ++i)
      CHECK((loaded.map().keyframes[i].T_map_body.translation() - map.graph.map().keyframes[i].T_map_body.translation())
                .norm() < 1e-3);
  }
}

}  // namespace chainslam
