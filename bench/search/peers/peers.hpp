#pragma once

#include <memory>
#include <vector>

#include "search/structure.hpp"

namespace chainslam::bench {

std::unique_ptr<Structure> make_nanoflann_peer();              // Debian's
std::unique_ptr<Structure> make_nanoflann_incremental_peer();  // -DCHAINSLAM_PEER_NANOFLANN
std::unique_ptr<Structure> make_ikd_tree_peer();               // -DCHAINSLAM_PEER_IKD_TREE
std::unique_ptr<Structure> make_i_octree_peer();               // -DCHAINSLAM_PEER_I_OCTREE
std::unique_ptr<Structure> make_small_gicp_voxel_map();        // -DCHAINSLAM_PEER_SMALL_GICP
std::unique_ptr<Structure> make_small_gicp_kd_tree();

/// What a bench asks of its peers.
enum class PeersThat { grow, hold_a_scan };

/// The peers of this build; all but small_gicp's two do both.
inline std::vector<Maker> peers_that([[maybe_unused]] PeersThat what) {
  std::vector<Maker> all{{"nanoflann", make_nanoflann_peer}};
#ifdef CHAINSLAM_PEER_NANOFLANN
  all.push_back({"nanoflann_incremental", make_nanoflann_incremental_peer});
#endif
#ifdef CHAINSLAM_PEER_IKD_TREE
  all.push_back({"ikd_tree", make_ikd_tree_peer});
#endif
#ifdef CHAINSLAM_PEER_I_OCTREE
  all.push_back({"i_octree", make_i_octree_peer, Thinning::own});
#endif
#ifdef CHAINSLAM_PEER_SMALL_GICP
  if (what == PeersThat::grow)
    all.push_back({"small_gicp", make_small_gicp_voxel_map, Thinning::own, false});
  else
    all.push_back({"small_gicp", make_small_gicp_kd_tree, Thinning::own, true, false});
#endif
  return all;
}

}  // namespace chainslam::bench
