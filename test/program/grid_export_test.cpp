#include <doctest/doctest.h>

#include <cstdio>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "chainslam/slam/occupancy_grid.hpp"
#include "program/drawn_map.hpp"
#include "program/run_program.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// A picture as Netpbm's P5 has it.
struct Picture {
  int width = 0, height = 0, most = 0;
  std::string pixels;

  explicit Picture(const fs::path& path) {
    std::ifstream file(path, std::ios::binary);
    std::string mark;
    REQUIRE((file >> mark >> width >> height >> most));
    CHECK(mark == "P5");
    file.get();
    pixels = {std::istreambuf_iterator<char>(file), {}};
    REQUIRE(pixels.size() == static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  }
  [[nodiscard]] int at(int column, int row) const {
    return static_cast<unsigned char>(pixels[static_cast<std::size_t>(row * width + column)]);
  }
};

std::map<std::string, std::string> yaml_of(const fs::path& path) {
  std::map<std::string, std::string> values;
  std::istringstream text(read_text(path));
  for (std::string line; std::getline(text, line);) {
    const std::size_t colon = line.find(": ");
    REQUIRE(colon != line.npos);
    CHECK(values.emplace(line.substr(0, colon), line.substr(colon + 2)).second);
  }
  return values;
}

/// What the map server makes of a pixel in the mode trinary (map_server, image_loader.cpp).
char occupancy(int pixel, const std::map<std::string, std::string>& yaml) {
  const double occupied = (255 - pixel) / 255.0;
  if (occupied > std::stod(yaml.at("occupied_thresh"))) return 'o';
  return occupied < std::stod(yaml.at("free_thresh")) ? 'f' : 'u';
}

char occupancy(const OccupancyGrid<>& grid, Index x, Index y) {
  const double probability = grid.model.probability(grid.at(x, y));
  return probability > 0.65 ? 'o' : probability < 0.35 ? 'f' : 'u';
}

}  // namespace

TEST_SUITE("program/grid_export") {
  TEST_CASE("the picture and its YAML are the grid of the map, read as the map server reads them") {
    const ScratchFolder scratch("grid_export");
    const fs::path root = scratch.path(), map = root / "a.cslam", out = root / "room.yaml";
    const SlamMap drawn = drawn_map(2, false, Timestamp::from_seconds(10));
    save_map(map, drawn);
    const std::string command = "export " + quoted(map) + " --format grid --resolution 0.2 --height 0.3 1.8 --out ";
    const ProgramResult result = run_program(root, command + quoted(out));
    CAPTURE(result.errors);
    REQUIRE(result.exit_code == 0);
    CHECK(contains(result.output, "room.yaml\n"));
    const OccupancyGrid<> grid = occupancy_grid(drawn, std::vector{SessionId{0}, SessionId{1}},
                                                {.resolution = 0.2, .min_height = 0.3, .max_height = 1.8});
    const auto yaml = yaml_of(out);
    CHECK(yaml.size() == 7);
    CHECK(yaml.at("image") == "\"room.pgm\"");
    CHECK(yaml.at("mode") == "trinary");
    CHECK(yaml.at("negate") == "0");
    CHECK(std::stod(yaml.at("resolution")) == 0.2);
    double x = 0, y = 0, yaw = 1;
    REQUIRE(std::sscanf(yaml.at("origin").c_str(), "[%lf, %lf, %lf]", &x, &y, &yaw) == 3);
    CHECK(x == grid.origin.x());
    CHECK(y == grid.origin.y());
    CHECK(yaw == 0);
    const Picture picture(root / "room.pgm");
    REQUIRE(picture.width == grid.width);
    REQUIRE(picture.height == grid.height);
    CHECK(picture.most == 255);
    int different = 0;
    std::map<char, int> counts;
    for (Index row = 0; row < grid.height; ++row)
      for (Index column = 0; column < grid.width; ++column) {
        const char expected = occupancy(grid, column, grid.height - 1 - row);
        different += occupancy(picture.at(column, row), yaml) != expected;
        ++counts[expected];
      }
    CHECK(different == 0);
    CHECK(counts['o'] > 100);   // the walls,
    CHECK(counts['f'] > 5000);  // what is between them,
    CHECK(counts['u'] > 100);   // and around

    CHECK(run_program(root, command + quoted(out)).exit_code == 4);  // which is there
    CHECK(run_program(root, command + quoted(out) + " --overwrite").exit_code == 0);
    CHECK(fs::exists(root / "room.pgm~1"));
    CHECK(fs::exists(root / "room.yaml~1"));
    CHECK(read_text(root / "room.pgm~1") == read_text(root / "room.pgm"));
  }

  TEST_CASE("each frame has a grid of its own; names go by their endings") {
    const ScratchFolder scratch("grid_frames");
    const fs::path root = scratch.path(), map = root / "a.cslam";
    SlamMap drawn = drawn_map(1, true, Timestamp::from_seconds(10), 4);
    save_map(map, drawn);
    REQUIRE(run_program(root, "export " + quoted(map) + " --format grid --out " + quoted(root / "v1.2")).exit_code ==
            0);
    for (const char* name : {"v1_frame_0.2", "v1_frame_1.2"}) {
      CHECK(fs::exists(root / (std::string(name) + ".pgm")));
      CHECK(yaml_of(root / (std::string(name) + ".yaml")).at("image") == "\"" + std::string(name) + ".pgm\"");
    }
    for (Keyframe& keyframe : drawn.keyframes)
      if (keyframe.session.value == 1) keyframe.cloud = std::make_shared<const PointCloud<float>>();
    save_map(root / "b.cslam", drawn);
    const ProgramResult one =
        run_program(root, "export " + quoted(root / "b.cslam") + " --format grid --out " + quoted(root / "b.yml"));
    CHECK(one.exit_code == 0);
    CHECK(contains(one.errors, "no grid for frame 1"));
    CHECK(fs::exists(root / "b_frame_0.yml"));
    CHECK(fs::exists(root / "b_frame_0.pgm"));
    CHECK(!fs::exists(root / "b_frame_1.pgm"));
  }
}
