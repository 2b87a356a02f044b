#include <doctest/doctest.h>

#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/factor_graph/incremental_gnc.hpp"
#include "support/threads_cases.hpp"

namespace chainslam {
namespace {

/// Drives of 20 m, each with a strong wrong closure that came first: ten weaker right ones do not show that it is
/// wrong, but the graph without it does. All is decided again by an executor.
struct MisledDrives {
  using Smoother = IncrementalSmoother<SE3d>;
  static constexpr Index drives = 5;
  Smoother smoother{SmootherOptions{.patience = 0.0}, NoLag{}};
  IncrementalGnc<Smoother> gnc{smoother, {.tried_rows = 0}};  // not by the updates
  std::vector<bool> in;
  Index steps = 0;

  [[nodiscard]] static SqrtInformation<6> noise(double metres, double radians) {
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(metres), Eigen::Vector3d::Constant(radians);
    return NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
  }

  template <Executor E>
  explicit MisledDrives(const E& executor) {
    constexpr Key last = 20;
    constexpr OutlierTest test{.threshold = 40, .outlier_weight = 1e-8, .forecast = true};
    std::vector<Index> closures;
    for (Index drive = 0; drive < drives; ++drive) {
      const Key first = smoother.size();
      for (Key key = 0; key <= last; ++key) {
        smoother.add_value(SE3d(SO3d(), {1.0 * key, 0, 0}));
        if (key > 0)
          smoother.add(BetweenFactor<SE3d>{first + key - 1, first + key, SE3d(SO3d(), {1, 0, 0}), noise(0.08, 0.001)});
      }
      smoother.add_prior(first, SE3d(), NoiseModel<6>::from_sigma(0.01));
      closures.push_back(gnc.add({first, first + last, SE3d(SO3d(), {1.0 * last, 2, 0}), noise(0.02, 0.002)}, test));
      REQUIRE(gnc.update().last.ok());
      for (Key from = 0; from < 10; ++from) {
        const SE3d measured(SO3d(), {1.0 * (last - from), 0, 0});
        closures.push_back(gnc.add({first + from, first + last, measured, noise(0.5, 0.01)}, test));
        REQUIRE(gnc.update().last.ok());
      }
    }
    REQUIRE(smoother.converge().ok());
    steps = gnc.reconsider(executor).steps;
    for (const Index one : closures) in.push_back(gnc.is_in(one));
  }
};

}  // namespace

TEST_SUITE("factor_graph/incremental_gnc") {
  THREADS_TEST_CASE("factor_graph/incremental_gnc", "forecasts on several threads decide as one after the other") {
    const MisledDrives alone(Serial{}), together(ThreadPool(3));
    for (std::size_t k = 0; k < alone.in.size(); ++k) CHECK(alone.in[k] == (k % 11 != 0));
    CHECK(alone.steps >= MisledDrives::drives);
    CHECK(together.in == alone.in);
    CHECK(together.steps == alone.steps);
    CHECK(together.smoother.values() == alone.smoother.values());
  }
}

}  // namespace chainslam
