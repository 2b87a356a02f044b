// expect: Product: all parts need the same Scalar
#include "chainslam/lie/product.hpp"
#include "chainslam/lie/se3.hpp"

#ifdef CHAINSLAM_RIGHT
using Bias = chainslam::SO3d;
#else
using Bias = chainslam::SO3f;
#endif

int main() { (void)sizeof(chainslam::Product<chainslam::SE3d, Bias>); }
