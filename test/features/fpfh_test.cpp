#include "chainslam/features/fpfh.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

/// A floor, a wall, part of a ball and some brush, 8 m wide, seen from above. Normals are made a little rough: of two
/// alike to rounding it is rounding that tells which is nearer to the line between them.
PointCloud<float> corner_with_ball(Rng& rng, int count) {
  PointCloud<float> cloud;
  for (int i = 0; i < count; ++i) {
    Eigen::Vector3d p(rng.uniform(0, 8), rng.uniform(0, 8), 0.02 * rng.normal());
    if (i % 4 == 1) p = {rng.uniform(0, 8), 0.02 * rng.normal(), rng.uniform(0, 4)};
    if (i % 4 == 2)
      p = Eigen::Vector3d(5, 5, 1) + 2 * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized();
    if (i % 4 == 3) p = {rng.uniform(0, 2), rng.uniform(6, 8), rng.uniform(0, 2)};
    cloud.positions.push_back(p.cast<float>());
  }
  estimate_normals(cloud, {.neighbors = 10}, {4, 4, 20});
  for (Eigen::Vector3f& n : cloud.normals)
    if (!n.isZero())
      n = (n + 0.02F * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).cast<float>()).normalized();
  return cloud;
}

/// The definition once more, from the papers, without haste: angles in double by atan2 and acos, neighbours by sorting
/// all distances.
class SlowFpfh {
 public:
  SlowFpfh(const PointCloud<float>& cloud, double radius, std::size_t max_neighbors,
           FpfhBlend blend = FpfhBlend::half_own)
      : cloud_(cloud), radius_(radius), max_neighbors_(max_neighbors), blend_(blend) {}

  [[nodiscard]] Eigen::VectorXd operator()(std::size_t i) const {
    const Eigen::VectorXd own = simplified(i);
    Eigen::VectorXd sum = Eigen::VectorXd::Zero(33);
    double weights = 0;
    for (const std::size_t j : neighbors(i)) {
      const Eigen::VectorXd theirs = simplified(j);
      if (theirs.isZero()) continue;
      const double distance = (position(cloud_, j) - position(cloud_, i)).norm();
      const double weight = 1 / (blend_ == FpfhBlend::half_own ? distance : distance * distance);
      sum += weight * theirs;
      weights += weight;
    }
    if (weights == 0) return own;
    if (blend_ == FpfhBlend::neighbors_only) return sum / weights;
    return (own + sum / weights) / 2;
  }

  /// SPFH.
  [[nodiscard]] Eigen::VectorXd own(std::size_t i) const { return simplified(i); }

 private:
  [[nodiscard]] std::vector<std::size_t> neighbors(std::size_t i) const {
    std::vector<std::pair<double, std::size_t>> all;
    for (std::size_t j = 0; j < cloud_.size(); ++j) {
      const double distance = (position(cloud_, j) - position(cloud_, i)).norm();
      if (distance <= radius_) all.emplace_back(distance, j);
    }
    std::sort(all.begin(), all.end());
    all.resize(std::min(all.size(), max_neighbors_));
    std::vector<std::size_t> chosen;
    for (const auto& [distance, j] : all)
      if (distance > 0 && !cloud_.normals[j].isZero()) chosen.push_back(j);
    return chosen;
  }

  [[nodiscard]] Eigen::VectorXd simplified(std::size_t i) const {
    Eigen::VectorXd histogram = Eigen::VectorXd::Zero(33);
    if (cloud_.normals[i].isZero()) return histogram;
    double pairs = 0;
    for (const std::size_t j : neighbors(i)) {
      std::size_t s = i, t = j;
      const Eigen::Vector3d line = (position(cloud_, t) - position(cloud_, s)).normalized();
      const auto to_line = [&](std::size_t k) {  // the angle between a normal and the line, not the half-line
        return std::acos(std::min(1.0, std::abs(cloud_.normals[k].cast<double>().normalized().dot(line))));
      };
      if (to_line(s) > to_line(t)) std::swap(s, t);
      const Eigen::Vector3d n_s = cloud_.normals[s].cast<double>(), n_t = cloud_.normals[t].cast<double>();
      const Eigen::Vector3d direction = (position(cloud_, t) - position(cloud_, s)).normalized();
      if (direction.cross(n_s).norm() < 1e-6) continue;
      const Eigen::Vector3d u = n_s, v = direction.cross(u).normalized(), w = u.cross(v);
      const double theta = std::atan2(w.dot(n_t), u.dot(n_t)), alpha = v.dot(n_t), phi = u.dot(direction);
      const auto bin = [](double value, double low, double high) {
        return std::clamp(static_cast<int>(std::floor(11 * (value - low) / (high - low))), 0, 10);
      };
      histogram[bin(theta, -std::numbers::pi, std::numbers::pi)] += 1;
      histogram[11 + bin(alpha, -1, 1)] += 1;
      histogram[22 + bin(phi, -1, 1)] += 1;
      pairs += 1;
    }
    if (pairs > 0) histogram *= 100 / pairs;
    return histogram;
  }

  const PointCloud<float>& cloud_;
  double radius_;
  std::size_t max_neighbors_;
  FpfhBlend blend_;
};

float sum_of(const FpfhFeatures& features, Eigen::Index column, Eigen::Index histogram) {
  return features.col(column).segment<11>(11 * histogram).sum();
}

}  // namespace

TEST_SUITE("features/fpfh") {
  TEST_CASE("equals the definition, written down a second time") {
    test::for_all(8, [](Rng& rng, int size) {
      const PointCloud<float> cloud = corner_with_ball(rng, 150 + 10 * size);
      const KdTree<float> tree(cloud);
      const FpfhOptions nearest{.radius = 1.5, .max_neighbors = 15}, all{.radius = 1.5, .max_neighbors = 0};
      const FpfhOptions pcl{.radius = 1.5, .max_neighbors = 0, .blend = FpfhBlend::neighbors_only};
      for (const FpfhOptions& options : {nearest, all, pcl}) {
        const FpfhFeatures features = estimate_fpfh(cloud, tree, options);
        const SlowFpfh slow(cloud, options.radius, options.max_neighbors == 0 ? 10'000 : 15, options.blend);
        int different = 0;
        for (std::size_t i = 0; i < cloud.size(); i += 7) {
          // A pair on the border of two bins may fall to the other side; that is 1 of 10 to 100 pairs.
          const double worst =
              (features.col(static_cast<Eigen::Index>(i)).cast<double>() - slow(i)).cwiseAbs().maxCoeff();
          CHECK(worst < 10);
          different += worst > 1e-3 ? 1 : 0;
        }
        CHECK(different <= 1);
      }
    });
  }

  TEST_CASE("golden values: a floor that meets a wall, computed by hand") {
    // The line from p on the floor to q on the wall, (1, 0, 1) / sqrt 2, has 45 degrees with both normals, so p, asked
    // first, gives the frame: u = z, v = line x u = -y, w = u x v = x. theta = atan2(w . n_q, u . n_q) = atan2(-1, 0) =
    // -pi / 2: bin 11 / 4 = 2. alpha = v . n_q = 0: bin 5. phi = u . line = 0.707: bin 5.5 * 1.707 = 9. Asked from q,
    // all is the same mirrored in the plane between them, which turns alpha alone: also 0.
    PointCloud<float> cloud;
    cloud.positions = {{-1, 0, 0}, {0, 0, 1}};
    cloud.normals = {{0, 0, 1}, {-1, 0, 0}};
    const FpfhFeatures features = estimate_fpfh(cloud, KdTree<float>(cloud));
    Eigen::Matrix<float, 33, 1> expected = Eigen::Matrix<float, 33, 1>::Zero();
    expected[2] = expected[11 + 5] = expected[22 + 9] = 100;
    CHECK(features.col(0) == expected);
    CHECK(features.col(1) == expected);
    // A third point 1 m behind p, its normal like p's: one pair in the middle bins for it and p. Its SPFH and p's are
    // half and half; p's FPFH weighs q by 1 / sqrt 2 and the third by 1.
    cloud.positions.emplace_back(-2.0F, 0.0F, 0.0F);
    cloud.normals.emplace_back(0.0F, 0.0F, 1.0F);
    const FpfhFeatures three = estimate_fpfh(cloud, KdTree<float>(cloud), {.radius = 1.5});
    Eigen::Matrix<float, 33, 1> own = 0.5F * expected, behind = Eigen::Matrix<float, 33, 1>::Zero();
    for (const Eigen::Index middle : {5, 16, 27}) {
      own[middle] += 50;
      behind[middle] = 100;
    }
    const float weight_q = 1 / std::sqrt(2.0F);
    const Eigen::Matrix<float, 33, 1> p = 0.5F * (own + (weight_q * expected + behind) / (weight_q + 1));
    CHECK(three.col(0).isApprox(p, 1e-6F));
    CHECK(three.col(1).isApprox(0.5F * (expected + own), 1e-6F));
    CHECK(three.col(2).isApprox(0.5F * (behind + own), 1e-6F));
  }

  TEST_CASE("pairs are binned as atan2 and the cosines have them, several at once") {
    test::for_all(100, [](Rng& rng, int size) {
      const auto direction = [&rng] {
        return Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized().cast<float>().eval();
      };
      detail::PairHistogram histogram;
      PointCloud<float> cloud;
      cloud.positions.emplace_back(0.0F, 0.0F, 0.0F);
      cloud.normals.push_back(direction());
      for (int i = 0; i < size; ++i) {
        cloud.positions.push_back(direction());
        cloud.normals.push_back(direction());
        histogram.add(cloud.positions.back(), cloud.normals.back());
      }
      detail::PairHistogram::Counts counts;
      REQUIRE(histogram.count(cloud.normals[0], counts) == size);
      // Only the first point has all others near: its own histogram is what the slow definition blends for it alone.
      const Eigen::VectorXd expected = SlowFpfh(cloud, 1.01, 10'000).own(0);
      int misplaced = 0;
      for (std::size_t bin = 0; bin < counts.size(); ++bin)
        misplaced += std::abs(counts[bin] -
                              static_cast<int>(std::lround(expected[static_cast<Eigen::Index>(bin)] * size / 100)));
      CHECK(misplaced <= 2);  // one pair on a border
    });
  }

  TEST_CASE("neighbourhoods hold what the search finds, and give the normals that searching gives") {
    Rng rng(11);
    PointCloud<float> cloud = corner_with_ball(rng, 700);
    cloud.positions[5].setConstant(std::numeric_limits<float>::quiet_NaN());
    const KdTree<float> tree(cloud);
    const Neighborhoods near(cloud, tree, 1.2, 0), nearest(cloud, tree, 1.2, 9);
    std::vector<Neighbor<float>> found;
    for (Index i = 0; i < near.size(); ++i) {
      if (i == 5) {
        CHECK(near[i].empty());
        continue;
      }
      tree.within(cloud.positions[static_cast<std::size_t>(i)], 1.2F, found);
      CHECK(near[i].size() == found.size());
      CHECK(nearest[i].size() == std::min<std::size_t>(9, found.size()));
    }
    for (const NormalOptions& options :
         {NormalOptions{.neighbors = 0, .radius = 0.9}, NormalOptions{.neighbors = 12}}) {
      PointCloud<float> searched = cloud, known = cloud;
      NormalOptions limited = options;
      limited.radius = std::min(options.radius, 1.2);
      limited.covariances = true;
      const NormalEstimates expected = estimate_normals(searched, tree, limited, {4, 4, 20});
      const NormalEstimates estimates = estimate_normals(known, near, limited, {4, 4, 20});
      CHECK(estimates.without_normal == expected.without_normal);
      REQUIRE(estimates.covariances.size() == cloud.size());
      for (std::size_t i = 0; i < cloud.size(); ++i) {
        if (estimates.planarity[i] < 0.05F) continue;  // no plane: the normal hangs on rounding
        CHECK((searched.normals[i] - known.normals[i]).norm() < 1e-3F);
        const std::array<float, 6>& c = expected.covariances[i];
        for (std::size_t j = 0; j < c.size(); ++j)  // sums of up to a hundred floats, in another order
          CHECK(std::abs(estimates.covariances[i][j] - c[j]) <= 1e-5F * (c[0] + c[3] + c[5]));
      }
    }
    CHECK_THROWS_AS((void)estimate_normals(cloud, Neighborhoods<float>{}, {}), std::invalid_argument);
    CHECK_THROWS_AS((void)estimate_fpfh(cloud, Neighborhoods<float>{}), std::invalid_argument);
    CHECK_THROWS_AS(Neighborhoods(cloud, tree, 0.0, 5), std::invalid_argument);
    CHECK_THROWS_AS(Neighborhoods(cloud, tree, 1.0, -1), std::invalid_argument);
  }

  TEST_CASE("each of the three histograms sums to 100") {
    Rng rng(5);
    const PointCloud<float> cloud = corner_with_ball(rng, 1000);
    const FpfhFeatures features = estimate_fpfh(cloud, KdTree<float>(cloud), {.radius = 1.0, .max_neighbors = 60});
    for (Eigen::Index i = 0; i < features.cols(); ++i)
      for (const Eigen::Index histogram : {0, 1, 2})
        CHECK(sum_of(features, i, histogram) == doctest::Approx(100).epsilon(1e-5));
    CHECK(features.minCoeff() >= 0);
  }

  TEST_CASE("a rigid motion of cloud and normals changes nothing but rounding at the borders of bins") {
    test::for_all(10, [](Rng& rng, int) {
      const PointCloud<float> cloud = corner_with_ball(rng, 800);
      Vector6d xi;
      for (Eigen::Index i = 0; i < 6; ++i) xi[i] = rng.uniform(-2, 2);
      const PointCloud<float> moved = transformed(cloud, SE3d::exp(xi));
      const FpfhOptions options{.radius = 1.2, .max_neighbors = 1000};  // no neighbour comes or goes by rank
      const FpfhFeatures before = estimate_fpfh(cloud, KdTree<float>(cloud), options);
      const FpfhFeatures after = estimate_fpfh(moved, KdTree<float>(moved), options);
      const Eigen::VectorXf worst = (before - after).cwiseAbs().colwise().maxCoeff();
      CHECK(worst.mean() < 0.1);
      CHECK(worst.maxCoeff() < 10);
    });
  }

  TEST_CASE("a plane fills the middle bins alone") {
    PointCloud<float> cloud;
    for (int x = 0; x < 12; ++x)
      for (int y = 0; y < 12; ++y) {
        cloud.positions.emplace_back(static_cast<float>(x), static_cast<float>(y), 0.0F);
        cloud.normals.emplace_back(0.0F, 0.0F, 1.0F);
      }
    const FpfhFeatures features = estimate_fpfh(cloud, KdTree<float>(cloud));
    for (Eigen::Index i = 0; i < features.cols(); ++i)
      for (const Eigen::Index middle : {5, 16, 27}) CHECK(features(middle, i) == doctest::Approx(100));
  }

  TEST_CASE("points without a normal, alone, in one place, or NaN get zeros and spoil nobody") {
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    Rng rng(6);
    const PointCloud<float> clean = corner_with_ball(rng, 300);
    PointCloud<float> cloud = clean;
    const auto add = [&](const Eigen::Vector3f& p, const Eigen::Vector3f& n) {
      cloud.positions.push_back(p);
      cloud.normals.push_back(n);
    };
    add({4, 4, 0.1F}, {0, 0, 0});
    add({4, 4, 0.2F}, {nan, nan, nan});
    add({nan, 0, 0}, {0, 0, 1});
    add({100, 0, 0}, {0, 0, 1});
    for (int i = 0; i < 3; ++i) add({200, 0, 0}, {0, 0, 1});
    for (int i = 0; i < 3; ++i) add({300, 0, static_cast<float>(i)}, {0, 0, 1});  // a line along its normals
    const FpfhOptions options{.radius = 1.5, .max_neighbors = 1000};
    const FpfhFeatures features = estimate_fpfh(cloud, KdTree<float>(cloud), options);
    CHECK(features.allFinite());
    CHECK(features.rightCols<10>().isZero(0));
    CHECK(features.leftCols(300) == estimate_fpfh(clean, KdTree<float>(clean), options));
    CHECK(estimate_fpfh(PointCloud<float>{}, KdTree<float>(PointCloud<float>{})).cols() == 0);
  }

  TEST_CASE("any number of threads gives the same bits, any search the same features") {
    Rng rng(7);
    const PointCloud<float> cloud = corner_with_ball(rng, 1500);
    const KdTree<float> tree(cloud);
    const FpfhOptions options{.radius = 1.0, .max_neighbors = 1000};
    const FpfhFeatures expected = estimate_fpfh(cloud, tree, options);
    for (const Index threads : {1, 2, 4}) CHECK(estimate_fpfh(cloud, tree, options, ThreadPool(threads)) == expected);
    const FpfhFeatures other = estimate_fpfh(cloud, BruteForce<double>(cloud), options);
    CHECK((other - expected).cwiseAbs().maxCoeff() < 1e-3F);
  }

  TEST_CASE("a caller's mistakes are thrown at the door") {
    Rng rng(8);
    PointCloud<float> cloud = corner_with_ball(rng, 100);
    const KdTree<float> tree(cloud);
    CHECK_THROWS_AS((void)estimate_fpfh(cloud, tree, {.radius = 0}), std::invalid_argument);
    CHECK_THROWS_AS((void)estimate_fpfh(cloud, tree, {.max_neighbors = 1}), std::invalid_argument);
    CHECK_THROWS_AS((void)estimate_fpfh(cloud, tree, {.max_neighbors = -1}), std::invalid_argument);
    cloud.normals.clear();
    CHECK_THROWS_AS((void)estimate_fpfh(cloud, tree), std::invalid_argument);
  }
}

}  // namespace chainslam
