// expect: Icp: Kernel needs `double weight(double squared_residual) const`, as in Huber
// expect: see chainslam/core/robust_kernels.hpp
#include "chainslam/registration/icp.hpp"

struct Kernel {
#ifdef CHAINSLAM_RIGHT
  double weight(double squared_residual) const { return squared_residual < 1 ? 1.0 : 0.0; }
#endif
};

int main() { (void)sizeof(chainslam::Icp<chainslam::PointToPlane, Kernel>); }
