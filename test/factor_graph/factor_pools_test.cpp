#include "chainslam/factor_graph/detail/factor_pools.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cstddef>
#include <utility>
#include <vector>

#include "chainslam/lie/se2.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

TEST_SUITE("factor_graph/factor_pools") {
  TEST_CASE("factors of few noises and of one each come back as they were put in, whatever comes and goes") {
    using Between = BetweenFactor<SE2d>;
    for_all(10, [](Rng& rng, int) {
      detail::FactorPool<Between> pool;
      std::vector<std::pair<Index, Between>> there;
      for (int k = 0; k < 500; ++k) {
        if (there.empty() || rng.uniform_index(5) < 3) {
          Between factor{k, k + 1, SE2d(SO2d::from_angle(rng.uniform()), Eigen::Vector2d(rng.uniform(), 1.0))};
          const Index kind = rng.uniform_index(4);
          factor.sqrt_information *= kind == 0 ? 1.0 + rng.uniform() : static_cast<double>(kind);
          there.emplace_back(pool.add(factor, k), factor);
        } else {
          const auto gone = static_cast<std::size_t>(rng.uniform_index(to_index(there.size())));
          pool.set_alive(there[gone].first, false);
          pool.release(there[gone].first);
          there[gone] = there.back();
          there.pop_back();
        }
      }
      CHECK(pool.alive() == to_index(there.size()));
      for (const auto& [slot, factor] : there) {
        const auto entry = pool.at(slot);
        CHECK(entry.alive);
        CHECK(entry.factor.keys() == factor.keys());
        CHECK(entry.factor.measurement.translation() == factor.measurement.translation());
        CHECK(entry.factor.sqrt_information == factor.sqrt_information);
      }
    });
  }

  TEST_CASE("a matrix that many have is kept once, and no longer than they") {
    using Matrix = Eigen::Matrix2d;
    detail::SharedMatrices<Matrix> shared;
    std::vector<Index> numbers;
    for (int k = 0; k < 90; ++k) numbers.push_back(shared.add(Matrix::Identity() * (k % 3)));
    CHECK(shared.size() == 3);
    for (const Index number : numbers) shared.remove(number);
    for (int k = 0; k < 3; ++k) CHECK(shared[shared.add(Matrix::Constant(k))] == Matrix::Constant(k));
    CHECK(shared.size() == 3);
    for (int k = 0; k < 100; ++k) shared.remove(shared.add(Matrix::Constant(0.5 * k)));
    CHECK(shared.size() == 4);
  }
}
