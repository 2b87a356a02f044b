#include <doctest/doctest.h>

#include "lamm.hpp"

namespace chainslam::lamm {

// The sources: hku-mars/LAMM, config_velo_nclt.yaml for what describes and recognizes places, rgb_multi_mapping.launch
// and rgb_multi_mapping.cpp for what is made of them.
TEST_SUITE("lamm/options") {
  TEST_CASE("places are described and recognized as LAMM's configuration for NCLT says") {
    const Options options;
    CHECK(options.clouds.voxel_size == 0.25);
    CHECK(options.clouds.max_scans == 10);
    CHECK(options.place.planes.voxel_size == 2);
    CHECK(options.place.planes.more_than_points == 10);
    CHECK(options.place.planes.max_variance == 0.01);
    CHECK(options.place.planes.merge_normal == 0.1);
    CHECK(options.place.planes.merge_distance == 0.3);
    CHECK(options.place.keypoints.cell_size == 0.5);
    CHECK(options.place.keypoints.bin_height == 0.1);
    CHECK(options.place.keypoints.max_height == 5);
    CHECK(options.place.keypoints.block == 5);
    CHECK(options.place.keypoints.min_occupied == 10);
    CHECK(options.place.keypoints.suppression_radius == 1);
    CHECK(options.place.keypoints.max_count == 500);
    CHECK(options.place.triangles.nearest == 15);
    CHECK(options.place.triangles.min_side == 1);
    CHECK(options.place.triangles.max_side == 30);
    CHECK(options.place.triangles.min_excess == 0.2);
    CHECK(options.table.side_resolution == 0.2);
    CHECK(options.table.max_side_difference == 0.01);
    CHECK(options.table.min_similarity == 0.7);
    CHECK(options.table.min_votes == 4);
    CHECK(options.table.max_candidates == 50);
    CHECK(options.verification.max_hypotheses == 50);
    CHECK(options.verification.corner_distance == 3);
    CHECK(options.verification.min_agreeing == 4);
    CHECK(options.verification.normal_difference == 0.2);
    CHECK(options.verification.plane_distance == 0.5);
    CHECK(options.verification.min_overlap == 0.6);
  }

  TEST_CASE("loops are filtered and optimized as LAMM's launch file says") {
    const Options options;
    CHECK(options.frames_per_number == 10);
    CHECK(options.search.min_gap == 50);
    CHECK(options.search.min_gap_any == 0);
    CHECK(options.filter.max_path_difference == 1.5);
    CHECK(options.filter.subset == 0.5);
    CHECK(options.filter.max_draws == 100'000);
    CHECK(options.filter.min_spread == 1);
    CHECK(options.filter.few == 4);
    CHECK(options.filter.few_radius == 15);
    CHECK(options.graph.odometry_variance == 1e-6);
    CHECK(options.graph.loop_variance == 0.1);
    CHECK(options.graph.loop_kernel == 1);
    CHECK(options.graph.prior_variance == 1e-12);
    CHECK(options.graph.frames_a_loop == 0);
    CHECK(options.graph.placed);
    CHECK(options.graph.own_start);
    CHECK(options.graph.damped);
  }

  TEST_CASE("what the released program does otherwise") {
    const Options options = as_released();
    CHECK(options.search.min_gap_any == 101);
    CHECK(!options.search.turned_start);
    CHECK(options.verification.min_overlap == 0.3);
    CHECK(options.filter.few_radius == 0);
    CHECK(options.graph.frames_a_loop == 10);
    CHECK(!options.graph.placed);
    CHECK(!options.graph.own_start);
    CHECK(options.graph.max_iterations == 11);
    CHECK(!options.graph.damped);
  }
}

}  // namespace chainslam::lamm
