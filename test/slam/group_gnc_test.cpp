#include "chainslam/slam/group_gnc.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "slam/rounds.hpp"

namespace chainslam {
namespace {

using test::Growing;
using test::Rounds;

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
    REQUIRE(map.graph.optimize().ok());
    for (const Index closure : wrong) CHECK(map.verdict(closure) == ClosureVerdict::inconsistent);
    CHECK(map.worst() < 0.6);
    map.drive_to(60);
    const Index right = map.close(20, 59, {});
    REQUIRE(map.graph.converge().ok());
    CHECK(map.verdict(right) == ClosureVerdict::accepted);
    for (const Index closure : wrong) CHECK(map.verdict(closure) == ClosureVerdict::inconsistent);
    CHECK(map.worst() < 0.6);
  }

  TEST_CASE("a map that has converged shows in one pass that nothing changes any more") {
    const Rounds rounds(70);
    Growing map(rounds);
    map.drive_to(41);
    map.close(0, 40);
    map.drive_to(51);
    map.close(10, 50, parallel_street);
    REQUIRE(map.graph.converge().ok());
    const auto updates = map.graph.smoother().revision();
    REQUIRE(map.graph.converge().ok());
    CHECK(map.graph.smoother().revision() - updates == 2);  // an update, and a step that gains nothing
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
    const Rounds rounds(75, {48});
    Growing map(rounds);
    map.drive_to(41);
    map.close(0, 40);
    std::vector<Index> after;
    for (const Index at : {55, 60, 65}) {
      map.drive_to(at + 1);
      after.push_back(map.close(at - Rounds::a_round, at));
      REQUIRE(map.graph.optimize().ok());
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
      options.gnss.correlation_time = 5;  // errors of these fixes do not last
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

  TEST_CASE("where a drive ends behind a step that failed, its fixes say so") {
    for (const Index end : {200, 191}) {  // 18 fixes, and 9, behind that step
      const Rounds rounds(end, {182}, 0, 1.4);
      const Eigen::Vector3d bias(1, -1, 2);
      double worst[2];
      for (const bool judged : {false, true}) {
        Growing map(rounds, {}, judged ? GroupGnc{} : GroupGnc{.odometry = 0});
        map.period = 5;
        map.drive_to(end, &bias);
        REQUIRE(map.graph.converge().ok());
        worst[judged ? 1 : 0] = map.worst();
        if (!judged) continue;
        MapGraph<> loaded;
        loaded.load(map.graph.map());
        REQUIRE(loaded.converge().ok());
        CHECK((loaded.map().keyframes.back().T_map_body.translation() -
               map.graph.map().keyframes.back().T_map_body.translation())
                  .norm() < 1);
      }
      MESSAGE("largest error ", worst[0], " -> ", worst[1], " m");
      CHECK(worst[0] > 12);
      CHECK(worst[1] < 4);
    }
  }

  TEST_CASE("fixes that are off for a while, or from some place on, do not make good odometry fail") {
    const Rounds rounds(240);
    const Eigen::Vector3d bias(1, -1, 2);
    for (const double off : {10.0, 20.0, 30.0})
      for (const Index end : {160, 240}) {
        CAPTURE(off);
        CAPTURE(end);
        Growing with(rounds), never(rounds, {}, {.odometry = 0});
        for (Growing* map : {&with, &never}) {
          map->period = 5;
          map->drive_to(140, &bias);
          const Eigen::Vector3d reflected = bias + Eigen::Vector3d(off, 0, 0);
          map->drive_to(end, &reflected);
          map->drive_to(240, &bias);
          REQUIRE(map->graph.converge().ok());
        }
        MESSAGE("off by ", off, " m up to ", end, ": ", with.worst(), ", never judged ", never.worst(), " m");
        CHECK(with.worst() < 1.02 * never.worst() + 0.05);
      }
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
