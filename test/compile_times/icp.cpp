// ICP of two clouds of a type of one's own.
#include <chainslam/registration/align.hpp>
#include <vector>

struct Return {
  float x, y, z, intensity;
};
struct Sweep {
  std::vector<Return> returns;
};

template <>
struct chainslam::CloudTraits<Sweep> {
  static std::size_t size(const Sweep& sweep) { return sweep.returns.size(); }
  static Eigen::Vector3f position(const Sweep& sweep, std::size_t i) {
    return {sweep.returns[i].x, sweep.returns[i].y, sweep.returns[i].z};
  }
};

int main() {
  const Sweep source, target;
  const auto result = chainslam::align(source, target, chainslam::SE3d());
  return result.converged() ? 0 : 1;
}
