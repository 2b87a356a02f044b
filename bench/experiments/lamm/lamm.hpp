#pragma once

#include <span>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/core/types.hpp"
#include "drive.hpp"
#include "key_clouds.hpp"
#include "loop_search.hpp"
#include "scan_graph.hpp"

// LAMM (Wei et al. 2025, "Large-Scale Multi-Session Point-Cloud Map Merging", RA-L 10(1)): joins sessions off line. Key
// clouds are recognized by triangles of binary keypoints, verified by their planes; loops that contradict odometry or
// one another are dropped; all sessions that loops connect are optimized together.

namespace chainslam::lamm {

/// Settings of the whole, with the defaults of the method as it was designed.
struct Options {
  KeyCloudOptions clouds{};
  PlaceDescriptorOptions place{};
  TableOptions table{};
  LoopSearchOptions search{};
  VerificationOptions verification{};
  LoopFilterOptions filter{};
  ScanGraphOptions graph{};
  Index frames_per_number = 10;  ///< frames in a row of one of LAMM's own key clouds, which its gaps count
};

/// What the released program does in place of that:
/// - each loop is a factor for each of the ten scans after its ends, with the relative pose of the ends;
/// - two to four loops between two sessions are all dropped, since their radius is zero;
/// - the start of a session is computed with a translation that is not turned;
/// - a place is recognized by half the overlap, as its launch file has it;
/// - no candidate, of whatever session, is less than 101 key clouds before the query;
/// - every session starts the optimization in its own frame, which takes eleven steps;
/// - groups after the first are held at a pose of the first session.
[[nodiscard]] Options as_released();

/// What was done, and how long it took.
struct Counts {
  Index key_clouds = 0;
  Index keypoints = 0;
  Index triangles = 0;
  Index pairs = 0;  ///< of sessions that were searched, each with itself included
  double describe_seconds = 0;
  double search_seconds = 0;
  double optimize_seconds = 0;
};

struct Result {
  std::vector<Loop> loops;  ///< all that were verified, pair by pair of sessions
  OptimizedDrives drives;
  Counts counts;
};

/// Merges drives. The same input gives the same result, whatever the number of threads.
[[nodiscard]] Result merge(std::span<const Drive> drives, const Options& options, const ThreadPool& threads);

}  // namespace chainslam::lamm
