#pragma once

#include "registration/peers/peer_pose.hpp"

namespace chainslam::bench {

/// TEASER++ (Yang, Shi and Carlone 2020) from putative matches, scale known: inlier graph, its heuristic clique,
/// GNC-TLS. One thread. Memory grows with the square of the matches.
/// @param noise_bound  metres: how far apart true matches may lie.
/// @returns T_target_source; inliers: of the translation.
[[nodiscard]] PeerPose teaser_align(const Positions& source, const Positions& target, const IndexPairs& matches,
                                    double noise_bound);

}  // namespace chainslam::bench
