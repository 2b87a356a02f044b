#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/factor_graph/detail/linearization.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "factor_graph/smoother_twin.hpp"
#include "support/property.hpp"
#include "support/street_walk.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using Factors = std::vector<BetweenFactor<SE3d>>;

auto at(const Factors& factors) {
  return [&factors](Index k) -> const BetweenFactor<SE3d>& { return factors[static_cast<std::size_t>(k)]; };
}

/// The bound by the whole covariance of both poses.
double bound_by_covariance(const Smoother& smoother, const BetweenFactor<SE3d>& factor) {
  const std::vector<Key> keys{factor.from, factor.to};
  const Eigen::MatrixXd covariance = smoother.covariance(keys);
  const std::vector<double> numbers = detail::linearization(factor, smoother.values(), detail::Kernels::applied);
  const Eigen::Map<const Eigen::Matrix<double, 6, 12, Eigen::RowMajor>> J(numbers.data());
  const Eigen::Matrix<double, 6, 6> H = J * covariance * J.transpose();
  return eigenvalue_bound(H.data(), 6);
}

}  // namespace

TEST_SUITE("factor_graph/incremental_smoother_leverages") {
  TEST_CASE("what the graph says of a factor anyway is what the covariance of its poses says") {
    for_all(20, [](Rng& rng, int size) {
      Twin twin;
      Walk walk(rng);
      for (int k = 0; k < 5 + size; ++k) walk.step(twin);
      const Smoother& smoother = twin.smoother;
      const Key last = smoother.size() - 1;
      const auto between = [&](Key from, Key to) {
        BetweenFactor<SE3d> factor{from, to, smoother[from].inverse() * smoother[to], {}};
        factor.measurement = factor.measurement * SE3d::exp(random_tangent<SE3d>(rng, 0.003, 0.003));
        factor.sqrt_information = Smoother::Noise::from_sigma(0.02).sqrt_information();
        return factor;
      };
      const Factors in{between(0, last), between(1, last), between(last, 2)};
      for (const auto& factor : in) twin.smoother.add(factor);
      REQUIRE(twin.smoother.converge().ok());
      const auto bounds = Smoother::Leverages(smoother).bounds(to_index(in.size()), at(in));
      double sum = 0, squares = 0;
      for (std::size_t k = 0; k < in.size(); ++k) {
        CHECK(bounds[static_cast<Index>(k)] == doctest::Approx(bound_by_covariance(smoother, in[k])).epsilon(1e-6));
        sum += bounds[static_cast<Index>(k)];
        squares += in[k].residual(smoother.values()).squaredNorm();
      }
      CHECK(smoother.rise_with(std::span(in)).change * (1 + sum) >= squares * (1 - 1e-9));
      if (sum < 1) CHECK(smoother.fall_without(std::span(in)).change * (1 - sum) <= squares * (1 + 1e-9));

      const Factors all_pairs = [&] {
        Factors factors;
        for (Key to = 1; to <= last; ++to)
          for (Key from = 0; from < to; ++from) factors.push_back(between(from, to));
        return factors;
      }();
      const auto any = Smoother::Leverages(smoother).bounds(to_index(all_pairs.size()), at(all_pairs));
      Index unknown = 0;
      for (std::size_t k = 0; k < all_pairs.size(); ++k) {
        const double bound = any[static_cast<Index>(k)];
        if (std::isinf(bound))
          ++unknown;
        else
          CHECK(bound == doctest::Approx(bound_by_covariance(smoother, all_pairs[k])).epsilon(1e-6));
      }
      if (size > 10) CHECK(unknown > 0);
    });
  }
}
