#include "search/incremental_laws.hpp"

namespace chainslam {
namespace {

using test::check_incremental_laws;

TEST_SUITE("search/incremental_laws") {
  TEST_CASE_TEMPLATE("BruteForce keeps the laws that it stands for", Map, BruteForce<float>, BruteForce<double, 2>) {
    check_incremental_laws([] { return Map(); });
  }
}

}  // namespace
}  // namespace chainslam
