#include "chainslam/registration/gaussian_voxel_map.hpp"

#include <doctest/doctest.h>

#include <limits>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/registration/icp.hpp"
#include "registration/scenes.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

/// A user's cloud whose traits know covariances.
struct Blobs {
  std::vector<Eigen::Vector3d> positions;
  std::vector<Eigen::Matrix3d> covariances;
};

}  // namespace
}  // namespace chainslam::test

template <>
struct chainslam::CloudTraits<chainslam::test::Blobs> {
  using Blobs = chainslam::test::Blobs;
  static std::size_t size(const Blobs& cloud) { return cloud.positions.size(); }
  static const Eigen::Vector3d& position(const Blobs& cloud, std::size_t i) { return cloud.positions[i]; }
  static const Eigen::Matrix3d& covariance(const Blobs& cloud, std::size_t i) { return cloud.covariances[i]; }
};

namespace chainslam::test {
namespace {

static_assert(DistributedCloud<Blobs> && !DistributedCloud<PointCloud<float>>);
static_assert(Registration<Vgicp, PointCloud<float>, GaussianVoxelMap> && Registration<Vgicp, Blobs, GaussianVoxelMap>);

PointCloud<float> with_normals_from(const PointCloud<float>& cloud, const SE3d& T_target_source) {
  PointCloud<float> result = seen_from(cloud, T_target_source);
  for (const Eigen::Vector3f& n : cloud.normals)
    result.normals.push_back((T_target_source.rotation().inverse() * n.cast<double>().eval()).cast<float>());
  return result;
}

}  // namespace

TEST_SUITE("registration/gaussian_voxel_map") {
  TEST_CASE("voxels hold the means of their points and covariances, however they came") {
    Rng rng(1);
    Blobs blobs;
    for (int i = 0; i < 300; ++i) {
      blobs.positions.emplace_back(rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(-1, 1));
      const Eigen::Vector3d a(rng.normal(), rng.normal(), rng.normal());
      blobs.covariances.push_back(a * a.transpose() + Eigen::Matrix3d::Identity());
    }
    const SE3d T = asymmetric_pose();
    GaussianVoxelMap map({.voxel_size = 0.7, .neighborhood = 1});
    map.insert(blobs, T);
    std::vector<Eigen::Vector3d> sums(map.size(), Eigen::Vector3d::Zero());
    std::vector<Eigen::Matrix3d> covariances(map.size(), Eigen::Matrix3d::Zero());
    std::vector<Index> counts(map.size(), 0);
    const Eigen::Matrix3d R = T.rotation().matrix();
    for (std::size_t i = 0; i < blobs.positions.size(); ++i) {
      const Eigen::Vector3d p = T * blobs.positions[i];
      const auto voxel = static_cast<std::size_t>(map.match(p, 10.0));
      REQUIRE(voxel < map.size());
      sums[voxel] += p;
      covariances[voxel] += R * blobs.covariances[i] * R.transpose();
      ++counts[voxel];
    }
    for (std::size_t v = 0; v < map.size(); ++v) {
      const auto i = static_cast<Index>(v);
      CHECK(map.count(i) == counts[v]);
      CHECK((map.position(i) - sums[v] / counts[v]).norm() < 1e-12);
      CHECK((map.covariance(i) - covariances[v] / counts[v]).norm() < 1e-12);
    }
  }

  TEST_CASE("a point is matched with the nearest mean of its voxel, of faces, of all around") {
    Rng rng(2);
    const PointCloud<float> cloud = sample(rng, yard(), 3000, 0.02);
    for (const Index neighborhood : {1, 7, 27}) {
      GaussianVoxelMap map({.voxel_size = 0.5, .neighborhood = neighborhood});
      map.insert(cloud);
      for (int trial = 0; trial < 500; ++trial) {
        const Eigen::Vector3d query(rng.uniform(-11, 11), rng.uniform(-7, 7), rng.uniform(-1, 4));
        double nearest = std::numeric_limits<double>::infinity();
        for (Index i = 0; i < static_cast<Index>(map.size()); ++i) {
          const Eigen::Array3d apart = ((map.position(i) / 0.5).array().floor() - (query / 0.5).array().floor()).abs();
          const bool near = neighborhood == 1   ? apart.sum() == 0
                            : neighborhood == 7 ? apart.sum() <= 1
                                                : apart.maxCoeff() <= 1;
          if (near) nearest = std::min(nearest, (map.position(i) - query).norm());
        }
        const Index match = map.match(query, 0.6);
        if (nearest <= 0.6)
          CHECK((map.position(match) - query).norm() == doctest::Approx(nearest));
        else
          CHECK(match == -1);
      }
      CHECK(map.match(Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN()), 1.0) == -1);
    }
  }

  THREADS_TEST_CASE("registration/gaussian_voxel_map",
                    "alignment to it finds T_target_source, the same bits on any number of threads") {
    for_all(5, [](Rng& rng, int) {
      const SE3d truth = asymmetric_pose() * random_motion(rng, 1.0, 0.5);
      GaussianVoxelMap map;
      map.insert(sample(rng, yard(), 20000, 0.01));
      const PointCloud<float> source = with_normals_from(sample(rng, yard(), 5000, 0.01), truth);
      const SE3d guess = truth * random_motion(rng, 0.2, 0.03);
      const AlignResult result = Vgicp{}.align(source, map, guess);
      CHECK(result.status == AlignStatus::converged);
      CHECK(translation_error(truth, result.T_target_source) < 0.01);
      CHECK(rotation_error(truth, result.T_target_source) < 0.002);
      for (const Index threads : {2, 8})
        CHECK(Vgicp{}.align(source, map, guess, ThreadPool(threads)).T_target_source == result.T_target_source);
    });
  }

  TEST_CASE("covariances of discs, point by point, give what normals give") {
    Rng rng(4);
    const SE3d truth = asymmetric_pose();
    const PointCloud<float> surface = sample(rng, yard(), 8000);
    const PointCloud<float> source = with_normals_from(sample(rng, yard(), 2000, 0.01), truth);
    const auto discs = [](const PointCloud<float>& cloud) {
      GaussianCloud gaussians{cloud.positions, {}};
      for (const Eigen::Vector3f& n : cloud.normals)
        gaussians.covariances.push_back(chainslam::detail::disc({n[0], n[1], n[2]}, 1e-3));
      return gaussians;
    };
    const SE3d guess = truth * random_motion(rng, 0.2, 0.03);
    const IndexedGaussians<> gaussians(discs(surface));
    const AlignResult by_normals = Gicp{}.align(source, IndexedCloud<>(surface), guess);
    const AlignResult by_covariances = Icp<DistributionToDistribution>{}.align(discs(source), gaussians, guess);
    CHECK(by_covariances.status == AlignStatus::converged);
    CHECK(by_covariances.inliers == by_normals.inliers);
    CHECK(translation_error(by_normals.T_target_source, by_covariances.T_target_source) < 1e-5);
    CHECK(rotation_error(by_normals.T_target_source, by_covariances.T_target_source) < 1e-6);
    // A cloud with normals will do for a source, too.
    CHECK(translation_error(by_covariances.T_target_source,
                            Icp<DistributionToDistribution>{}.align(source, gaussians, guess).T_target_source) < 1e-6);
    CHECK_THROWS_AS(IndexedGaussians<>(GaussianCloud{surface.positions, {}}), std::invalid_argument);
  }

  TEST_CASE("nothing in it, and mistakes") {
    const PointCloud<float> source = [] {
      Rng rng(3);
      return sample(rng, yard(), 100);
    }();
    CHECK(Vgicp{}.align(source, GaussianVoxelMap(), SE3d()).status == AlignStatus::too_few_points);
    GaussianVoxelMap map;
    map.insert(std::vector<Eigen::Vector3f>(20, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN())));
    CHECK(map.size() == 0);
    CHECK_THROWS_AS(GaussianVoxelMap({.voxel_size = 0}), std::invalid_argument);
    CHECK_THROWS_AS(GaussianVoxelMap({.neighborhood = 5}), std::invalid_argument);
    CHECK_THROWS_AS(GaussianVoxelMap({.thickness = 0}), std::invalid_argument);
  }
}

}  // namespace chainslam::test
