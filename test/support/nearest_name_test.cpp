#include "support/nearest_name.hpp"

#include <doctest/doctest.h>

#include <string>
#include <vector>

namespace chainslam::support {

TEST_SUITE("support/nearest_name") {
  TEST_CASE("a slip of the fingers finds the name that was meant") {
    const std::vector<std::string> names{"map", "simulate", "inspect", "optimize"};
    CHECK(nearest_name("mpa", names) == "map");
    CHECK(nearest_name("simulte", names) == "simulate");
    CHECK(nearest_name("optimize", names) == "optimize");
    CHECK(nearest_name("inspects", names) == "inspect");
  }

  TEST_CASE("of dotted names, a right last part is near in any table") {
    CHECK(nearest_name("closures.outlier_treshold", {"graph.gnss", "closures.outlier_threshold"}) ==
          "closures.outlier_threshold");
    CHECK(nearest_name("map.voxel_size", {"odometry.max_range", "odometry.voxel_size"}) == "odometry.voxel_size");
  }

  TEST_CASE("what is like nothing finds nothing, and long names cost little") {
    CHECK(!nearest_name("zzzz", {"map", "simulate"}));
    CHECK(!nearest_name("", {}));
    CHECK(!nearest_name(std::string(1'000'000, 'x'), {"map"}));
  }

  TEST_CASE("a suggestion is a question, or nothing") {
    CHECK(suggestion("mpa", {"map", "eval"}) == "; did you mean 'map'?");
    CHECK(suggestion("zzzz", {"map", "eval"}).empty());
  }
}

}  // namespace chainslam::support
