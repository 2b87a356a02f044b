#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/ply.hpp"
#include "program/drawn_map.hpp"
#include "program/las_reader.hpp"
#include "program/run_program.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::test;

constexpr double equator = 6378137.0, flattening = 1 / 298.257223563, squared = flattening * (2 - flattening);

/// T_ecef_enu of a place on the prime meridian of its zone, by the closed form.
SE3d east_north_up(double latitude, double longitude, double height) {
  const double normal = equator / std::sqrt(1 - squared * std::sin(latitude) * std::sin(latitude));
  const Eigen::Vector3d up(std::cos(latitude) * std::cos(longitude), std::cos(latitude) * std::sin(longitude),
                           std::sin(latitude));
  const Eigen::Vector3d east(-std::sin(longitude), std::cos(longitude), 0), north = up.cross(east);
  Eigen::Matrix3d R;
  R << east, north, up;
  const Eigen::Vector3d t = (normal + height) * up - Eigen::Vector3d(0, 0, squared * normal * std::sin(latitude));
  return SE3d(SO3d::from_matrix(R), t);
}

/// The length of a meridian from the equator (Snyder 1987, Map Projections, equation 3-21).
double meridian(double latitude) {
  const double e2 = squared, e4 = e2 * e2, e6 = e4 * e2;
  return equator *
         ((1 - e2 / 4 - 3 * e4 / 64 - 5 * e6 / 256) * latitude -
          (3 * e2 / 8 + 3 * e4 / 32 + 45 * e6 / 1024) * std::sin(2 * latitude) +
          (15 * e4 / 256 + 45 * e6 / 1024) * std::sin(4 * latitude) - 35 * e6 / 3072 * std::sin(6 * latitude));
}

ProgramResult exported(const fs::path& root, const fs::path& map, const std::string& format, const fs::path& out,
                       const std::string& options) {
  return run_program(root, "export " + quoted(map) + " --format " + format + " --out " + quoted(out) + " " + options);
}

void check_bounds(const LasFile& las) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    double least = 1e300, most = -1e300;
    for (std::uint64_t i = 0; i < las.points; ++i) {
      least = std::min(least, las.coordinate(i, axis));
      most = std::max(most, las.coordinate(i, axis));
    }
    CHECK(las.least(axis) == least);
    CHECK(las.most(axis) == most);
  }
}

}  // namespace

TEST_SUITE("program/las_export") {
  TEST_CASE("without fixes, the points are those of the PLY, in the map's frame, with session, time and intensity") {
    const ScratchFolder scratch("las");
    const fs::path root = scratch.path(), map = root / "a.cslam";
    const SlamMap drawn = drawn_map(2, false, Timestamp::from_seconds(10));
    save_map(map, drawn);
    for (const std::string voxel : {"--voxel 0", "--voxel 0.5"}) {
      CAPTURE(voxel);
      const ProgramResult result = exported(root, map, "las", root / "a.las", voxel + " --overwrite");
      CAPTURE(result.errors);
      REQUIRE(result.exit_code == 0);
      REQUIRE(exported(root, map, "ply", root / "a.ply", voxel + " --overwrite").exit_code == 0);
      CHECK(contains(result.output, "georeference none: "));
      CHECK(contains(result.output, "GPS time     seconds of the data set's own clock, which is not UTC\n"));
      CHECK(contains(result.output, "intensity    the sensor's, up to 0.9975"));
      const LasFile las(root / "a.las");
      const PointCloud<float> ply = read_ply(root / "a.ply");
      REQUIRE(las.points == ply.size());
      CHECK(las.wkt().empty());
      CHECK(!las.has_bit(0));
      CHECK(las.has_bit(4));
      check_bounds(las);
      double most = 0;
      for (std::uint64_t i = 0; i < las.points; ++i)
        for (std::size_t axis = 0; axis < 3; ++axis)
          most = std::max(
              most, std::abs(las.coordinate(i, axis) - double{ply.positions[i][static_cast<Eigen::Index>(axis)]}));
      CHECK(most <= 0.0005 + 1e-9);
      if (voxel != "--voxel 0") continue;
      REQUIRE(las.points == 2 * 24 * 400);
      for (std::uint64_t i = 0; i < las.points; ++i) {
        const std::uint64_t k = i % 400;
        const Keyframe& keyframe = drawn.keyframes[i / 400];
        CHECK(las.source(i) == keyframe.session.value);
        CHECK(las.returns(i) == 0x11);
        CHECK(las.intensity(i) == std::lround(static_cast<double>(k) / 400 * 65535));
        CHECK(std::abs(las.gps_time(i) - (keyframe.time.to_seconds() + static_cast<double>(k) / 4000 - 0.05)) < 1e-6);
      }
    }
    const std::string same = read_text(root / "a.las");
    REQUIRE(exported(root, map, "las", root / "b.las", "--voxel 0.5").exit_code == 0);
    CHECK(read_text(root / "b.las") == same);
    CHECK(exported(root, map, "las", root / "b.las", "").exit_code == 4);  // which is there
    CHECK(read_text(root / "b.las") == same);
  }

  TEST_CASE("with fixes, coordinates are UTM and state their system; Unix times become GPS time") {
    const ScratchFolder scratch("las_utm");
    const fs::path root = scratch.path(), map = root / "a.cslam";
    for (const double hemisphere : {1.0, -1.0}) {
      CAPTURE(hemisphere);
      const double latitude = hemisphere * 48 * std::numbers::pi / 180, longitude = 9 * std::numbers::pi / 180;
      const SE3d T_ecef_enu = east_north_up(latitude, longitude, 10);
      const SE3d T_enu_map(SO3d::exp({0, 0, 0.7}), {20, -30, 2});
      SlamMap drawn = drawn_map(1, true, Timestamp::from_seconds(1'500'000'000));  // 2017-07-14 02:40:00 UTC
      for (Keyframe& keyframe : drawn.keyframes) {
        if (keyframe.session.value != 0) continue;
        keyframe.T_map_body = SE3d(keyframe.T_map_body.rotation(), 1.5 * keyframe.T_map_body.translation());
        keyframe.gnss = GnssFix{.time = keyframe.time,
                                .position_ecef = T_ecef_enu * (T_enu_map * keyframe.T_map_body.translation()),
                                .quality = GnssQuality::three_dimensional};
      }
      save_map(map, drawn, {.overwrite = true});
      const ProgramResult result = exported(root, map, "las", root / "a.las", "--voxel 0 --overwrite");
      CAPTURE(result.errors);
      REQUIRE(result.exit_code == 0);
      const int code = hemisphere > 0 ? 32632 : 32732;
      CHECK(contains(result.output, std::string("georeference UTM zone 32") + (hemisphere > 0 ? "N" : "S") + ", EPSG " +
                                        std::to_string(code)));
      CHECK(contains(result.output, "GPS time     adjusted standard"));
      CHECK(contains(result.output, "georeference none"));  // the other frame
      const LasFile las(root / "a_frame_0.las"), local(root / "a_frame_1.las");
      REQUIRE(las.points == 24 * 400);
      check_bounds(las);
      CHECK(las.has_bit(0));
      CHECK(las.has_bit(4));
      CHECK(local.wkt().empty());
      CHECK(las.wkt().starts_with(hemisphere > 0 ? "PROJCS[\"WGS 84 / UTM zone 32N\""
                                                 : "PROJCS[\"WGS 84 / UTM zone 32S\""));
      CHECK(las.wkt().ends_with("AUTHORITY[\"EPSG\",\"" + std::to_string(code) + "\"]]"));
      CHECK(contains(las.wkt(), "PARAMETER[\"central_meridian\",9]"));
      CHECK(std::ranges::count(las.wkt(), '[') == std::ranges::count(las.wkt(), ']'));
      // On the central meridian the projection is a scale of 0.9996 to a millimetre within some dozen metres.
      double most = 0;
      for (std::uint64_t i = 0; i < las.points; ++i) {
        const Keyframe& keyframe = drawn.keyframes[i / 400];
        const Eigen::Vector3d p = keyframe.cloud.load()->positions[i % 400].cast<double>();
        const Eigen::Vector3d enu = T_enu_map * (keyframe.T_map_body * p);
        const double along = enu.x() * enu.x() + enu.y() * enu.y();
        const Eigen::Vector3d expected(500000 + 0.9996 * enu.x(),
                                       (hemisphere > 0 ? 0 : 1e7) + 0.9996 * (meridian(latitude) + enu.y()),
                                       10 + enu.z() + along / (2 * equator));
        for (std::size_t axis = 0; axis < 3; ++axis)
          most = std::max(most, std::abs(las.coordinate(i, axis) - expected[static_cast<Eigen::Index>(axis)]));
      }
      CHECK(most < 0.002);
      CHECK(std::abs(las.gps_time(0) - (1'184'035'218.0 - 1e9 - 0.05)) < 1e-5);  // 18 leap seconds after 1980
    }
  }
}
