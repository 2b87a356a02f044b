// expect: Icp: Rejector needs `static constexpr bool needs_normals` and `void operator()(pairs) const`, as in OneToOne
// expect: see chainslam/registration/rejectors.hpp
#include "chainslam/registration/icp.hpp"

struct Rejector {
  static constexpr bool needs_normals = false;
#ifdef CHAINSLAM_RIGHT
  void operator()(chainslam::RejectablePairs auto& pairs) const {
    if (pairs.size() > 0) pairs.reject(0);
  }
#endif
};

int main() { (void)sizeof(chainslam::Icp<chainslam::PointToPlane, chainslam::Trivial, Rejector>); }
