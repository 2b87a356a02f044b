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

/// The peers of this build that both grow and hold a scan as it is.
inline std::vector<Maker> common_peers() {
  std::vector<Maker> peers{{"nanoflann", make_nanoflann_peer}};
#ifdef CHAINSLAM_PEER_NANOFLANN
  peers.push_back({"nanoflann_incremental", make_nanoflann_incremental_peer});
#endif
#ifdef CHAINSLAM_PEER_IKD_TREE
  peers.push_back({"ikd_tree", make_ikd_tree_peer});
#endif
#ifdef CHAINSLAM_PEER_I_OCTREE
  peers.push_back({"i_octree", make_i_octree_peer, Thinning::own});
#endif
  return peers;
}

/// Those that grow.
inline std::vector<Maker> incremental_peers() {
  std::vector<Maker> peers = common_peers();
#ifdef CHAINSLAM_PEER_SMALL_GICP
  peers.push_back({"small_gicp", make_small_gicp_voxel_map, Thinning::own, false});
#endif
  return peers;
}

/// Those that hold a scan as it is.
inline std::vector<Maker> static_peers() {
  std::vector<Maker> peers = common_peers();
#ifdef CHAINSLAM_PEER_SMALL_GICP
  peers.push_back({"small_gicp", make_small_gicp_kd_tree, Thinning::own, true, false});
#endif
  return peers;
}

}  // namespace chainslam::bench
