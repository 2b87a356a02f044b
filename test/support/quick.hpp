#pragma once

#include <cstdlib>

namespace chainslam::test {

/// Long runs stay with the fast build: test/run.sh sets CHAINSLAM_QUICK under sanitizers and for --quick.
inline bool quick() { return std::getenv("CHAINSLAM_QUICK") != nullptr; }

/// The longest runs are for test/run.sh --full, which sets CHAINSLAM_FULL.
inline bool full() { return std::getenv("CHAINSLAM_FULL") != nullptr; }

}  // namespace chainslam::test
