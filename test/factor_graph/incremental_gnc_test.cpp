#include "chainslam/factor_graph/incremental_gnc.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "factor_graph/pose_graphs.hpp"

// What the defaults of `IncrementalGncOptions` cost. What they decide is held where their thresholds are set:
// test/slam/group_gnc_values_test.cpp.

using namespace chainslam;

namespace {

using GncSmoother = IncrementalSmoother<SE3d>;

constexpr Key end = 20;

SE3d at(Key key) { return SE3d(SO3d(), {1.0 * key, 0, 0}); }
SqrtInformation<6> sigma(double value) { return NoiseModel<6>::from_sigma(value).sqrt_information(); }

/// A metre from pose to pose, as they begin, and trusted steps that measure what they like.
struct SlippingDrive {
  GncSmoother smoother{SmootherOptions{.patience = 0.0}, NoLag{}};
  IncrementalGnc<GncSmoother> gnc{smoother};
  std::vector<Index> steps;

  /// @param length  metres that the step from a key measures.
  template <class Length>
  explicit SlippingDrive(const Length& length) {
    for (Key key = 0; key < end; ++key) smoother.add_value(at(key));
    smoother.add_prior(0, at(0), NoiseModel<6>::from_sigma(1e-3));
    for (Key key = 0; key + 1 < end; ++key)
      steps.push_back(gnc.add({key, key + 1, SE3d(SO3d(), {length(key), 0, 0}), sigma(0.1)},
                              {.threshold = 28,
                               .price = 70,
                               .outlier_weight = 1e-8,
                               .trusted = true,
                               .previous = steps.empty() ? gnc.none : steps.back()}));
  }
};

}  // namespace

TEST_SUITE("factor_graph/incremental_gnc") {
  TEST_CASE("of a third of wrong closures in one update, none is accepted, after 16 updates of the smoother") {
    Index steps = 0, accepted = 0, rejected = 0;
    constexpr int graphs = 20;
    for (std::uint64_t seed = 1; seed <= graphs; ++seed) {
      Rng rng(seed);
      const PoseGraph graph = test::random_graph<SE3d>(rng, 60, 0.02);
      GncSmoother smoother(SmootherOptions{.patience = 0.0}, NoLag{});
      IncrementalGnc<GncSmoother> gnc(smoother);
      for (Key key = 0; key < 60; ++key) smoother.add_value(graph[key]);
      smoother.add_prior(0, graph[0], NoiseModel<6>::from_sigma(1e-3));
      std::vector<Index> right, wrong;
      for (const BetweenFactor<SE3d>& factor : graph.betweens()) {
        if (factor.to == factor.from + 1)
          smoother.add(factor);
        else
          right.push_back(gnc.add(factor));
      }
      for (int k = 0; k < 14; ++k) {
        const Key from = rng.uniform_index(30);
        const SE3d off = SE3d::exp(test::random_tangent<SE3d>(rng, 3.0, 0.5));
        wrong.push_back(gnc.add({from, from + 25, graph[from].inverse() * graph[from + 25] * off,
                                 NoiseModel<6>::from_sigma(0.02).sqrt_information()}));
      }
      const IncrementalGncReport report = gnc.update();
      CHECK(report.last.ok());
      CHECK(report.decided);
      steps += report.steps;
      for (const Index one : wrong) accepted += gnc.is_in(one) ? 1 : 0;
      for (const Index one : right) rejected += gnc.is_in(one) ? 0 : 1;
    }
    MESSAGE(steps, " updates, ", accepted, " wrong accepted, ", rejected, " right rejected");
    CHECK(accepted == 0);
    CHECK(rejected <= 2 * graphs * 29 / 100);  // one in a hundred exceeds the threshold
    CHECK(steps <= 17 * graphs);
  }

  TEST_CASE("as long as nothing agrees with them, wrong closures against trusted steps cost one more update each") {
    GncSmoother smoother(SmootherOptions{.patience = 0.0}, NoLag{});
    IncrementalGnc<GncSmoother> gnc(smoother);
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(0.05), Eigen::Vector3d::Constant(0.003);
    const auto noise = NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
    smoother.add_value(SE3d());
    smoother.add_prior(0, SE3d(), NoiseModel<6>::from_sigma(0.01));
    Index last = gnc.none;
    const SE3d step(SO3d::exp({0, 0, 0.16}), {5, 0, 0});
    for (Key key = 1; key < 60; ++key) {
      smoother.add_value(smoother[key - 1] * step);
      last = gnc.add({key - 1, key, step, noise},
                     {.threshold = 28, .price = 70, .outlier_weight = 1e-8, .trusted = true, .previous = last});
    }
    REQUIRE(gnc.update().last.ok());
    for (Key key = 0; key < 10; ++key) {
      const SE3d wrong = smoother[key].inverse() * smoother[key + 40] * SE3d(SO3d(), {3.0 * key, 8, 0});
      const Index one =
          gnc.add({key, key + 40, wrong, noise}, {.threshold = 40, .outlier_weight = 1e-8, .forecast = true});
      CHECK(gnc.update().steps == 2);
      CHECK_FALSE(gnc.is_in(one));
    }
  }

  TEST_CASE("a strong outlier whose residual does not show is found when all is decided again") {
    GncSmoother smoother(SmootherOptions{.patience = 0.0}, NoLag{});
    IncrementalGnc<GncSmoother> gnc(smoother, {.tried_rows = 0});  // not by the updates
    const auto noise = [](double metres, double radians) {
      Vector6d sigmas;
      sigmas << Eigen::Vector3d::Constant(metres), Eigen::Vector3d::Constant(radians);
      return NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
    };
    constexpr Key last = 20;
    for (Key key = 0; key <= last; ++key) {
      smoother.add_value(SE3d(SO3d(), {1.0 * key, 0, 0}));
      if (key > 0) smoother.add(BetweenFactor<SE3d>{key - 1, key, SE3d(SO3d(), {1, 0, 0}), noise(0.08, 0.001)});
    }
    smoother.add_prior(0, SE3d(), NoiseModel<6>::from_sigma(0.01));
    const OutlierTest test{.threshold = 40, .outlier_weight = 1e-8, .forecast = true};
    const Index wrong = gnc.add({0, last, SE3d(SO3d(), {1.0 * last, 2, 0}), noise(0.02, 0.002)}, test);
    REQUIRE(gnc.update().last.ok());
    std::vector<Index> right;
    for (Key from = 0; from < 10; ++from) {
      right.push_back(gnc.add({from, last, SE3d(SO3d(), {1.0 * (last - from), 0, 0}), noise(0.5, 0.01)}, test));
      REQUIRE(gnc.update().last.ok());
    }
    CHECK(gnc.is_in(wrong));
    REQUIRE(smoother.converge().ok());
    CHECK(gnc.factor(wrong).residual(smoother.values()).squaredNorm() < 10);
    CHECK(gnc.reconsider().steps > 0);
    CHECK_FALSE(gnc.is_in(wrong));
    for (const Index one : right) CHECK(gnc.is_in(one));
  }

  TEST_CASE("good steps that one wrong closure keeps out, with a part between them, come back together") {
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(0.1), Eigen::Vector3d::Constant(0.005);
    const auto noise = NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
    const OutlierTest closure{.threshold = 40, .outlier_weight = 1e-8, .forecast = true};
    const double off = 6;
    GncSmoother smoother(SmootherOptions{.patience = 0.0}, NoLag{});
    IncrementalGnc<GncSmoother> gnc(smoother);
    const auto place = [](Key key, double y) { return SE3d(SO3d(), {5.0 * key, y, 0}); };
    std::vector<Index> out;
    Index last = gnc.none;
    for (Key key = 0; key < 40; ++key) {
      smoother.add_value(place(key, key >= 20 && key < 24 ? off : 0));
      if (key == 0) continue;
      const bool in = key != 20 && key != 24;
      last = gnc.add(
          {key - 1, key, place(1, 0), noise},
          {.threshold = 28, .price = 70, .outlier_weight = 1e-8, .begins_in = in, .trusted = true, .previous = last});
      if (!in) out.push_back(last);
    }
    smoother.add_prior(0, SE3d(), NoiseModel<6>::from_sigma(0.01));
    std::vector<Index> right;
    for (const Key key : {10, 18, 26, 39}) right.push_back(gnc.add({0, key, place(key, 0), noise}, closure));
    const Index wrong = gnc.add({2, 22, place(20, off), noise}, closure);
    REQUIRE(gnc.admit());  // as if it had been believed before the steps were known
    REQUIRE(gnc.update().last.ok());
    REQUIRE(smoother.converge().ok());
    for (const Index one : out) CHECK_FALSE(gnc.is_in(one));
    CHECK(gnc.is_in(wrong));
    while (gnc.reconsider().steps > 0) REQUIRE(smoother.converge().ok());
    for (const Index one : out) CHECK(gnc.is_in(one));
    for (const Index one : right) CHECK(gnc.is_in(one));
    CHECK_FALSE(gnc.is_in(wrong));
    CHECK(std::abs(smoother[22].translation().y()) < 0.1);
  }

  TEST_CASE("a trusted step is out as soon as what speaks against it, within the graph and beyond, exceeds its price") {
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(0.05), Eigen::Vector3d::Constant(0.003);
    const auto noise = NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
    const SE3d step(SO3d(), {5, 0, 0});
    for (const double evidence : {0.0, 25.0, 35.0, 1000.0}) {
      CAPTURE(evidence);
      GncSmoother smoother(SmootherOptions{.patience = 0.0}, NoLag{});
      IncrementalGnc<GncSmoother> gnc(smoother);
      std::vector<Index> steps{gnc.none};
      for (Key key = 0; key < 10; ++key) {
        smoother.add_value(SE3d(SO3d(), {5.0 * key, 0, 0}));
        if (key > 0)
          steps.push_back(gnc.add(
              {key - 1, key, step, noise},
              {.threshold = 28, .price = 70, .outlier_weight = 1e-8, .trusted = true, .previous = steps.back()}));
      }
      smoother.add_prior(0, SE3d(), NoiseModel<6>::from_sigma(0.01));
      smoother.add_prior(9, SE3d(SO3d(), {47, 0, 0}), NoiseModel<6>::from_sigma(0.28));
      REQUIRE(gnc.update().last.ok());
      for (std::size_t k = 1; k < 10; ++k) CHECK(gnc.is_in(steps[k]));
      const double against = smoother.cost();
      REQUIRE(against > 37);
      REQUIRE(against < 43);
      gnc.lower_price(steps[5], evidence);
      REQUIRE(gnc.update().last.ok());
      CHECK(gnc.has_lower_price(steps[5]) == (evidence > 0));
      for (std::size_t k = 1; k < 10; ++k) CHECK(gnc.is_in(steps[k]) == (k != 5 || against + evidence < 70));
      gnc.lower_price(steps[5], -3.0);  // it was not so
      REQUIRE(gnc.update().last.ok());
      static_cast<void>(gnc.reconsider());
      for (std::size_t k = 1; k < 10; ++k) CHECK(gnc.is_in(steps[k]));
    }
  }

  TEST_CASE("an error that trusted steps share, so that none of them shows it, is found when all is decided again") {
    // Slips of 13 standard deviations, as odometry among traffic.
    SlippingDrive drive([](Key key) { return key >= 9 && key < 12 ? -0.3 : 1.0; });
    GncSmoother& smoother = drive.smoother;
    IncrementalGnc<GncSmoother>& gnc = drive.gnc;
    const std::vector<Index>& steps = drive.steps;
    for (const Key held : {2, 4, 16, 18}) gnc.add({0, held, at(held), sigma(0.02)}, {.threshold = 1e6});
    for (const Key weakly : {9, 10, 11, 12}) smoother.add(BetweenFactor<SE3d>{0, weakly, at(weakly), sigma(0.5)});
    CHECK(gnc.update().last.ok());
    const auto squared_error = [&] {
      double sum = 0;
      for (Key key = 0; key < end; ++key) sum += (smoother[key].translation() - at(key).translation()).squaredNorm();
      return sum;
    };
    const double before = smoother.cost(), shared = squared_error();
    for (const Index step : steps) CHECK(gnc.is_in(step));  // each errs by three standard deviations
    CHECK(gnc.reconsider().last.ok());
    Index out = 0;
    for (std::size_t i = 0; i < steps.size(); ++i) {
      if (gnc.is_in(steps[i])) continue;
      ++out;
      CHECK(i >= 8);
      CHECK(i <= 12);
    }
    CHECK(out >= 1);
    CHECK(smoother.cost() + 70 + 7.0 * (out - 1) < before);
    CHECK(squared_error() < 0.5 * shared);
  }

  TEST_CASE("where nothing says which steps failed between two that are held, all of them share the error") {
    SlippingDrive drive([](Key key) { return key >= 4 && key < 16 ? 0.5 : 1.0; });  // by as much everywhere
    GncSmoother& smoother = drive.smoother;
    IncrementalGnc<GncSmoother>& gnc = drive.gnc;
    const std::vector<Index>& steps = drive.steps;
    const OutlierTest closure{.threshold = 40, .outlier_weight = 1e-8};
    for (const Key held : {2, 3, 4, 16, 17, 18}) gnc.add({0, held, at(held), sigma(0.02)}, closure);
    CHECK(gnc.update().last.ok());
    CHECK(gnc.reconsider().last.ok());
    const auto largest = [&] {
      double most = 0;
      for (Key key = 0; key < end; ++key)
        most = std::max(most, (smoother[key].translation() - at(key).translation()).norm());
      return most;
    };
    CHECK(largest() > 2);  // one step has all of it
    CHECK(gnc.share_errors());
    CHECK(smoother.converge().ok());
    CHECK(largest() < 0.1);
    CHECK(gnc.is_in(steps[3]));
    CHECK(gnc.is_in(steps[16]));
    CHECK_FALSE(gnc.share_errors());
  }

  TEST_CASE("behind a step that failed, one closure alone is not believed; a second that agrees lets both in") {
    for (const bool failed : {false, true}) {
      CAPTURE(failed);
      GncSmoother smoother(SmootherOptions{.patience = 0.0}, NoLag{});
      IncrementalGnc<GncSmoother> gnc(smoother);
      Vector6d sigmas;
      sigmas << Eigen::Vector3d::Constant(0.05), Eigen::Vector3d::Constant(0.003);
      const auto noise = NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
      smoother.add_value(SE3d());
      smoother.add_prior(0, SE3d(), NoiseModel<6>::from_sigma(0.01));
      Index last = gnc.none;
      const SE3d step(SO3d(), {5, 0, 0}), off(SO3d(), failed ? Eigen::Vector3d(6, 3, 0) : Eigen::Vector3d(0, 0, 0));
      for (Key key = 1; key < 60; ++key) {
        smoother.add_value(smoother[key - 1] * step);
        const SE3d there = SE3d(SO3d(), {5.0 * key, 0, 0}) * (key < 40 ? SE3d() : off);
        gnc.add(PriorFactor<SE3d>{key, there, NoiseModel<6>::from_sigma(2).sqrt_information()});
        last = gnc.add({key - 1, key, step, noise}, {.threshold = 28,
                                                     .price = 70,
                                                     .outlier_weight = 1e-8,
                                                     .begins_in = !(failed && key == 40),
                                                     .trusted = true,
                                                     .previous = last});
      }
      REQUIRE(gnc.update().last.ok());
      // Priors of 2 m know roughly how far the step was off.
      const SE3d seen = failed ? off * SE3d(SO3d(), {1, -1, 0}) : off;
      const auto close = [&](Key from, Key to) {
        const Index one = gnc.add({from, to, SE3d(SO3d(), {5.0 * (to - from), 0, 0}) * seen, noise},
                                  {.threshold = 40, .outlier_weight = 1e-8, .forecast = true});
        REQUIRE(gnc.update().last.ok());
        return one;
      };
      const Index first = close(30, 45);
      CHECK(gnc.is_in(first) == !failed);
      const Index second = close(32, 47);
      CHECK(gnc.is_in(second));
      CHECK(gnc.is_in(first));
    }
  }
}
