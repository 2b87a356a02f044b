#include "chainslam/slam/odometry_noise.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "chainslam/slam/map_graph.hpp"
#include "slam/street.hpp"
#include "support/property.hpp"

namespace chainslam {

TEST_SUITE("slam/relative_covariance") {
  TEST_CASE("what no optimization has taken in is as uncertain as if one had, along a chain") {
    test::for_all(10, [](Rng& rng, int) {
      MapGraph<> graph;
      graph.begin_session("");
      SE3d T_odom_body;
      const auto drive = [&](Index end) {
        for (Index i = to_index(graph.map().keyframes.size()); i < end; ++i) {
          graph.append(test::keyframe_at(i, T_odom_body));
          T_odom_body = T_odom_body * SE3d(SO3d::exp({0, 0, rng.uniform(-0.3, 0.3)}), {2, 0.1, 0});
        }
      };
      drive(20);
      REQUIRE(graph.optimize().ok());
      drive(40);
      const auto known = [&](Index from, Index to) {
        return relative_covariance(graph.smoother(), graph.map(), KeyframeId{from}, KeyframeId{to});
      };
      const std::vector<Matrix6d> before{known(5, 15), known(5, 19), known(5, 20), known(5, 39), known(19, 30)};
      REQUIRE(graph.optimize().ok());
      const std::vector<Matrix6d> after{known(5, 15), known(5, 19), known(5, 20), known(5, 39), known(19, 30)};
      for (std::size_t i = 0; i < before.size(); ++i) {
        CHECK(before[i](0, 0) > 0);
        CHECK((before[i] - after[i]).norm() < 1e-6 * after[i].norm());
      }
      CHECK(known(7, 7).isZero(0));
    });
  }
}

}  // namespace chainslam
