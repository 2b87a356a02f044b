// All headers, and next to nothing of them used.
#include <chainslam/chainslam.hpp>

int main() { return chainslam::SE3d().translation().norm() > 0 ? 1 : 0; }
