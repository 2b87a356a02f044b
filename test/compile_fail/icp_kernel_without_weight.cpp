// expect: Icp: Kernel needs `double weight(double squared_residual) const`, as in Huber
#include "chainslam/registration/icp.hpp"

struct NoKernel {};

int main() { (void)sizeof(chainslam::Icp<chainslam::PointToPlane, NoKernel>); }
