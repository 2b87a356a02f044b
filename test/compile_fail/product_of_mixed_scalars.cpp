// expect: Product: all parts need the same Scalar
#include "chainslam/lie/product.hpp"
#include "chainslam/lie/se3.hpp"

int main() { (void)sizeof(chainslam::Product<chainslam::SE3d, chainslam::SO3f>); }
