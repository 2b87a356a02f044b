// expect: Product: all parts need the same Scalar
#include "chainslam/lie/product.hpp"
#include "chainslam/lie/se3.hpp"

#ifdef CHAINSLAM_RIGHT
using Second = chainslam::SO3d;
#else
using Second = chainslam::SO3f;
#endif

int main() { (void)sizeof(chainslam::Product<chainslam::SE3d, Second>); }
