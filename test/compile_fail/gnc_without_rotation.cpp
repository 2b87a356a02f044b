// expect: GncTls: Rotation needs `std::optional<SO3d> rotation(S) const` and `least_points`, as in AnyRotation
#include "chainslam/registration/gnc.hpp"

struct Rotation {
#ifdef CHAINSLAM_RIGHT
  std::optional<chainslam::SO3d> rotation(const Eigen::Matrix3d&) const { return chainslam::SO3d(); }
#endif
  static constexpr chainslam::Index least_points = 1;
};

int main() { (void)sizeof(chainslam::GncTls<Rotation>); }
