#pragma once

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/smoother_reports.hpp"
#include "chainslam/slam/map_graph_options.hpp"

namespace chainslam {

/// What the back end does besides finding closures.
struct BackEndOptions {
  MapGraphOptions graph{};  ///< of the pose graph
  /// After a merge, metres along the aligned path between two keyframes that are tried again (section 6 of the paper).
  double recheck_travel = 4.0;
  Index fixes_at_once = 10;  ///< GNSS fixes that wait before they make an optimisation of their own
  /// Metres that a keyframe of the current session is moved by before it is tried again: its neighbours are others now.
  double search_again = 3.0;
  /// Scans that a keyframe aligns, until what is left to search again waits for the next one; 0: any number (the
  /// paper).
  Index max_alignments = 4;
  Index recheck_pause = 0;       ///< keyframes that are passed over after one that was found (released: 4)
  bool chain_in_recheck = true;  ///< the released code does not
  bool chain_merges = false;     ///< whether what joins two frames is chained, as direct closures are
  /// Whether a session that follows others closes loops before it is joined to one of them; the released code does not.
  bool close_before_merge = true;
};

/// What the back end did so far.
struct BackEndCounts {
  Index optimisations = 0;         ///< of the graph
  Index failed_optimisations = 0;  ///< the estimates before were kept
  Index merges = 0;                ///< frames joined
  Index reverted = 0;              ///< times that closures were withdrawn, or frames parted again
  Index alignments = 0;            ///< scans aligned to submaps, accepted or not; without those that confirm a merge
  UpdateReport last;               ///< of the last one, but for the one that finishes
  ConvergeReport end;              ///< of the one that finishes
};

}  // namespace chainslam
