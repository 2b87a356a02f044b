#include <doctest/doctest.h>

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

  TEST_CASE("FPFH is that of PCL, to rounding") {
    const GoldenFeatures golden = read_golden_features();
    const FpfhFeatures ours = estimate_fpfh(golden.cloud, KdTree<float>(golden.cloud),
                                            {.radius = 1.2, .max_neighbors = 0, .blend = FpfhBlend::neighbors_only});
    REQUIRE(ours.cols() == golden.fpfh.cols());
    // A pair whose angle lies on the border of two bins is counted in either by rounding. One in a thousand does so,
    // and shows, with a small weight, in the features of all its neighbours.
    const Eigen::ArrayXXf differences = (ours - golden.fpfh).array().abs();
    CHECK((differences > 1e-3f).count() < differences.size() / 20);
    CHECK(differences.mean() < 0.05f);
  }
}

}  // namespace
}  // namespace chainslam
