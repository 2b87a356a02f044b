#include <cstdio>

#include "chainslam/core/version.hpp"

int main() {
  std::printf("chainslam %d.%d.%d\n", CHAINSLAM_VERSION_MAJOR, CHAINSLAM_VERSION_MINOR, CHAINSLAM_VERSION_PATCH);
  return 0;
}
