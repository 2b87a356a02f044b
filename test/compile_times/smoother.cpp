// A pose graph that grows.
#include <chainslam/factor_graph/incremental_smoother.hpp>

int main() {
  using namespace chainslam;
  IncrementalSmoother<SE3d> smoother;
  const auto noise = NoiseModel<6>::from_sigma(0.1);
  smoother.add_value(SE3d());
  smoother.add_value(SE3d());
  smoother.add_prior(0, SE3d(), noise);
  smoother.add_between(0, 1, SE3d(), noise);
  return smoother.update().ok() ? 0 : 1;
}
