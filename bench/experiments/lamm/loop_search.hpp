#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "descriptor_table.hpp"
#include "drive.hpp"
#include "key_clouds.hpp"
#include "loop_filter.hpp"
#include "place_verification.hpp"

namespace chainslam::lamm {

/// Which key clouds may be matched with one another, by LAMM's numbers.
struct LoopSearchOptions {
  Index min_gap = 50;        ///< from the candidate to the query, within a drive
  Index min_gap_any = 0;     ///< ... in any drive
  bool turned_start = true;  ///< false: the start of a drive is put as the released code does, without the loop's turn
};

/// One place seen twice.
struct Loop {
  Index source = 0, target = 0;              ///< drives; the target's is the earlier, or the same
  Index source_frame = 0, target_frame = 0;  ///< of these drives
  SE3d T_target_source{};                    ///< between the bodies at these frames
  double overlap = 0;                        ///< of planes
  Index agreeing = 0;                        ///< triangles
  double mean_squared_residual = 0;          ///< m^2
  bool kept = false;                         ///< by the filter
};

/// All loops from the key clouds of one drive to those of another, or of the same.
template <Executor Exec>
[[nodiscard]] std::vector<Loop> find_loops(Index source, Index target, const std::vector<KeyCloud>& queries,
                                           const std::vector<KeyCloud>& places, const DescriptorTable& table,
                                           const LoopSearchOptions& search, const VerificationOptions& verification,
                                           const Exec& executor) {
  std::vector<std::optional<Loop>> found(queries.size());
  executor.for_chunks(to_index(queries.size()), 1, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const KeyCloud& query = queries[static_cast<std::size_t>(i)];
      const auto eligible = [&](Index place) {
        const Index gap = query.number - places[static_cast<std::size_t>(place)].number;
        return gap >= search.min_gap_any && (source != target || gap >= search.min_gap);
      };
      const auto best = recognize(*query.place, table, table.candidates(*query.place, eligible), verification);
      if (!best) continue;
      found[static_cast<std::size_t>(i)] = {.source = source,
                                            .target = target,
                                            .source_frame = query.frame,
                                            .target_frame = places[static_cast<std::size_t>(best->place)].frame,
                                            .T_target_source = best->T_place_query,
                                            .overlap = best->overlap,
                                            .agreeing = best->agreeing,
                                            .mean_squared_residual = best->mean_squared_residual};
    }
  });
  std::vector<Loop> loops;
  for (const std::optional<Loop>& loop : found)
    if (loop) loops.push_back(*loop);
  return loops;
}

/// Where a loop between two drives puts the frame of the target in that of the source.
[[nodiscard]] inline SE3d frame_by(const Loop& loop, std::span<const Drive> drives) {
  const SE3d& T_source_body = drives[static_cast<std::size_t>(loop.source)].pose(loop.source_frame);
  const SE3d& T_target_body = drives[static_cast<std::size_t>(loop.target)].pose(loop.target_frame);
  return T_source_body * loop.T_target_source.inverse() * T_target_body.inverse();
}

namespace detail {

/// The origin of the target's frame in the source's, by a loop; as released the loop's translation is not turned.
[[nodiscard]] inline Eigen::Vector3d start_by(const Loop& loop, std::span<const Drive> drives, bool turned) {
  const SE3d T_source_target = frame_by(loop, drives);
  if (turned) return T_source_target.translation();
  const SO3d& R_source_body = drives[static_cast<std::size_t>(loop.source)].pose(loop.source_frame).rotation();
  const Eigen::Vector3d& t = loop.T_target_source.translation();
  const Eigen::Vector3d unturned = R_source_body * t;
  const Eigen::Vector3d right = R_source_body * (loop.T_target_source.rotation().inverse() * t);
  return T_source_target.translation() + right - unturned;
}

}  // namespace detail

/// Marks the loops of one pair of drives that are kept: within a drive those that agree with odometry, between two
/// drives those that put the target's start where most do.
inline void filter_loops(std::vector<Loop>& loops, std::span<const Drive> drives, const LoopFilterOptions& filter,
                         bool turned_start) {
  if (loops.empty()) return;
  if (loops.front().source == loops.front().target) {
    const Drive& drive = drives[static_cast<std::size_t>(loops.front().source)];
    for (Loop& loop : loops)
      loop.kept = agrees_with_odometry(loop.T_target_source, drive.pose(loop.target_frame),
                                       drive.pose(loop.source_frame), filter);
    return;
  }
  std::vector<Eigen::Vector3d> starts;
  for (const Loop& loop : loops) starts.push_back(detail::start_by(loop, drives, turned_start));
  const Agreement agreed = agreement(starts, filter);
  for (std::size_t i = 0; i < loops.size(); ++i) loops[i].kept = agreed.holds(starts[i]);
}

}  // namespace chainslam::lamm
