#pragma once

#include <limits>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/filter/ieskf.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/scan_measurement.hpp"
#include "chainslam/odometry/scan_to_map.hpp"

namespace chainslam {

/// The parts of an inertial filter that decide whether it is FAST-LIO2's.
struct FastLio2Rules {
  ImuProcess process;              ///< propagation
  ScanToMap<Trivial> scan_to_map;  ///< registration
  ScanMeasurementOptions scan;     ///< linearization
  IterationRule iteration;         ///< convergence
  double variance;                 ///< of a residual, m^2
};

/// FAST-LIO2 (Xu et al. 2022, arXiv 2107.06829) with its published code's numbers where the paper gives none: Euler
/// steps, planes by a . p = -1, every residual within the gate counts alike, neighbours are looked up again once the
/// iteration has come to rest, at most five passes; no direction is ever held.
[[nodiscard]] inline FastLio2Rules fast_lio2() {
  constexpr double never = std::numeric_limits<double>::infinity();
  return {.process = {.noise = {.gyro = 2e-3, .accel_bias_walk = 5e-4}, .integration = ImuIntegration::euler},
          .scan_to_map = {.max_matchings = 5, .min_matches = 1, .rematch_distance = never, .min_signal = -never},
          .scan = {.planes = PlaneForm::intercept, .fresh_distance = 0, .coarse_to_fine = false, .mean_time = false},
          .iteration = {.max_iterations = 5, .step_tolerance = 1e-3},
          .variance = 1e-3};
}

}  // namespace chainslam
