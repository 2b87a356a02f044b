#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "support/files.hpp"
#include "support/map_picture.hpp"
#include "support/plot.hpp"
#include "support/report.hpp"

namespace chainslam::support {
namespace {

/// A session of keyframes along a line, each with the same few points round it.
SlamMap corridor(double length, int keyframes, const Eigen::Vector3d& start = Eigen::Vector3d::Zero(),
                 const Eigen::Vector3d& direction = Eigen::Vector3d::UnitX()) {
  auto cloud = std::make_shared<PointCloud<float>>();
  for (int i = 0; i < 40; ++i)
    cloud->positions.emplace_back(0.3F * static_cast<float>(i), i % 2 == 0 ? 2.0F : -2.0F,
                                  0.1F * static_cast<float>(i));
  SlamMap map;
  Session session;
  session.name = "corridor";
  session.id = session.frame = SessionId{0};
  session.keyframes = keyframes;
  map.sessions = {session};
  for (Index i = 0; i < keyframes; ++i) {
    Keyframe keyframe;
    keyframe.id = KeyframeId{i};
    keyframe.session = SessionId{0};
    keyframe.time = Timestamp::from_seconds(i);
    keyframe.T_map_body = SE3d(SO3d(), start + (keyframes > 1 ? length * i / (keyframes - 1) : 0.0) * direction);
    keyframe.T_odom_body = keyframe.T_map_body;
    keyframe.cloud = cloud;
    map.keyframes.push_back(keyframe);
  }
  return map;
}

/// Draws all there is of a map; under ASan a pixel outside of the picture ends the test.
void check_drawings(ReportData data) {
  data.title = "extreme";
  data.plots.insert(data.plots.end(), {speed_plot(data.sessions)});
  const test::TemporaryFolder folder;
  std::ofstream(folder / "three.min.js") << "var THREE = {REVISION: '111'};";
  for (const Index side : {1600, 64, 1}) {
    CAPTURE(side);
    write_map_picture(folder / "map.png", data, {.largest_side = side});
    CHECK(test::read_bytes(folder / "map.png").substr(0, 4) == "\x89PNG");
  }
  const std::string html = report_html(data, {.three_js = folder / "three.min.js"});
  CHECK(test::says(html, "Map from above") == !data.sessions.empty());
  for (const char* wrong : {"=\"nan", ",nan", " nan", "=\"inf", ",inf", "–\" y", "null,null"})
    CHECK_MESSAGE(!test::says(html, wrong), wrong);
  const MapView view = view_of(data);
  CHECK(view.width() >= 0.124 * view.height());
  CHECK(view.height() >= 0.124 * view.width());
}

}  // namespace

TEST_SUITE("support/extreme_maps") {
  TEST_CASE("corridors of 1, 4, 15 and 100 km along any axis have a picture and a report") {
    for (const double km : {1.0, 4.0, 15.0, 100.0})
      for (const Eigen::Vector3d& direction : {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, -1, 0)}) {
        CAPTURE(km);
        const ReportData data = report_data(corridor(1000 * km, 400, Eigen::Vector3d::Zero(), direction), 0.2);
        CHECK(data.points.size() == 400 * 40);
        check_drawings(data);
      }
  }

  TEST_CASE("maps of one point, of one place, straight up and of nothing have a picture and a report") {
    SlamMap point = corridor(0, 1);
    point.keyframes[0].cloud = std::make_shared<PointCloud<float>>(PointCloud<float>{{Eigen::Vector3f(1, 2, 3)}});
    check_drawings(report_data(point, 0.2));
    check_drawings(report_data(corridor(0, 300), 0.2));
    check_drawings(report_data(corridor(500, 300, Eigen::Vector3d::Zero(), Eigen::Vector3d::UnitZ()), 0.2));
    check_drawings({});
  }

  TEST_CASE("of a map with millions of points a report keeps two million at most, all over it") {
    SlamMap map = corridor(3000, 3);
    for (Index i = 0; i < 3; ++i) {
      auto cloud = std::make_shared<PointCloud<float>>();
      for (int x = 0; x < 1000; ++x)
        for (int y = 0; y < 1000; ++y)
          cloud->positions.emplace_back(0.3F * static_cast<float>(x), 0.3F * static_cast<float>(y), 1.0F);
      map.keyframes[static_cast<std::size_t>(i)].cloud = cloud;
    }
    const ReportData data = report_data(map, 0.2);
    CHECK(data.points.size() <= 2'000'000);
    CHECK(data.points.size() > 500'000);
    CHECK(data.points.size() == data.point_sessions.size());
    for (Index i = 0; i < 3; ++i) {
      Index of_keyframe = 0;
      for (const Eigen::Vector3f& point : data.points)
        of_keyframe += std::abs(point.x() - 1500.0F * static_cast<float>(i) - 150.0F) < 151.0F ? 1 : 0;
      CHECK(of_keyframe > to_index(data.points.size()) / 4);
    }
    check_drawings(data);
  }

  TEST_CASE("a map 1e8 m from the origin is drawn as the same map at the origin") {
    const Eigen::Vector3d start(1e8, -1e8, 1e8);
    const ReportData near = report_data(corridor(1000, 200), 0.04), far = report_data(corridor(1000, 200, start), 0.04);
    CHECK(far.points.size() == near.points.size());
    check_drawings(far);
    const MapView view = view_of(near), moved = view_of(far);
    CHECK(moved.width() == doctest::Approx(view.width()).epsilon(1e-6));
    const MapRaster raster = rasterize(near, view, 400), moved_raster = rasterize(far, moved, 400);
    REQUIRE(raster.opacity.size() == moved_raster.opacity.size());
    std::size_t different = 0;
    for (std::size_t i = 0; i < raster.opacity.size(); ++i) different += raster.opacity[i] != moved_raster.opacity[i];
    CHECK(different <= raster.opacity.size() / 100);  // at the edges of cells, by rounding
  }

  TEST_CASE("positions that no picture can hold are left out of it, and the others drawn") {
    constexpr double infinity = std::numeric_limits<double>::infinity();
    for (const double far : {5e28, 1e300, -1e308, infinity, std::numeric_limits<double>::quiet_NaN()}) {
      CAPTURE(far);
      ReportData data = report_data(corridor(100, 50), 0.2);
      for (const std::size_t i : {0U, 20U, 49U}) data.sessions[0].optimized[i] = Eigen::Vector3d(far, -far, far);
      data.sessions[0].times[30] = far;
      data.points[7].x() = static_cast<float>(std::max(-1e38, std::min(far, 1e38)));
      data.closures = {{.from = 0, .to = 49, .kind = ClosureKind::direct}, {.from = 3, .to = 20}};
      check_drawings(data);
      CHECK(view_of(data).width() < 200);
    }
  }

  TEST_CASE("axes at numbers that adding one does not change have a bounded number of ticks") {
    for (const double low : {1e17, -1e17, 1e300}) CHECK(axis_ticks(low, std::nextafter(low, 1e308), 10).size() <= 11);
    const std::vector<double> x{9e14, 9e14 + 0.25, 9e14 + 0.5};
    const PlotDrawing drawing = draw_plot({.title = "t", .series = {{.name = "s", .x = x, .y = x}}}, 0);
    CHECK(drawing.html.size() < 20'000);
  }
}

}  // namespace chainslam::support
