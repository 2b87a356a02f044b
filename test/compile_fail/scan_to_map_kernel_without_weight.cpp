// expect: ScanToMap: Kernel needs `double weight(double squared_residual) const`
// expect: see chainslam/core/robust_kernels.hpp
// A robust kernel whose function has another name.
#include "chainslam/odometry/scan_to_map.hpp"

struct MyKernel {
#ifdef CHAINSLAM_RIGHT
  double weight(double squared_residual) const { return 1 / (1 + squared_residual); }
#else
  double rho(double squared_residual) const { return 1 / (1 + squared_residual); }
#endif
};

chainslam::ScanToMap<MyKernel> registration;
