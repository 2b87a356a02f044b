#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include "chainslam/features/fpfh.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/kd_tree.hpp"

namespace chainslam {
namespace {

/// What PCL makes of a made corner (bench/registration/golden_values.cpp writes it).
struct GoldenFeatures {
  PointCloud<float> cloud;  ///< with normals
  std::vector<float> curvatures;
  FpfhFeatures fpfh;
};

GoldenFeatures read_golden_features() {
  std::ifstream file(std::string(CHAINSLAM_SOURCE_DIR) + "/test/features/golden/corner_features.txt");
  std::string line;
  while (file.peek() == '#') std::getline(file, line);
  std::size_t count = 0;
  file >> count;
  GoldenFeatures golden;
  golden.cloud.positions.resize(count);
  golden.cloud.normals.resize(count);
  golden.curvatures.resize(count);
  golden.fpfh.resize(33, static_cast<Eigen::Index>(count));
  for (std::size_t i = 0; i < count; ++i) {
    for (float& coordinate : golden.cloud.positions[i]) file >> coordinate;
    for (float& coordinate : golden.cloud.normals[i]) file >> coordinate;
    file >> golden.curvatures[i];
    for (Eigen::Index bin = 0; bin < 33; ++bin) file >> golden.fpfh(bin, static_cast<Eigen::Index>(i));
  }
  REQUIRE(file.good());
  REQUIRE(count > 0);
  return golden;
}

TEST_SUITE("features/golden_features") {
  TEST_CASE("normals and curvatures are those of PCL") {
    const GoldenFeatures golden = read_golden_features();
    PointCloud<float> cloud;
    cloud.positions = golden.cloud.positions;
    const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 10}, {2, 2, 3});
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      CAPTURE(i);
      // PCL sums in float, from the origin: squares of 4 m, rounded, beside variances of a square decimetre.
      CHECK(cloud.normals[i].dot(golden.cloud.normals[i]) > 0.9999f);
      CHECK(std::abs(estimates.curvature[i] - golden.curvatures[i]) < 1e-4f);
    }
  }

  TEST_CASE("FPFH is that of PCL, to rounding, but for the sign of phi where both normals lean alike") {
    const GoldenFeatures golden = read_golden_features();
    const PointCloud<float>& cloud = golden.cloud;
    const KdTree<float> search(cloud);
    const FpfhFeatures ours =
        estimate_fpfh(cloud, search, {.radius = 1.2, .max_neighbors = 0, .blend = FpfhBlend::neighbors_only});
    REQUIRE(ours.cols() == golden.fpfh.cols());

    // The point whose normal is the nearer to the line between two gives their frame. Where both lean alike, as normals
    // of points with the same ten neighbours do, rounding chooses (PCL compares arc cosines in float), and phi is in
    // bin b or 10 - b. A feature depends on the pairs of its neighbours.
    constexpr float alike = 1e-6f, tolerance = 1e-3f;
    std::vector<std::vector<Neighbor<float>>> near(cloud.size());
    std::vector<bool> leans_alike(cloud.size());
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      search.within(cloud.positions[i], 1.2f, near[i]);
      for (const Neighbor<float>& neighbor : near[i]) {
        const auto j = static_cast<std::size_t>(neighbor.index);
        if (j == i) continue;
        const Eigen::Vector3f line = (cloud.positions[j] - cloud.positions[i]).normalized();
        const float difference = std::abs(line.dot(cloud.normals[i])) - std::abs(line.dot(cloud.normals[j]));
        if (std::abs(difference) < alike) leans_alike[i] = true;
      }
    }
    int clear = 0;
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      CAPTURE(i);
      const auto column = static_cast<Eigen::Index>(i);
      const auto difference = (ours.col(column) - golden.fpfh.col(column)).eval();
      const Eigen::Matrix<float, 11, 1> phi = difference.tail<11>();
      CHECK(difference.head<22>().cwiseAbs().maxCoeff() < tolerance);
      CHECK((phi + phi.reverse()).cwiseAbs().maxCoeff() < tolerance);
      if (std::any_of(near[i].begin(), near[i].end(),
                      [&](const auto& neighbor) { return leans_alike[static_cast<std::size_t>(neighbor.index)]; }))
        continue;
      ++clear;
      CHECK(phi.cwiseAbs().maxCoeff() < tolerance);
    }
    CHECK(clear > 5);
  }
}

}  // namespace
}  // namespace chainslam
