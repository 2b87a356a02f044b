#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "chainslam/factor_graph/constrained_factor.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "factor_graph/pose_graphs.hpp"

namespace chainslam::test {

using Closure = BetweenFactor<SE3d, Cauchy>;
using Pin = Constrained<PriorFactor<SE3d>>;
using Weld = Constrained<BetweenFactor<SE3d>>;
// All tests have these: one graph and one smoother are compiled.
using Graph = FactorGraph<SE3d, Closure, Pin, Weld>;
using Smoother = IncrementalSmoother<SE3d, Closure, Pin, Weld>;

/// All is exact: every factor is linearized anew in each update, and every solution computed.
inline constexpr SmootherOptions exact{.linear_tolerance = 0.0, .nonlinear_tolerance = 0.0, .first_look = 0.0};

inline double largest_difference(const Values<SE3d>& a, const Values<SE3d>& b) {
  double largest = 0.0;
  for (Key key = 0; key < a.size(); ++key) largest = std::max(largest, a[key].local(b[key]).norm());
  return largest;
}

/// A smoother and, beside it, the plain list of what it should hold.
struct Twin {
  explicit Twin(const SmootherOptions& options = {}) : smoother(options) {}

  Smoother smoother;
  std::vector<PriorFactor<SE3d>> priors;
  std::vector<BetweenFactor<SE3d>> betweens;
  std::vector<std::pair<FactorId, Closure>> closures;
  std::vector<char> fixed;

  void add_value(const SE3d& value) {
    smoother.add_value(value);
    fixed.push_back(0);
  }
  void add(const PriorFactor<SE3d>& factor) {
    smoother.add(factor);
    priors.push_back(factor);
  }
  void add(const BetweenFactor<SE3d>& factor) {
    smoother.add(factor);
    betweens.push_back(factor);
  }
  void add(const Closure& factor) { closures.emplace_back(smoother.add(factor), factor); }
  void remove(std::size_t k) {
    smoother.remove(closures[k].first);
    closures.erase(closures.begin() + static_cast<std::ptrdiff_t>(k));
  }

  /// The same graph for the batch optimizer, from the smoother's estimate.
  [[nodiscard]] Graph graph(const Values<SE3d>& values) const {
    Graph result;
    for (const SE3d& value : values) result.add_value(value);
    for (const auto& factor : priors) result.add(factor);
    for (const auto& factor : betweens) result.add(factor);
    for (const auto& [id, factor] : closures) result.add(factor);
    for (std::size_t k = 0; k < fixed.size(); ++k) result.set_fixed(static_cast<Key>(k), fixed[k] != 0);
    return result;
  }
};

/// A random walk, with closures that come and go.
class Walk {
 public:
  explicit Walk(Rng& rng) : rng_(rng) {}

  void step(Twin& twin) {
    const auto noise = Smoother::Noise::from_sigma(0.02).sqrt_information();
    const Key key = twin.smoother.size();
    if (key == 0) {
      truth_.push_back(random_pose<SE3d>(rng_));
      twin.add_value(truth_.back());
      twin.add(PriorFactor<SE3d>{0, truth_.back(), Smoother::Noise::from_sigma(1e-2).sqrt_information()});
      return;
    }
    truth_.push_back(truth_.back() * SE3d::exp(random_tangent<SE3d>(rng_, 1.0, 0.3)));
    const SE3d step = measure(key - 1, key);
    twin.add_value(twin.smoother[key - 1] * step);
    twin.add(BetweenFactor<SE3d>{key - 1, key, step, noise});
    if (key > 2 && rng_.uniform_index(2) == 0) {
      const Key other = rng_.uniform_index(key - 1);
      twin.add(Closure{other, key, measure(other, key), noise, Cauchy{.width = 3.0}});
    }
  }
  void remove_one(Twin& twin) {
    if (!twin.closures.empty())
      twin.remove(static_cast<std::size_t>(rng_.uniform_index(to_index(twin.closures.size()))));
  }
  void fix_one(Twin& twin) {
    const Key key = rng_.uniform_index(twin.smoother.size());
    char& fixed = twin.fixed[static_cast<std::size_t>(key)];
    fixed = fixed == 0 ? 1 : 0;
    twin.smoother.set_fixed(key, fixed != 0);
  }

 private:
  [[nodiscard]] SE3d measure(Key from, Key to) {
    const auto at = [&](Key key) -> const SE3d& { return truth_[static_cast<std::size_t>(key)]; };
    return at(from).inverse() * at(to) * SE3d::exp(random_tangent<SE3d>(rng_, 0.02, 0.02));
  }

  Rng& rng_;
  std::vector<SE3d> truth_;
};

}  // namespace chainslam::test
