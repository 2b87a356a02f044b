#include "chainslam/cloud/voxel_grid.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>
#include <utility>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;
using CellKey = std::tuple<long long, long long, long long>;

CellKey key_of(const Eigen::Vector3d& p, double size) {
  return {std::llround(std::floor(p[0] / size)), std::llround(std::floor(p[1] / size)),
          std::llround(std::floor(p[2] / size))};
}

std::vector<Eigen::Vector3d> random_points(Rng& rng, int count, const Eigen::Vector3d& origin) {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < count; ++i)
    points.emplace_back(origin + Eigen::Vector3d(rng.uniform(-3, 3), rng.uniform(-3, 3), rng.uniform(-1, 1)));
  return points;
}

/// The plain way: an ordered map from cells to the indices of their points.
std::map<CellKey, std::vector<std::size_t>> group(const std::vector<Eigen::Vector3d>& points, double size) {
  std::map<CellKey, std::vector<std::size_t>> cells;
  for (std::size_t i = 0; i < points.size(); ++i) cells[key_of(points[i], size)].push_back(i);
  return cells;
}

TEST_SUITE("cloud/voxel_grid") {
  TEST_CASE("means agree with an ordered map of cells, near the origin and 500 km from it") {
    for (const double away : {0.0, 500'000.0, -500'000.0}) {
      for_all(30, [&](Rng& rng, int size) {
        // A power of two, so that the reference's division and our product round alike.
        const double edge = 0.25;
        const auto points = random_points(rng, 20 * size, Eigen::Vector3d(away, -away, away / 100));
        const auto cells = group(points, edge);
        const auto result = VoxelGrid{.size = edge}.downsample<double>(points);
        CHECK(result.rejected == 0);
        REQUIRE(result.cloud.size() == cells.size());
        for (const Eigen::Vector3d& mean : result.cloud.positions) {
          const auto found = cells.find(key_of(mean, edge));
          REQUIRE(found != cells.end());
          Eigen::Vector3d expected = Eigen::Vector3d::Zero();
          for (const std::size_t i : found->second) expected += points[i] - points[found->second[0]];
          expected = points[found->second[0]] + expected / static_cast<double>(found->second.size());
          CHECK((mean - expected).norm() < 1e-8);  // sums of tens of values of 5e5: 1e-16 * 5e5 * 50
        }
      });
    }
  }

  TEST_CASE("first and nearest to centre choose given points, voxels in order of first appearance") {
    for_all(30, [](Rng& rng, int size) {
      const double edge = 0.5;
      const auto points = random_points(rng, 10 * size, Eigen::Vector3d(10, -7, 0.3));
      const auto cells = group(points, edge);
      const auto first = VoxelGrid{.size = edge, .mode = VoxelMode::first}.downsample<double>(points).cloud;
      const auto nearest =
          VoxelGrid{.size = edge, .mode = VoxelMode::nearest_to_center}.downsample<double>(points).cloud;
      REQUIRE(first.size() == cells.size());
      REQUIRE(nearest.size() == cells.size());
      std::size_t last = 0;
      for (std::size_t v = 0; v < first.size(); ++v) {
        const auto& members = cells.at(key_of(first.positions[v], edge));
        CHECK(first.positions[v] == points[members[0]]);
        CHECK((v == 0 || members[0] > last));
        last = members[0];
        const Eigen::Vector3d center = ((first.positions[v] / edge).array().floor() + 0.5) * edge;
        double best = 1e9;
        for (const std::size_t i : members) best = std::min(best, (points[i] - center).norm());
        CHECK((nearest.positions[v] - center).norm() == doctest::Approx(best));
      }
    });
  }

  TEST_CASE("the order of a voxel's points does not change its mean by a bit; the mean of one point is that point") {
    for_all(30, [](Rng& rng, int size) {
      const Eigen::Vector3d origin(rng.uniform(-1000, 1000), rng.uniform(-1000, 1000), 0);
      const auto points = random_points(rng, 30 * size, origin);
      auto shuffled = points;
      for (std::size_t i = shuffled.size(); i > 1; --i)
        std::swap(shuffled[i - 1], shuffled[static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(i)))]);
      const double edge = rng.uniform(0.1, 2.0);
      std::map<CellKey, Eigen::Vector3d> means;
      for (const Eigen::Vector3d& mean : VoxelGrid{.size = edge}.downsample<double>(points).cloud.positions)
        means[key_of(mean, edge)] = mean;
      for (const Eigen::Vector3d& mean : VoxelGrid{.size = edge}.downsample<double>(shuffled).cloud.positions)
        CHECK(means.at(key_of(mean, edge)) == mean);
      for (const auto& [key, members] : group(points, edge))
        if (members.size() == 1) CHECK(means.at(key) == points[members[0]]);
    });
  }

  TEST_CASE("a mean does not depend, by a bit, on whether points far from it came before") {
    for_all(30, [](Rng& rng, int size) {
      const double origin = rng.uniform(0, 1) < 0.5 ? 0 : rng.uniform(-3e6, 3e6);
      auto points = random_points(rng, 4 * size, Eigen::Vector3d(origin, 0, -origin / 2));
      for (const double tiny : {-1e-20, -1e-10, -0x1p-32, -0x1p-31, 0x1p-32, 0.0}) points.emplace_back(tiny, tiny, 1);
      points.emplace_back(std::nextafter(0x1p20, 0), -0x1p20, std::nextafter(-0x1p20, -0x1p21));
      const double edge = rng.uniform(0, 1) < 0.5 ? 1 : rng.uniform(0.1, 2);
      auto later = points;
      later.insert(later.begin(), Eigen::Vector3d(1e8, -1e8, 5e7));
      const auto means = VoxelGrid{.size = edge}.downsample<double>(points).cloud.positions;
      auto again = VoxelGrid{.size = edge}.downsample<double>(later).cloud.positions;
      again.erase(again.begin());
      CHECK(means == again);
      CHECK(means.size() == group(points, edge).size());
    });
  }

  TEST_CASE("tens of thousands of voxels, most of one point") {
    Rng rng(5);
    std::vector<Eigen::Vector3f> points;
    for (int i = 0; i < 50'000; ++i)
      points.emplace_back(
          Eigen::Vector3d(rng.uniform(-20, 20), rng.uniform(-20, 20), rng.uniform(-20, 20)).cast<float>());
    std::vector<Eigen::Vector3d> in_double;
    for (const Eigen::Vector3f& p : points) in_double.emplace_back(p.cast<double>());
    const auto cells = group(in_double, 0.5);
    const auto first = VoxelGrid{.size = 0.5, .mode = VoxelMode::first}.downsample(points).cloud;
    REQUIRE(first.size() == cells.size());
    REQUIRE(voxel_downsample(points, 0.5).size() == cells.size());
    for (const Eigen::Vector3f& p : first.positions) CHECK(p == points[cells.at(key_of(p.cast<double>(), 0.5))[0]]);
  }

  TEST_CASE("all columns come along: averaged by mean, chosen by first") {
    PointCloud<float> cloud;
    cloud.positions = {{0.1f, 0, 0}, {0.3f, 0, 0}, {5, 5, 5}};
    cloud.normals = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    cloud.time_offsets = {0.0f, 0.5f, 1.0f};
    cloud.intensities = {10, 20, 30};
    const PointCloud<float> mean = voxel_downsample(cloud, 1.0);
    REQUIRE(mean.size() == 2);
    CHECK(mean.positions[0].isApprox(Eigen::Vector3f(0.2f, 0, 0)));
    CHECK(mean.normals[0].isApprox(Eigen::Vector3f(std::sqrt(0.5f), std::sqrt(0.5f), 0)));
    CHECK(mean.time_offsets[0] == doctest::Approx(0.25));
    CHECK(mean.intensities[0] == doctest::Approx(15));
    CHECK(mean.normals[1] == cloud.normals[2]);
    const PointCloud<float> first = voxel_downsample(cloud, 1.0, VoxelMode::first);
    CHECK(first.normals[0] == cloud.normals[0]);
    CHECK(first.time_offsets[0] == 0.0f);
    CHECK(first.intensities[1] == 30);
  }

  TEST_CASE("opposite normals leave a unit normal behind") {
    PointCloud<float> cloud;
    cloud.positions = {{0.1f, 0, 0}, {0.3f, 0, 0}};
    cloud.normals = {{0, 0, 1}, {0, 0, -1}};
    CHECK(voxel_downsample(cloud, 1.0).normals[0] == Eigen::Vector3f(0, 0, 1));
  }

  TEST_CASE("points on a voxel's lower faces belong to it, on both sides of the origin") {
    const std::vector<Eigen::Vector3d> points{{0, 0, 0}, {-0.25, 0, 0}, {-0.5, 0, 0}, {0.5, 0, 0}, {-1e-12, 0, 0}};
    CHECK(VoxelGrid{.size = 0.5}.downsample(points).cloud.size() == 3);  // [-0.5, 0), [0, 0.5), [0.5, 1)
  }

  TEST_CASE("a point a rounding below its voxel's upper face stays within it") {
    const std::vector<Eigen::Vector3d> points{{-1e-20, 0.1, 0.1}, {-0.25, 0.1, 0.1}};
    const auto thinned = VoxelGrid{.size = 0.5}.downsample<double>(points);
    REQUIRE(thinned.cloud.size() == 1);
    CHECK(thinned.cloud.positions[0].x() == doctest::Approx(-0.125).epsilon(1e-6));
  }

  TEST_CASE("NaN, infinite and absurd points are dropped and counted") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const float inf = std::numeric_limits<float>::infinity();
    const std::vector<Eigen::Vector3f> points{{nan, 0, 0}, {0, inf, 0}, {0, 0, -inf}, {1e30f, 0, 0}, {1, 2, 3}};
    for (const VoxelMode mode : {VoxelMode::mean, VoxelMode::first, VoxelMode::nearest_to_center}) {
      const auto result = VoxelGrid{.size = 0.1, .mode = mode}.downsample(points);
      CHECK(result.rejected == 4);
      REQUIRE(result.cloud.size() == 1);
      CHECK(result.cloud.positions[0] == Eigen::Vector3f(1, 2, 3));
    }
  }

  TEST_CASE("cells millions apart, by whole turns of their keys, too, and at the rim of what there is, stay apart") {
    std::vector<Eigen::Vector3d> points;
    const double turn = std::ldexp(1, 21), rim = std::ldexp(1, 31);  // cells, of edge 1
    for (const double x : {0.5, turn, -turn, turn / 2, -turn / 2 - 0.5, 3 * turn, 1e9, rim - 2, 1.5 - rim})
      for (const double y : {0.25, 2 * turn, -rim + 1.75})
        for (const double z : {0.75, turn + 1, 1 - turn}) points.emplace_back(x, y, z);
    for (std::size_t i = 0; i < 27 * 3; ++i) points.push_back(points[i] + Eigen::Vector3d(0.1, 0.1, 0.1));
    points.insert(points.begin() + 5, Eigen::Vector3d(rim, 0, 0));  // none any more
    const auto cells = group(points, 1.0);
    for (const bool reversed : {false, true}) {
      if (reversed) std::reverse(points.begin(), points.end());
      const auto thinned = VoxelGrid{.size = 1.0}.downsample<double>(points);
      CHECK(thinned.rejected == 1);
      REQUIRE(thinned.cloud.size() == cells.size() - 1);
      for (const Eigen::Vector3d& mean : thinned.cloud.positions) {
        const auto found = cells.find(key_of(mean, 1.0));
        REQUIRE(found != cells.end());
        CHECK(found->second.size() == 2);
        CHECK((mean - points[reversed ? points.size() - 1 - found->second[0] : found->second[0]] -
               Eigen::Vector3d(0.05, 0.05, 0.05))
                  .norm() < 1e-6);
      }
    }
  }

  TEST_CASE("an empty cloud stays empty; a size that is no length is refused") {
    const std::vector<Eigen::Vector3f> none;
    CHECK(voxel_downsample(none, 1.0).empty());
    for (const double size :
         {0.0, -1.0, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()})
      CHECK_THROWS_AS((void)voxel_downsample(none, size), std::invalid_argument);
  }
}

TEST_SUITE("cloud/cell_set") {
  TEST_CASE("a cell is new once, wherever it is; sets of neighbours are small") {
    for_all(50, [](Rng& rng, int size) {
      CellSet set;
      CellTable table;
      const auto coordinate = [&](Index middle) { return middle + rng.uniform_index(2 * size + 1) - size; };
      for (int i = 0; i < 20 * size; ++i) {
        const Index far = rng.uniform_index(3) - 1;  // about the origin, and at both ends of the numbers
        const Cell cell{coordinate(far * 2'000'000'000), coordinate(0), coordinate(-far * 2'000'000'000)};
        CHECK(set.insert(cell) == table.insert(cell, i).second);
      }
      CHECK(set.size() == table.size());
    });
    CellSet plane;
    for (Index x = 0; x < 1000; ++x)
      for (Index y = -500; y < 500; ++y) CHECK(plane.insert({x, y, 7}));
    CHECK(plane.size() == 1'000'000);
    CHECK(plane.memory() < 4'000'000);
  }
}

TEST_SUITE("cloud/cell_table") {
  TEST_CASE("inserts, finds and erases like an ordered map") {
    for_all(50, [](Rng& rng, int size) {
      CellTable table;
      std::map<std::tuple<int, int, int>, Index> reference;
      const auto coordinate = [&] { return static_cast<std::int32_t>(rng.uniform_index(7)) - 3; };
      for (int step = 0; step < 40 * size; ++step) {
        const Cell cell{coordinate(), coordinate(), coordinate()};
        const auto key = std::tuple(cell.x, cell.y, cell.z);
        if (rng.uniform() < 0.6) {
          const auto ours = table.insert(cell, step);
          const auto theirs = reference.emplace(key, step);
          CHECK(ours.second == theirs.second);
          CHECK(ours.first == theirs.first->second);
        } else {
          table.erase(cell);
          reference.erase(key);
        }
        CHECK(table.size() == static_cast<Index>(reference.size()));
      }
      for (std::int32_t x = -3; x <= 3; ++x)
        for (std::int32_t y = -3; y <= 3; ++y)
          for (std::int32_t z = -3; z <= 3; ++z) {
            const auto found = reference.find(std::tuple(x, y, z));
            CHECK(table.find({x, y, z}) == (found == reference.end() ? -1 : found->second));
          }
    });
  }
}

}  // namespace
}  // namespace chainslam
