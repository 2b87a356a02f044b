#include "search/incremental_laws.hpp"

namespace chainslam {
namespace {

using test::check_incremental_laws;

TEST_SUITE("search/incremental_laws") {
  TEST_CASE("BruteForce keeps the laws that it stands for") {
    check_incremental_laws([] { return BruteForce<double, 2>(); });
  }
}

}  // namespace
}  // namespace chainslam
