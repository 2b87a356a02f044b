// What all others are compared with: Eigen alone, and one product.
#include <Eigen/Core>
#include <Eigen/Geometry>

int main(int argc, char**) {
  const Eigen::Matrix3d a = Eigen::Matrix3d::Constant(argc);
  const Eigen::Matrix3d b = a * a;
  return static_cast<int>(b(0, 0));
}
