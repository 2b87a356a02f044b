#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <cerrno>
#include <filesystem>
#include <numbers>
#include <sstream>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "program/faults.hpp"
#include "program/run_program.hpp"

// What `chainslam export --format colmap` writes is read by COLMAP's rules (https://colmap.github.io/format.html):
// lines that begin with # are comments, an image has two lines, and points end with their track.

namespace {

using namespace chainslam;
using namespace chainslam::test;

struct ColmapView {
  int id = 0, camera = 0;
  Eigen::Quaterniond q;  ///< of the world in the camera
  Eigen::Vector3d t;
  std::string name;
};

std::vector<std::string> data_lines(const fs::path& path) {
  std::istringstream text(read_text(path));
  std::vector<std::string> lines;
  for (std::string line; std::getline(text, line);)
    if (!line.starts_with('#')) lines.push_back(line);
  return lines;
}

std::vector<ColmapView> read_views(const fs::path& path) {
  const std::vector<std::string> lines = data_lines(path);
  REQUIRE(lines.size() % 2 == 0);
  std::vector<ColmapView> views;
  for (std::size_t i = 0; i < lines.size(); i += 2) {
    ColmapView view;
    std::istringstream fields(lines[i]);
    fields >> view.id >> view.q.w() >> view.q.x() >> view.q.y() >> view.q.z() >> view.t.x() >> view.t.y() >>
        view.t.z() >> view.camera >> view.name;
    CHECK(fields);
    CHECK((fields >> std::ws).eof());
    CHECK(lines[i + 1].empty());  // no features
    views.push_back(view);
  }
  return views;
}

/// A point as COLMAP's PINHOLE camera sees it, pixels.
Eigen::Vector2d seen(const ColmapView& view, const std::vector<double>& camera, const Eigen::Vector3d& p_world) {
  const Eigen::Vector3d p = view.q * p_world + view.t;
  return {camera[0] * p.x() / p.z() + camera[2], camera[1] * p.y() / p.z() + camera[3]};
}

ProgramResult to_colmap(const ScratchFolder& scratch, const SlamMap& map, const std::string& options = "",
                        const std::string& prefix = "") {
  const fs::path file = scratch.path() / "a.cslam";
  fs::remove(file);
  save_map(file, map);
  return run_program(
      scratch.path(),
      "export " + quoted(file) + " --format colmap --out " + quoted(scratch.path() / "model") + " " + options, prefix);
}

TEST_SUITE("program/colmap export") {
  TEST_CASE("views are where COLMAP's convention says, for the camera that looks ahead and for one that is given") {
    const SlamMap map = random_map(1, 20);
    // Ahead: right of the body's x axis is right of the middle, its z axis is up. Given: a camera that looks to the
    // left, 0.5 m up: the body turned by 90 degrees about z.
    const SE3d to_the_left(SO3d::exp({0, 0, std::numbers::pi / 2}), {0.1, 0.2, 0.5});
    const SE3d ahead(SO3d::exp({0, 0, 0}), {0, 0, 0});
    // The camera's axes in a frame whose x axis it looks along: (0.5, -0.5, 0.5, -0.5) as w x y z.
    const SE3d axes(SO3d::from_quaternion(Eigen::Quaterniond(0.5, -0.5, 0.5, -0.5)), {0, 0, 0});
    const auto numbers = [](const SE3d& T) {
      std::ostringstream text;
      text.precision(17);
      for (const double value : {T.translation().x(), T.translation().y(), T.translation().z()}) text << value << ' ';
      const auto q = T.rotation().quaternion();
      text << q.x() << ' ' << q.y() << ' ' << q.z() << ' ' << q.w();
      return text.str();
    };
    struct Case {
      std::string options;
      SE3d T_body_ahead;           ///< of a frame that looks along its x axis
      std::vector<double> camera;  ///< fx fy cx cy
      std::string line;
    };
    for (const Case& one : {Case{"", ahead, {640, 640, 640, 360}, "1 PINHOLE 1280 720 640 640 640 360"},
                            Case{"--camera 800 600 400 410 399.5 300.25 --body-camera " + numbers(to_the_left * axes),
                                 to_the_left,
                                 {400, 410, 399.5, 300.25},
                                 "1 PINHOLE 800 600 400 410 399.5 300.25"}}) {
      const ScratchFolder scratch("colmap_views");
      const ProgramResult result = to_colmap(scratch, map, one.options);
      CAPTURE(result.errors);
      REQUIRE(result.exit_code == 0);
      const std::vector<std::string> cameras = data_lines(scratch.path() / "model/cameras.txt");
      REQUIRE(cameras.size() == 1);
      CHECK(cameras[0] == one.line);
      const std::vector<ColmapView> views = read_views(scratch.path() / "model/images.txt");
      REQUIRE(views.size() == map.keyframes.size());
      for (std::size_t i = 0; i < views.size(); ++i) {
        const Keyframe& keyframe = map.keyframes[i];
        CHECK(views[i].id == static_cast<int>(i) + 1);
        CHECK(views[i].camera == 1);
        CHECK(views[i].name ==
              std::to_string(keyframe.session.value) + "/" + std::to_string(keyframe.time.nanoseconds()) + ".png");
        // 10 m ahead, 2 m to the left and 3 m up is left of the image's middle and above it.
        const Eigen::Vector3d p(10, 2, 3);
        const Eigen::Vector2d pixel = seen(views[i], one.camera, keyframe.T_map_body * (one.T_body_ahead * p));
        CHECK(pixel.x() == doctest::Approx(one.camera[2] - one.camera[0] * 0.2).epsilon(1e-6));
        CHECK(pixel.y() == doctest::Approx(one.camera[3] - one.camera[1] * 0.3).epsilon(1e-6));
        CHECK((views[i].q * (keyframe.T_map_body * (one.T_body_ahead * p)) + views[i].t).z() > 0);
      }
    }
  }

  TEST_CASE("points are those of the map, and views and points of sessions that were not merged are apart") {
    const ScratchFolder scratch("colmap_points");
    SlamMap map = random_map(2, 20, 50);
    REQUIRE(to_colmap(scratch, map, "--voxel 0").exit_code == 0);
    const std::vector<std::string> lines = data_lines(scratch.path() / "model/points3D.txt");
    std::size_t i = 0;
    for (const Keyframe& keyframe : map.keyframes) {
      const auto cloud = keyframe.cloud.load();
      if (!cloud) continue;
      for (const Eigen::Vector3f& p_body : cloud->positions) {
        const Eigen::Vector3d p = keyframe.T_map_body * p_body.cast<double>();
        REQUIRE(i < lines.size());
        std::istringstream fields(lines[i]);
        Eigen::Vector3d found;
        std::size_t id = 0;
        int r = -1, g = -1, b = -1;
        double error = 0;
        fields >> id >> found.x() >> found.y() >> found.z() >> r >> g >> b >> error;
        CHECK(fields);
        CHECK((fields >> std::ws).eof());  // no track
        CHECK(id == ++i);
        CHECK((found - p).norm() < 1e-4 * (1 + p.norm()));
        CHECK((r == 128 && g == 128 && b == 128));
        CHECK(error == -1);
      }
    }
    CHECK(i == lines.size());

    map.sessions[1].frame = SessionId{1};
    REQUIRE(to_colmap(scratch, map).exit_code == 0);
    const auto views_of = [&](const char* name) { return read_views(scratch.path() / name / "images.txt"); };
    CHECK(views_of("model_frame_0").size() == 10);
    REQUIRE(views_of("model_frame_1").size() == 10);
    CHECK(views_of("model_frame_1").front().id == 11);
    CHECK(to_colmap(scratch, map).exit_code == 4);
    CHECK(to_colmap(scratch, map, "--overwrite").exit_code == 0);
    CHECK(fs::exists(scratch.path() / "model_frame_1~1/images.txt"));
  }

  TEST_CASE("a full disk leaves no part of a model") {
    for (const char* name : {"cameras", "images", "points3D"}) {
      CAPTURE(name);
      const ScratchFolder scratch("colmap_full");
      const ProgramResult result =
          to_colmap(scratch, random_map(1, 20), "",
                    with_fault("write:" + std::string(name) + ":" + std::to_string(ENOSPC) + ":0"));
      CHECK(result.exit_code == 4);
      CHECK(three_lines(result.errors));
      for (const std::string& left : names_in(scratch.path())) CHECK(!left.starts_with("model"));
    }
  }

  TEST_CASE("cameras that cannot be are refused") {
    const ScratchFolder scratch("colmap_refused");
    for (const char* options :
         {"--camera 0 600 400 400 400 300", "--camera 800.5 600 400 400 400 300", "--camera 800 600 -1 400 400 300",
          "--camera 800 600 400 400 400", "--camera 800 600 400 400 nan 300", "--body-camera 0 0 0 0 0 0 2",
          "--body-camera 0 0 inf 0 0 0 1", "--body-camera 0 0 0"}) {
      CAPTURE(options);
      CHECK(to_colmap(scratch, random_map(1, 4), options).exit_code == 2);
      CHECK(!fs::exists(scratch.path() / "model"));
    }
  }
}

}  // namespace
