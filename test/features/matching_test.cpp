#include "chainslam/features/matching.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <limits>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

Eigen::MatrixXf random_features(Rng& rng, Eigen::Index rows, Eigen::Index count) {
  Eigen::MatrixXf features(rows, count);
  for (Eigen::Index i = 0; i < count; ++i)
    for (Eigen::Index row = 0; row < rows; ++row) features(row, i) = static_cast<float>(rng.uniform(0, 20));
  return features;
}

Index nearest_by_brute_force(const Eigen::MatrixXf& features, const Eigen::VectorXf& query) {
  Index best = -1;
  double least = std::numeric_limits<double>::infinity();
  for (Eigen::Index i = 0; i < features.cols(); ++i) {
    const double squared = (features.col(i).cast<double>() - query.cast<double>()).squaredNorm();
    if (squared < least) {
      least = squared;
      best = static_cast<Index>(i);
    }
  }
  return best;
}

std::vector<FeatureMatch> matches_by_brute_force(const Eigen::MatrixXf& source, const Eigen::MatrixXf& target,
                                                 bool mutual) {
  std::vector<FeatureMatch> matches;
  for (Eigen::Index i = 0; i < source.cols(); ++i) {
    const FeatureMatch match{static_cast<Index>(i), nearest_by_brute_force(target, source.col(i))};
    if (match.target < 0) continue;
    if (mutual && nearest_by_brute_force(source, target.col(match.target)) != match.source) continue;
    matches.push_back(match);
  }
  return matches;
}

}  // namespace

TEST_SUITE("features/matching") {
  TEST_CASE("finds what comparing all with all in double finds") {
    test::for_all(40, [](Rng& rng, int size) {
      const Eigen::Index rows = 1 + rng.uniform_index(40);
      const Eigen::MatrixXf source = random_features(rng, rows, 3 * size + 1);
      const Eigen::MatrixXf target = random_features(rng, rows, 12 * size + 1);
      for (const bool mutual : {false, true})
        CHECK(match_features(source, target, {.mutual = mutual}) == matches_by_brute_force(source, target, mutual));
    });
  }

  TEST_CASE("finds the nearest also where the differences are smaller than the products' rounding") {
    // Features near (1000, ..., 1000): |t|^2 is 3e7, whose float steps are 2, while neighbours differ by 0.01.
    test::for_all(20, [](Rng& rng, int) {
      const Eigen::MatrixXf common = Eigen::MatrixXf::Constant(33, 1, 1000.0F);
      Eigen::MatrixXf target = 0.001F * random_features(rng, 33, 700);
      target.colwise() += common.col(0);
      Eigen::MatrixXf source = 0.001F * random_features(rng, 33, 90);
      source.colwise() += common.col(0);
      CHECK(match_features(source, target) == matches_by_brute_force(source, target, true));
    });
  }

  TEST_CASE("of equal distances the lowest index wins, across blocks too") {
    Eigen::MatrixXf target = Eigen::MatrixXf::Constant(33, 2000, 9.0F);
    for (const Eigen::Index same : {700, 1100, 1900}) target.col(same).setConstant(1.0F);
    Eigen::MatrixXf source = Eigen::MatrixXf::Constant(33, 150, 1.0F);
    const std::vector<FeatureMatch> all = match_features(source, target, {.mutual = false});
    REQUIRE(all.size() == 150);
    for (const FeatureMatch& match : all) CHECK(match.target == 700);
    CHECK(match_features(source, target) == std::vector<FeatureMatch>{{0, 700}});
  }

  TEST_CASE("columns of zeros and not finite ones are never matched") {
    Rng rng(3);
    Eigen::MatrixXf source = random_features(rng, 33, 60), target = random_features(rng, 33, 60);
    source.col(5).setZero();
    target.col(7).setZero();
    source(2, 8) = std::numeric_limits<float>::quiet_NaN();
    target(3, 9) = std::numeric_limits<float>::infinity();
    const std::vector<FeatureMatch> matches = match_features(source, target, {.mutual = false});
    CHECK(matches.size() == 58);
    for (const FeatureMatch& match : matches) {
      CHECK(match.source != 5);
      CHECK(match.source != 8);
      CHECK(match.target != 7);
      CHECK(match.target != 9);
    }
    CHECK(match_features(Eigen::MatrixXf::Zero(33, 4), target).empty());
    CHECK(match_features(source, Eigen::MatrixXf::Zero(33, 4)).empty());
    CHECK(match_features(Eigen::MatrixXf(33, 0), target).empty());
    CHECK(match_features(source, Eigen::MatrixXf(33, 0)).empty());
  }

  TEST_CASE("any number of threads gives the same matches") {
    Rng rng(4);
    const Eigen::MatrixXf source = random_features(rng, 33, 500), target = random_features(rng, 33, 900);
    const std::vector<FeatureMatch> expected = match_features(source, target);
    CHECK(expected.size() > 100);
    for (const Index threads : {1, 2, 4}) CHECK(match_features(source, target, {}, ThreadPool(threads)) == expected);
  }

  TEST_CASE("the ratio of nearest and next, of the more doubtful side, is what the definition says, and cuts") {
    test::for_all(10, [](Rng& rng, int size) {
      const Eigen::MatrixXf source = random_features(rng, 33, 20 + 2 * size), target = random_features(rng, 33, 200);
      const auto two_nearest = [](const Eigen::MatrixXf& features, const Eigen::VectorXf& query) {
        std::vector<double> distances;
        for (Eigen::Index i = 0; i < features.cols(); ++i)
          distances.push_back((features.col(i).cast<double>() - query.cast<double>()).norm());
        std::sort(distances.begin(), distances.end());
        return distances[0] / distances[1];
      };
      const std::vector<FeatureMatch> all = match_features(source, target, {.by_quality = true});
      std::vector<FeatureMatch> plain = match_features(source, target);
      REQUIRE(all.size() == plain.size());
      for (std::size_t i = 0; i < all.size(); ++i) {
        const double ratio =
            std::max(two_nearest(target, source.col(all[i].source)), two_nearest(source, target.col(all[i].target)));
        CHECK(static_cast<double>(all[i].ratio) == doctest::Approx(ratio).epsilon(1e-5));
        if (i > 0) CHECK(all[i - 1].ratio <= all[i].ratio);
      }
      const std::size_t kept = all.size() / 2;
      std::vector<FeatureMatch> best(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(kept));
      const auto count = static_cast<Index>(kept);
      CHECK(match_features(source, target, {.max_matches = std::max(count, 1), .by_quality = true}).size() ==
            std::max<std::size_t>(kept, 1));
      if (kept > 0) {
        const double limit = static_cast<double>(best.back().ratio);
        CHECK(match_features(source, target, {.max_ratio = limit, .by_quality = true}) == best);
        std::sort(best.begin(), best.end(),
                  [](const FeatureMatch& a, const FeatureMatch& b) { return a.source < b.source; });
        CHECK(match_features(source, target, {.max_matches = count}) == best);
      }
      for (const FeatureMatch& match : plain) CHECK(match.ratio == 1);
    });
    CHECK_THROWS_AS((void)match_features(Eigen::MatrixXf::Ones(3, 2), Eigen::MatrixXf::Ones(3, 2), {.max_ratio = 0}),
                    std::invalid_argument);
    CHECK_THROWS_AS((void)match_features(Eigen::MatrixXf::Ones(3, 2), Eigen::MatrixXf::Ones(3, 2), {.max_matches = -1}),
                    std::invalid_argument);
  }

  TEST_CASE("many features that are nearly or wholly the same, as flat ground has them") {
    test::for_all(10, [](Rng& rng, int size) {
      Eigen::MatrixXf source = random_features(rng, 33, 300), target = random_features(rng, 33, 400);
      const Eigen::VectorXf ground = random_features(rng, 33, 1);
      for (Eigen::Index i = 0; i < 300; i += 2) source.col(i) = ground + 1e-3F * random_features(rng, 33, 1).col(0);
      for (Eigen::Index i = 0; i < 400; i += 3) target.col(i) = ground + 1e-3F * random_features(rng, 33, 1).col(0);
      for (Eigen::Index i = 0; i < size; ++i) source.col(3 * i) = target.col(4 * i) = ground;
      for (const bool mutual : {false, true})
        CHECK(match_features(source, target, {.mutual = mutual}) == matches_by_brute_force(source, target, mutual));
      CHECK(match_features(source, target, {.by_quality = true}, ThreadPool(3)) ==
            match_features(source, target, {.by_quality = true}));
    });
  }

  TEST_CASE("features of different lengths are refused") {
    CHECK_THROWS_AS((void)match_features(Eigen::MatrixXf::Ones(33, 2), Eigen::MatrixXf::Ones(32, 2)),
                    std::invalid_argument);
  }
}

}  // namespace chainslam
