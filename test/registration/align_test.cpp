#include "chainslam/registration/align.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/features/normals.hpp"
#include "registration/scenes.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

struct PlainPair {
  PointCloud<float> source{}, target{};
  SE3d truth{}, guess{};
};

PlainPair plain_pair(std::uint64_t seed) {
  Rng rng(seed);
  const SE3d truth = asymmetric_pose();
  PlainPair pair{.target = sample(rng, yard(), 8000), .truth = truth};
  pair.target.normals.clear();
  pair.source = seen_from(sample(rng, yard(), 3000, 0.01), truth);
  pair.source.normals.clear();
  pair.guess = truth * random_motion(rng, 0.3, 0.03);
  return pair;
}

bool same_result(const AlignResult& a, const AlignResult& b) {
  return a.T_target_source.matrix() == b.T_target_source.matrix() && a.inliers == b.inliers && a.hessian == b.hessian;
}

}  // namespace

TEST_SUITE("registration/align") {
  TEST_CASE("plain clouds are aligned with every metric that needs no covariances") {
    const PlainPair pair = plain_pair(11);
    const auto check = [&](const AlignResult& result, double bound) {
      CHECK(result.converged());
      CHECK(translation_error(pair.truth, result.T_target_source) < bound);
    };
    check(PointToPlaneIcp{}.align(pair.source, pair.target, pair.guess), 0.006);
    check(Gicp{}.align(pair.source, pair.target, pair.guess), 0.006);
    // To points that are 5 cm apart and more: half of their spacing over the root of the matches along each axis.
    check(PointToPointIcp{}.align(pair.source, pair.target, pair.guess), 0.05);
    check(align(pair.source, pair.target, pair.guess), 0.006);
  }

  TEST_CASE("the result is bit-identical to that of a target indexed beforehand") {
    PlainPair pair = plain_pair(12);
    const AlignResult at_once = Gicp{}.align(pair.source.positions, pair.target.positions, pair.guess, ThreadPool(3));
    const NormalOptions of_ten{.neighbors = 10};
    estimate_normals(pair.source, of_ten);
    estimate_normals(pair.target, of_ten);
    CHECK(same_result(at_once, Gicp{}.align(pair.source, IndexedCloud<>(pair.target), pair.guess)));
    CHECK(same_result(at_once, Gicp{}.align(pair.source, pair.target, pair.guess)));
  }

  TEST_CASE("normals that a cloud has are used") {
    PlainPair pair = plain_pair(13);
    pair.target.normals.assign(pair.target.size(), Eigen::Vector3f::UnitZ());
    const AlignResult result = PointToPlaneIcp{}.align(pair.source, pair.target, pair.guess);
    CHECK(result.degenerate_directions == 3);  // all normals vertical: x, y and yaw are free
  }

  TEST_CASE("without a guess, alignment starts from the identity") {
    const PlainPair pair = plain_pair(14);
    const PointCloud<float> near = transformed(pair.source, pair.guess);
    const SE3d rest = pair.truth * pair.guess.inverse();
    CHECK(translation_error(rest, PointToPlaneIcp{}.align(near, pair.target).T_target_source) < 0.006);
    const IndexedCloud<> indexed(pair.target);
    CHECK(same_result(PointToPointIcp{}.align(near, indexed), PointToPointIcp{}.align(near, pair.target, SE3d())));
  }

  TEST_CASE("empty clouds have a status") {
    const std::vector<Eigen::Vector3f> none;
    CHECK(PointToPlaneIcp{}.align(none, none).status == AlignStatus::too_few_points);
    CHECK(Gicp{}.align(plain_pair(15).source, none).status == AlignStatus::too_few_points);
  }
}

}  // namespace chainslam::test
