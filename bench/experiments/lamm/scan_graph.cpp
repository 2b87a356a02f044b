#include "scan_graph.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <optional>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/slam/connected_components.hpp"
#include "chainslam/sparse/cholmod.hpp"

namespace chainslam::lamm {

namespace {

using LoopFactor = BetweenFactor<SE3d, Cauchy>;
using Graph = FactorGraph<SE3d, LoopFactor>;
using Keys = std::vector<std::map<Index, Key>>;  ///< of each drive, by frame

/// How many frames after its ends the factors of a loop are; of the ends themselves: 0.
struct Offsets {
  Index first = 0, last = 0;
};
Offsets offsets_of(const ScanGraphOptions& options) {
  return options.frames_a_loop > 0 ? Offsets{1, options.frames_a_loop} : Offsets{0, 0};
}

bool has_frames(const Loop& loop, Index offset, std::span<const Drive> drives) {
  return loop.source_frame + offset < drives[static_cast<std::size_t>(loop.source)].frames() &&
         loop.target_frame + offset < drives[static_cast<std::size_t>(loop.target)].frames();
}

/// Calls visit(source frame, target frame) for each factor of a loop.
template <class Visit>
void for_each_factor(const Loop& loop, std::span<const Drive> drives, const ScanGraphOptions& options,
                     const Visit& visit) {
  const Offsets offsets = offsets_of(options);
  for (Index i = offsets.first; i <= offsets.last; ++i)
    if (has_frames(loop, i, drives)) visit(loop.source_frame + i, loop.target_frame + i);
}

/// The first drive of each drive's group, by the loops that were kept.
std::vector<Index> groups_of(std::span<const Drive> drives, std::span<const Loop> loops) {
  ConnectedComponents components(to_index(drives.size()));
  for (const Loop& loop : loops)
    if (loop.kept) components.connect(loop.source, loop.target);
  std::vector<Index> groups;
  for (Index i = 0; i < to_index(drives.size()); ++i) {
    Index first = 0;
    while (!components.same(i, first)) ++first;
    groups.push_back(first);
  }
  return groups;
}

/// The loop between a placed drive and one that is not, whose planes overlap most; none if there is none.
const Loop* best_loop_out(std::span<const Loop> loops, const std::vector<std::optional<SE3d>>& placed) {
  const Loop* best = nullptr;
  for (const Loop& loop : loops)
    if (loop.kept &&
        placed[static_cast<std::size_t>(loop.source)].has_value() !=
            placed[static_cast<std::size_t>(loop.target)].has_value() &&
        (best == nullptr || loop.overlap > best->overlap))
      best = &loop;
  return best;
}

/// T_map_odom of every drive to start from.
std::vector<SE3d> starting_frames(std::span<const Drive> drives, std::span<const Loop> loops,
                                  const std::vector<Index>& groups, bool placed_by_loops) {
  if (!placed_by_loops) return std::vector<SE3d>(drives.size());
  std::vector<std::optional<SE3d>> placed(drives.size());
  for (std::size_t i = 0; i < drives.size(); ++i)
    if (groups[i] == to_index(i)) placed[i] = SE3d();
  while (const Loop* loop = best_loop_out(loops, placed)) {
    const SE3d T_source_target = frame_by(*loop, drives);
    auto& source = placed[static_cast<std::size_t>(loop->source)];
    auto& target = placed[static_cast<std::size_t>(loop->target)];
    if (source)
      target = *source * T_source_target;
    else
      source = *target * T_source_target.inverse();
  }
  std::vector<SE3d> frames;
  for (const std::optional<SE3d>& frame : placed) frames.push_back(frame.value_or(SE3d()));
  return frames;
}

/// Variables for each scan and each end of a factor, started where the drives' frames put them.
Keys add_variables(std::span<const Drive> drives, std::span<const Loop> loops, const std::vector<SE3d>& frames,
                   const ScanGraphOptions& options, Graph& graph) {
  Keys keys(drives.size());
  for (std::size_t i = 0; i < drives.size(); ++i)
    for (const Scan& scan : drives[i].scans) keys[i][scan.frame] = 0;
  for (const Loop& loop : loops)
    if (loop.kept)
      for_each_factor(loop, drives, options, [&](Index source, Index target) {
        keys[static_cast<std::size_t>(loop.source)][source] = 0;
        keys[static_cast<std::size_t>(loop.target)][target] = 0;
      });
  for (std::size_t i = 0; i < drives.size(); ++i)
    for (auto& [frame, key] : keys[i]) key = graph.add_value(frames[i] * drives[i].pose(frame));
  return keys;
}

void add_odometry(const Drive& drive, const std::map<Index, Key>& keys, double variance, Graph& graph) {
  for (auto from = keys.begin(); from != keys.end() && std::next(from) != keys.end(); ++from) {
    const auto to = std::next(from);
    const Matrix6d covariance = compounded_covariance(drive, from->first, to->first, variance);
    graph.add_between(from->second, to->second, drive.pose(from->first).inverse() * drive.pose(to->first),
                      NoiseModel<6>::from_covariance(covariance));
  }
}

void add_loops(std::span<const Drive> drives, std::span<const Loop> loops, const Keys& keys,
               const ScanGraphOptions& options, Graph& graph) {
  const auto noise = NoiseModel<6>::from_sigma(std::sqrt(options.loop_variance));
  for (const Loop& loop : loops)
    if (loop.kept)
      for_each_factor(loop, drives, options, [&](Index source, Index target) {
        graph.add(LoopFactor{.from = keys[static_cast<std::size_t>(loop.target)].at(target),
                             .to = keys[static_cast<std::size_t>(loop.source)].at(source),
                             .measurement = loop.T_target_source,
                             .sqrt_information = noise.sqrt_information(),
                             .kernel = {.width = options.loop_kernel}});
      });
}

/// Holds each group at the first scan of its first drive.
void add_priors(std::span<const Drive> drives, const std::vector<Index>& groups, const Keys& keys,
                const ScanGraphOptions& options, Graph& graph) {
  const auto noise = NoiseModel<6>::from_sigma(std::sqrt(options.prior_variance));
  Index group = 0;
  for (std::size_t i = 0; i < drives.size(); ++i) {
    if (groups[i] != to_index(i)) continue;
    const Index wrong = group++;
    if (keys[i].empty()) continue;
    const Key first = keys[i].begin()->second;
    const bool own = options.own_start || wrong >= drives.front().frames();
    graph.add_prior(first, own ? graph[first] : drives.front().pose(wrong), noise);
  }
}

}  // namespace

Matrix6d compounded_covariance(const Drive& drive, Index from, Index to, double variance) {
  const Matrix6d step = variance * Matrix6d::Identity();
  Matrix6d covariance = Matrix6d::Zero();
  for (Index i = from; i < to; ++i) {
    const SE3d T_next_here = drive.pose(i + 1).inverse() * drive.pose(i);
    const Matrix6d adjoint = T_next_here.adjoint();
    covariance = (adjoint * covariance * adjoint.transpose() + step).eval();
  }
  return (0.5 * (covariance + covariance.transpose())).eval();
}

OptimizedDrives optimize_drives(std::span<const Drive> drives, std::span<const Loop> loops,
                                const ScanGraphOptions& options) {
  OptimizedDrives result;
  result.frame_of = groups_of(drives, loops);
  Graph graph;
  const Keys keys =
      add_variables(drives, loops, starting_frames(drives, loops, result.frame_of, options.placed), options, graph);
  for (std::size_t i = 0; i < drives.size(); ++i) add_odometry(drives[i], keys[i], options.odometry_variance, graph);
  add_loops(drives, loops, keys, options, graph);
  add_priors(drives, result.frame_of, keys, options, graph);
  result.variables = graph.values().size();
  result.factors = graph.factor_count();
  // Ten factors a loop tie the sessions together in sheets, which minimum degree does not see.
  BlockCholesky<6, NestedDissection> solver;
  result.report = options.damped ? optimize(graph, LevenbergMarquardt{.max_iterations = options.max_iterations}, solver)
                                 : optimize(graph, GaussNewton{.max_iterations = options.max_iterations}, solver);
  for (std::size_t i = 0; i < drives.size(); ++i) {
    std::vector<SE3d>& poses = result.poses.emplace_back();
    for (const Scan& scan : drives[i].scans) poses.push_back(graph[keys[i].at(scan.frame)]);
  }
  return result;
}

}  // namespace chainslam::lamm
