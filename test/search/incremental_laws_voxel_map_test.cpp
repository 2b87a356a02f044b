#include "chainslam/search/voxel_map.hpp"
#include "search/incremental_laws.hpp"

namespace chainslam {
namespace {

using test::check_incremental_laws;
using test::check_thinning_laws;

TEST_SUITE("search/incremental_laws") {
  TEST_CASE("VoxelMap of many points a voxel keeps the laws within its radius") {
    check_incremental_laws([] {
      return VoxelMap<float>({.voxel_size = 0.7, .max_points_per_voxel = 1'000'000, .min_spacing = 0, .reach = 2});
    });
  }

  TEST_CASE("VoxelMap of one point a voxel keeps the laws") {
    check_thinning_laws<VoxelMap<float, NearestToCenter>, NearestToCenter>({.voxel_size = 0.5});
    check_thinning_laws<VoxelMap<double, FirstInVoxel>, FirstInVoxel>({.voxel_size = 0.3});
    check_thinning_laws<VoxelMap<float, MeanOfVoxel, 2>, MeanOfVoxel>({.voxel_size = 0.2});
  }

  TEST_CASE("VoxelMap of a few points a voxel keeps the laws within its radius") {
    check_thinning_laws<VoxelMap<float, AtMost>, AtMost>({.voxel_size = 1.3, .count = 3});
  }
}

}  // namespace
}  // namespace chainslam
