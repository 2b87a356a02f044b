#pragma once

#include "registration/peers/peer_pose.hpp"

namespace chainslam::bench {

/// A cloud described by KISS-Matcher (Lim et al. 2024): the points that got a descriptor, and 33 numbers for each.
struct KissMatcherFeatures {
  Positions positions;
  PeerFeatures features;
};

/// Normals and FPFH by its FasterPFH, from the cloud as it is: its radii are 3 and 5 times `voxel`. One thread.
[[nodiscard]] KissMatcherFeatures kiss_matcher_features(const Positions& points, double voxel);

/// Its mutual matching, exact by FLANN's k-d tree in 33 dimensions; with the ratio test it is its default. One thread.
/// @returns pairs of places in `source.positions` and `target.positions`, at most 5000.
[[nodiscard]] IndexPairs kiss_matcher_matches(const KissMatcherFeatures& source, const KissMatcherFeatures& target,
                                              bool ratio_test);

/// Everything: voxel grid, features, matches, k-core and GNC, by its defaults. One thread. All calls of one program
/// must give the same `voxel`: it keeps the noise bound of the first.
/// @returns T_target_source; converged: it calls its solution valid; inliers: of its translation.
[[nodiscard]] PeerPose kiss_matcher_align(const Positions& source, const Positions& target, double voxel);

}  // namespace chainslam::bench
