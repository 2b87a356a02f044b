#include "search/search_laws.hpp"

#include "chainslam/search/indexed_cloud.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "chainslam/search/nanoflann_tree.hpp"
#include "chainslam/search/voxel_map.hpp"

namespace chainslam {
namespace {

using test::check_search_laws;
using test::Points;

TEST_SUITE("search/laws") {
  TEST_CASE_TEMPLATE("KdTree agrees with brute force", Scalar, float, double) {
    check_search_laws<Scalar>([](const Points<Scalar>& points) { return KdTree<Scalar>(points); });
  }

  TEST_CASE_TEMPLATE("VoxelMap agrees with brute force within its radius", Scalar, float, double) {
    for (const double voxel_size : {0.25, 1.0, 7.3}) {
      const VoxelMapOptions options{
          .voxel_size = voxel_size, .max_points_per_voxel = 1'000'000, .min_spacing = 0, .reach = 2};
      check_search_laws<Scalar>([&](const Points<Scalar>& points) { return VoxelMap<Scalar>(points, options); },
                                VoxelMap<Scalar>(options).max_search_radius());
    }
  }

  TEST_CASE("NanoflannTree agrees with brute force") {
    check_search_laws<float>([](const Points<float>& points) { return NanoflannTree<float>(points); });
  }
}

}  // namespace
}  // namespace chainslam
