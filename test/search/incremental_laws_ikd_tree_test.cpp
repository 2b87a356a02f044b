#include "chainslam/search/ikd_tree.hpp"
#include "search/incremental_laws.hpp"

namespace chainslam {
namespace {

using test::check_incremental_laws;
using test::check_thinning_laws;

TEST_SUITE("search/incremental_laws") {
  TEST_CASE("IkdTree keeps the laws") {
    check_incremental_laws([] { return IkdTree<float>(); });
  }

  TEST_CASE("IkdTree keeps the laws while it thins") {
    check_thinning_laws<IkdTree<float, NearestToCenter>, NearestToCenter>({.voxel_size = 0.5});
    check_thinning_laws<IkdTree<double, MeanOfVoxel>, MeanOfVoxel>({.voxel_size = 0.3});
    check_thinning_laws<IkdTree<float, AtMost, 2>, AtMost>({.voxel_size = 0.7, .count = 3});
  }
}

}  // namespace
}  // namespace chainslam
