#pragma once

#include <span>
#include <type_traits>
#include <utility>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/map/slam_map.hpp"

namespace chainslam {

/// A map's factors where closures have a robust kernel, in standard deviations, and odometry is never doubted.
template <class Kernel>
class KernelFactors {
 public:
  using ClosureFactor = BetweenFactor<SE3d, Kernel>;  ///< the factor of a closure
  /// The smoother behind.
  using Smoother = std::conditional_t<std::is_same_v<Kernel, Trivial>, IncrementalSmoother<SE3d>,
                                      IncrementalSmoother<SE3d, ClosureFactor>>;

  /// An empty graph.
  template <class Options>
  [[gnu::cold]] KernelFactors(const Options& options, Kernel kernel)
      : smoother_(options.smoother, NoLag{}), kernel_(std::move(kernel)) {}

  [[nodiscard]] Smoother& smoother() { return smoother_; }              ///< the smoother behind
  [[nodiscard]] const Smoother& smoother() const { return smoother_; }  ///< the smoother behind

  /// Adds a factor.
  void add(const OdometryMeasurement& step) {
    smoother_.add(BetweenFactor<SE3d>{step.from.value, step.to.value, step.T_from_to, step.sqrt_information});
  }
  /// Adds the closure at a position among the map's.
  [[gnu::cold]] void add_closure(const SlamMap& map, Index position) {
    const LoopClosure& closure = map.closures[static_cast<std::size_t>(position)];
    if (!closure.is_factor()) return;
    smoother_.add(
        ClosureFactor{closure.from.value, closure.to.value, closure.T_from_to, closure.sqrt_information, kernel_});
  }

  /// Fixes do not hold a map with kernels.
  void wait(const Keyframe& /*keyframe*/) {}
  void wait_for_fix(const Keyframe& /*keyframe*/) {}  ///< nothing
  void carry(std::span<const Key> /*keyframes*/) {}   ///< nothing: keyframes are carried by the smoother alone
  [[nodiscard]] Index waiting() const { return 0; }   ///< always 0

  /// Nothing waits.
  [[nodiscard]] bool admit() { return false; }

  /// Takes in what was added and makes the estimate better.
  [[nodiscard]] UpdateReport update(const SlamMap& /*map*/) { return smoother_.update(); }
  /// Keys whose estimate the last update changed.
  [[nodiscard]] std::span<const Key> changed() const { return smoother_.changed(); }
  /// Goes on to a local optimum.
  template <class Options>
  [[nodiscard]] [[gnu::cold]] ConvergeReport converge(const Options& options, SlamMap& /*map*/) {
    return smoother_.converge(options);
  }
  void record(SlamMap& /*map*/) const {}  ///< nothing: kernels keep no record of outliers

 private:
  Smoother smoother_;
  [[no_unique_address]] Kernel kernel_;
};

}  // namespace chainslam
