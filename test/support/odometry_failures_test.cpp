#include "support/odometry_failures.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "chainslam/core/timestamp.hpp"

namespace chainslam::support {

TEST_SUITE("support/odometry_failures") {
  TEST_CASE("steps that the map contradicts are found in their session, with times, way and error") {
    SlamMap map;
    const auto at = [](double x) { return SE3d(SO3d(), {x, 0, 0}); };
    for (int session = 0; session < 2; ++session) {
      Session added;
      added.id = SessionId{session};
      added.first_keyframe = 4 * session;
      added.keyframes = 4;
      map.sessions.push_back(added);
      for (int i = 0; i < 4; ++i) {
        const Index id = 4 * session + i;
        map.keyframes.push_back({.id = KeyframeId{id},
                                 .session = SessionId{session},
                                 .time = Timestamp::from_seconds(50 + 2 * i),
                                 .T_map_body = at(3 * i)});
        if (i == 0) continue;
        SqrtInformation<6> root = SqrtInformation<6>::Identity();
        root /= 0.05;  // metres and radians
        map.odometry.push_back({KeyframeId{id - 1}, KeyframeId{id}, at(3), root});
      }
    }
    CHECK(odometry_failures(map, map.sessions[0]).empty());
    // Closures put the second session's last two keyframes 0.6 m ahead: 12 deviations.
    for (const std::size_t i : {6U, 7U}) map.keyframes[i].T_map_body = at(3.0 * static_cast<double>(i - 4) + 0.6);
    CHECK(odometry_failures(map, map.sessions[0]).empty());
    const std::vector<OdometryFailure> failures = odometry_failures(map, map.sessions[1]);
    REQUIRE(failures.size() == 1);
    CHECK(failures[0].begin == doctest::Approx(2));
    CHECK(failures[0].end == doctest::Approx(4));
    CHECK(failures[0].distance == doctest::Approx(3));
    CHECK(failures[0].off == doctest::Approx(0.6));
    CHECK(failures[0].turned == doctest::Approx(0));
    CHECK(failures[0].squared_error == doctest::Approx(144));
    CHECK(odometry_failures(map, map.sessions[1], 145).empty());
  }
}

}  // namespace chainslam::support
