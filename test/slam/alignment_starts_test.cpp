#include "chainslam/slam/closure_candidates.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <vector>

#include "chainslam/slam/loop_closer.hpp"
#include "slam/street.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {
namespace starts {

/// Covariance of a position that is known to `along` metres in one direction and to a decimetre across.
Matrix6d known_to(double along, const Eigen::Vector3d& direction) {
  Matrix6d covariance = 1e-4 * Matrix6d::Identity();
  covariance.topLeftCorner<3, 3>() =
      0.01 * Eigen::Matrix3d::Identity() + along * along * direction * direction.transpose();
  return covariance;
}

/// A block that was walked round, and a scan from a corner a minute later that the graph has elsewhere.
struct Astray {
  test::Street street;
  std::vector<Keyframe> keyframes;
  SE3d truth;
  PositionIndex index;

  explicit Astray(const Eigen::Vector3d& error) {
    std::vector<SE3d> poses = test::way_round();
    poses.resize(16);
    truth = poses[8] * SE3d(SO3d::exp({0.02, -0.03, 0.5}), {1.2, -0.8, 0.1});
    poses.push_back(truth);
    keyframes = test::keyframes_at(poses);
    for (std::size_t i = 0; i < keyframes.size(); ++i) keyframes[i].cloud = street.scan(poses[i], Rng(100 + i));
    keyframes.back().T_map_body = SE3d(SO3d(), error) * truth;
    keyframes.back().time = keyframes.back().time + seconds(60);
    index.rebuild(keyframes);
  }

  /// Whether the last of `searches` finds the scan where it is.
  [[nodiscard]] bool finds(LoopCloser<>& closer, int searches = 1) const {
    std::vector<LoopClosure> tried;
    for (int i = 0; i < searches; ++i) {
      tried = closer.search(keyframes, index, keyframes.back().id);
      if (!tried.empty() && tried.back().verdict == ClosureVerdict::accepted) break;
    }
    if (tried.empty() || tried.back().verdict != ClosureVerdict::accepted) return false;
    const SE3d expected = keyframes[static_cast<std::size_t>(tried.back().from.value)].T_map_body.inverse() * truth;
    CHECK(test::translation_error(expected, tried.back().T_from_to) < 0.1);
    return true;
  }
};

/// Refuses whatever it is given, and notes how many points its first stage looked at.
struct Refusing {
  std::vector<std::size_t>* rough_points = nullptr;

  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult align(const Source&, const Target&, const SE3d&, const Exec& = {}) const {
    return {};
  }
  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult rough(const Source& source, const Target&, const SE3d&, const Exec& = {}) const {
    rough_points->push_back(cloud_size(source));
    return {};
  }
};

}  // namespace starts
}  // namespace

TEST_SUITE("slam/alignment_starts") {
  using namespace starts;

  TEST_CASE("starts lie along the direction that is known least, up to two deviations") {
    test::for_all(20, [](Rng& rng, int) {
      const Eigen::Vector3d direction =
          Eigen::Vector3d(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(-1, 1)).normalized();
      const double along = rng.uniform(0.2, 6);
      const AlignmentStarts starts;
      const Matrix6d covariance = known_to(along, direction);
      CHECK(AlignmentStarts::deviation(covariance) == doctest::Approx(std::sqrt(along * along + 0.01)));
      const auto offsets = starts(covariance, SO3d(), 1);
      const double reach = 2 * std::sqrt(along * along + 0.01);
      CHECK(offsets.size() == 2 * static_cast<std::size_t>(reach / starts.spacing));
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (const Eigen::Vector3d& offset : offsets) {
        CHECK(offset.cross(direction).norm() < 1e-6);
        CHECK(offset.norm() <= reach);
        CHECK(std::abs(std::remainder(offset.norm(), starts.spacing)) < 1e-9);
        sum += offset;
      }
      CHECK(sum.norm() < 1e-9);  // both ways
    });
    CHECK(AlignmentStarts{}(known_to(100, Eigen::Vector3d::UnitX()), SO3d(), 1).size() == 10);  // 15 m at most
    CHECK(AlignmentStarts{}(Matrix6d::Zero(), SO3d(), 1).empty());
  }

  TEST_CASE("after two searches in vain they lie around, horizontally, farther from search to search") {
    const AlignmentStarts starts;
    const SO3d R_map_body = SO3d::exp({0.2, -0.3, 1});
    CHECK(starts(Matrix6d::Zero(), R_map_body, 2).empty());
    std::set<long> radii;
    for (Index refused = 3; refused < 8; ++refused) {
      const auto offsets = starts(Matrix6d::Zero(), R_map_body, refused);
      CHECK(offsets.size() == 8);
      for (const Eigen::Vector3d& offset : offsets) {
        CHECK(std::abs((R_map_body * offset).z()) < 1e-9);
        radii.insert(std::lround(offset.norm()));
      }
    }
    CHECK(radii == std::set<long>{3, 6, 9, 12, 15});
    CHECK(starts(Matrix6d::Zero(), R_map_body, 8).front().norm() == doctest::Approx(3));
    CHECK(AlignmentStarts{.max_distance = 0}(known_to(100, Eigen::Vector3d::UnitX()), R_map_body, 8).empty());
  }

  TEST_CASE("a scan that the graph has 8 m off is found if the graph says so, or after searches in vain") {
    const Eigen::Vector3d error(0, 8, 0);  // along x, the street looks the same
    Astray told(error), untold(error);
    const Eigen::Vector3d in_scan = told.truth.rotation().inverse() * error.normalized();
    const auto along_error = [&](KeyframeId, KeyframeId) { return known_to(4, in_scan); };
    told.index.set_covariance(along_error);
    LoopCloserOptions once = test::small_submaps;
    once.starts.max_distance = 0;
    const ProximityCandidates few{.min_keyframes = 0};
    LoopCloser<> at_once(once, few), known(test::small_submaps, few), unknown(test::small_submaps, few);
    CHECK_FALSE(told.finds(at_once, 10));
    CHECK(told.finds(known));
    CHECK_FALSE(untold.finds(unknown));
    CHECK(untold.finds(unknown, 9));
  }

  TEST_CASE("starts are compared by 512 points of the scan or more, or by all") {
    const Astray astray({0, 8, 0});
    const std::size_t size = astray.keyframes.back().cloud.load()->size();
    REQUIRE(size > 2 * 512);
    std::vector<std::size_t> points;
    LoopCloserOptions options = test::small_submaps;
    options.starts.patience = 0;
    const auto look = [&] {
      points.clear();
      LoopCloser<ProximityCandidates, Refusing> closer(options, {.min_keyframes = 0}, Refusing{&points});
      static_cast<void>(closer.search(astray.keyframes, astray.index, astray.keyframes.back().id));
      REQUIRE_FALSE(points.empty());
      return points.front();
    };
    CHECK(look() >= 512);
    CHECK(look() < 2 * 512);
    options.starts.points = 0;
    CHECK(look() == size);
  }
}

}  // namespace chainslam
