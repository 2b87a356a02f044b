#include "chainslam/io/g2o.hpp"

#include <doctest/doctest.h>

#include <numbers>

#include "support/files.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {
namespace {

G2oFile g2o(const std::string& text) {
  const TemporaryFolder folder;
  write_bytes(folder / "a.g2o", text);
  return read_g2o(folder / "a.g2o");
}

std::string g2o_error(const std::string& text) {
  return io_error([&] { return g2o(text).fixed.size(); });
}

const std::string edge_3d = "EDGE_SE3:QUAT 3 1 1 2 3 0 0 0 1 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21\n";

}  // namespace

TEST_SUITE("io/g2o") {
  TEST_CASE("vertices, edges with full information, FIX and unknown lines") {
    const G2oFile graph =
        g2o("# made by hand\r\nVERTEX_SE2 7 1.5 -2 3.0\r\n\nPARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT -3 1 2 3 "
            "0 0 1 0\n"
            "EDGE_SE2 7 8 1 2 -0.5 1 2 3 4 5 6\nVERTEX_XY 1 2 3\nVERTEX_XY 2 2 3\nFIX 7 9\nFIX 3\n" +
            edge_3d);
    REQUIRE(graph.planar.vertices.size() == 1);
    CHECK(graph.planar.vertices[0].id == 7);
    CHECK(graph.planar.vertices[0].pose.rotation().angle() == doctest::Approx(3.0).epsilon(1e-15));
    REQUIRE(graph.spatial.vertices.size() == 1);
    CHECK(graph.spatial.vertices[0].id == -3);
    CHECK(graph.spatial.vertices[0].pose.translation() == Eigen::Vector3d(1, 2, 3));
    REQUIRE(graph.planar.edges.size() == 1);
    Eigen::Matrix3d planar;
    planar << 1, 2, 3, 2, 4, 5, 3, 5, 6;
    CHECK(graph.planar.edges[0].information == planar);
    REQUIRE(graph.spatial.edges.size() == 1);
    CHECK(graph.spatial.edges[0].from == 3);
    CHECK(graph.spatial.edges[0].to == 1);
    const Matrix6d& information = graph.spatial.edges[0].information;
    CHECK(information == information.transpose());
    CHECK(information(0, 5) == 6);
    CHECK(information(1, 1) == 7);
    CHECK(information(2, 5) == 15);
    CHECK(information(5, 5) == 21);
    CHECK(graph.fixed == std::vector<std::int64_t>{7, 9, 3});
    CHECK(graph.unknown == std::map<std::string, Index>{{"PARAMS_SE3OFFSET", 1}, {"VERTEX_XY", 2}});
  }

  TEST_CASE("an empty file is an empty graph") { CHECK(g2o("").planar.edges.empty()); }

  TEST_CASE("errors name line and field") {
    CHECK(says(g2o_error("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 0 0 0\n"), "line 2, field id\n  found: 0 a second time"));
    CHECK(says(g2o_error("VERTEX_SE2 0 0 0 0\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n"), "line 2, field id"));
    CHECK(says(g2o_error("VERTEX_SE2 0 0 0\n"), "field theta"));
    CHECK(says(g2o_error("VERTEX_SE2 0 0 0 0 1\n"), "VERTEX_SE2 id x y theta"));
    CHECK(says(g2o_error("VERTEX_SE2 0.5 0 0 0\n"), "whole number"));
    CHECK(says(g2o_error("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0.9\n"), "unit quaternion"));
    CHECK(says(g2o_error("EDGE_SE2 1 1 0 0 0 1 0 0 1 0 1\n"), "to itself"));
    CHECK(says(g2o_error("EDGE_SE2 0 1 0 0 0 1 0 0 -1 0 1\n"), "negative"));
    CHECK(says(g2o_error("EDGE_SE2 0 1 0 0 0 1 0 0 nan 0 1\n"), "field information\n  found: 'nan'"));
    CHECK(says(g2o_error("EDGE_SE2 0 1 0 0 0 1 0 0 1 0\n"), "field information\n  found: the end"));
    CHECK(says(g2o_error(edge_3d.substr(0, edge_3d.size() - 1) + " 22\n"), "21 of the information"));
    CHECK(says(g2o_error("FIX\n"), "field id"));
    CHECK(says(g2o_error("EDGE_SE2 0 99999999999999999999 0 0 0 1 0 0 1 0 1\n"), "field to"));
  }

  TEST_CASE("any truncation gives an error or a graph") {
    for (std::size_t n = 0; n < edge_3d.size(); ++n) {
      G2oFile graph;
      const std::string error = io_error([&] {
        graph = g2o(edge_3d.substr(0, n));
        return 0;
      });
      // A cut keyword is an unknown line; a cut last number of two digits is still a number.
      const bool unknown = n < 13;
      const bool whole = n >= edge_3d.size() - 2;
      CHECK(error.empty() == (unknown || whole));
      CHECK(graph.spatial.edges.size() == (whole ? 1 : 0));
    }
  }

  TEST_CASE("a round trip changes nothing but the last bit of rotations") {
    const TemporaryFolder folder;
    G2oFile graph = g2o(edge_3d);
    graph.planar.vertices.push_back({5, SE2d(SO2d::from_angle(std::numbers::pi), {1.0 / 3, -1e-20})});
    graph.spatial.vertices.push_back(
        {1LL << 60, SE3d(SO3d::from_quaternion(Eigen::Quaterniond(0.1, 0.2, 0.3, -0.9)), {1e6 / 7, 0, -2})});
    graph.fixed = {5};
    graph.unknown["OTHER"] = 1;
    write_g2o(folder / "b.g2o", graph);
    const G2oFile back = read_g2o(folder / "b.g2o");
    CHECK(back.unknown.empty());
    CHECK(back.fixed == graph.fixed);
    CHECK(back.spatial.edges[0].information == graph.spatial.edges[0].information);
    CHECK(back.planar.vertices[0].pose.translation() == graph.planar.vertices[0].pose.translation());
    CHECK((back.planar.vertices[0].pose.matrix() - graph.planar.vertices[0].pose.matrix()).norm() < 1e-15);
    CHECK(back.spatial.vertices[0].id == 1LL << 60);
    CHECK((back.spatial.vertices[0].pose.matrix() - graph.spatial.vertices[0].pose.matrix()).norm() < 1e-15);
  }

  TEST_CASE("benchmark graphs are read whole") {
    // Counts of the collection's own README.
    struct Expected {
      const char* name;
      std::size_t planar_vertices, planar_edges, spatial_vertices, spatial_edges;
    };
    for (const Expected& e : {Expected{"sphere2500", 0, 0, 2500, 4949}, Expected{"cubicle", 0, 0, 5750, 16869},
                              Expected{"intel_1228", 1228, 1483, 0, 0}, Expected{"kitti_00", 0, 4677, 0, 0}})
      if (const auto path = real_data(std::string("pose_graphs/") + e.name + ".g2o")) {
        const G2oFile graph = read_g2o(*path);
        CHECK(graph.planar.vertices.size() == e.planar_vertices);
        CHECK(graph.planar.edges.size() == e.planar_edges);
        CHECK(graph.spatial.vertices.size() == e.spatial_vertices);
        CHECK(graph.spatial.edges.size() == e.spatial_edges);
        CHECK(graph.unknown.empty());
      }
  }
}

}  // namespace chainslam::test
