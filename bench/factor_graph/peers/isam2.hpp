#pragma once

#include <memory>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam::bench {

/// GTSAM's iSAM2, without GTSAM's headers, with the names of `IncrementalSmoother`: for Pose SE3d and SE2d.
template <class Pose>
class Isam2 {
 public:
  using Noise = NoiseModel<Pose::dof>;

  /// @param relinearize_threshold  of each coordinate, looked at in each update.
  explicit Isam2(double relinearize_threshold);
  ~Isam2();

  [[nodiscard]] Index size() const;
  [[nodiscard]] Pose operator[](Key key) const;  ///< solves for it, as far as that was put off
  void add_value(const Pose& guess);
  void add_prior(Key key, const Pose& pose, const Noise& noise);
  void add_between(Key from, Key to, const Pose& motion, const Noise& noise);
  void update();
  [[nodiscard]] Index read_all() const;  ///< makes a copy of all estimates; their number
  [[nodiscard]] double cost() const;     ///< chi squared

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace chainslam::bench
