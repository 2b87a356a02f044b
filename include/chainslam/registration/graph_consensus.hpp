#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/deadline.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/features/matching.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/consistency_graph.hpp"
#include "chainslam/registration/detail/consensus.hpp"
#include "chainslam/registration/detail/refit.hpp"
#include "chainslam/registration/gnc.hpp"
#include "chainslam/registration/matched_points.hpp"
#include "chainslam/registration/max_clique.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

/// How the graph of consistent matches is pruned before a motion is fitted to what is left.
enum class Pruning {
  clique,  ///< to a clique of the most matches: few wrong ones are left
  core,    ///< to the largest core, which is quicker and holds more
};

/// Finds the rigid motion that most matches agree on, without drawing lots: of the graph of matches that can be right
/// together it takes those that all can, fits the motion to them by GNC-TLS, and then again to all matches that agree
/// (Shi et al. 2021, ROBIN; Yang et al. 2021, TEASER++; Lim et al. 2025, KISS-Matcher).
///
/// Time and memory grow with the square of the number of matches: 4000 take 2 MB.
/// @tparam Rotation  `AnyRotation`, or `YawOnly` where both clouds stand upright.
template <class Rotation = AnyRotation>
struct GraphConsensus {
  ConsistencyOptions consistency{};   ///< which matches are consistent with each other
  Pruning pruning = Pruning::clique;  ///< how matches that agree are chosen
  Index clique_starts = 16;           ///< see `max_clique`
  Index clique_budget = 300;          ///< steps of branch and bound
  Index max_matches = 4000;           ///< of more, those with the least `ratio`
  double max_distance = 1.0;          ///< metres, of a match that agrees; of an inlier
  Index min_consensus = 10;           ///< matches that must agree
  Index refits = 5;                   ///< times the motion is fitted again to those that agree, at most
  GncTls<Rotation> gnc{};             ///< estimates the pose from them

  /// @param source    points in the source's frame, metres; where both have normals, these must agree, too.
  /// @param target    search over points in the target's frame; `position(i)` takes the matches' target indices.
  /// @param matches   putative; those with a point that is not finite are passed over.
  /// @param executor  the result is the same to the bit for any.
  /// @param deadline  past it, what was found so far is the answer.
  /// @returns pose, figures and status; never throws for what points and matches are like.
  /// @throws std::invalid_argument if an option makes no sense or a match names a source point that is not there.
  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] GlobalAlignResult align(const Source& source, const Target& target,
                                        std::span<const FeatureMatch> matches, const Exec& executor = {},
                                        const Deadline& deadline = {}) const {
    const MatchedPoints points = gather(source, target, matches);
    const std::vector<Hypothesis> found = hypotheses(points, 1, executor, deadline);
    GlobalAlignResult result;
    result.matches = points.size();
    result.iterations = to_index(found.size());
    result.status =
        points.size() < Rotation::least_points ? GlobalAlignStatus::too_few_matches : GlobalAlignStatus::no_consensus;
    if (!found.empty()) detail::report(result, found.front(), source, target, max_distance, executor);
    return result;
  }

  /// The `max_matches` best of the matches, as points.
  template <Cloud Source, NearestNeighborSearch Target>
  [[nodiscard]] MatchedPoints gather(const Source& source, const Target& target,
                                     std::span<const FeatureMatch> matches) const {
    if (!(max_distance > 0) || max_matches < 1 || refits < 0)
      throw std::invalid_argument("GraphConsensus: max_distance and max_matches must be positive, refits not negative");
    if (to_index(matches.size(), "matches") <= max_matches)
      return gather_matches(source, target, matches, "GraphConsensus");
    std::vector<FeatureMatch> best(matches.begin(), matches.end());
    std::stable_sort(best.begin(), best.end(),
                     [](const FeatureMatch& a, const FeatureMatch& b) { return a.ratio < b.ratio; });
    best.resize(static_cast<std::size_t>(max_matches));
    return gather_matches(source, target, best, "GraphConsensus");
  }

  /// Up to `count` motions, those with the larger gain first. Each but the first is what the matches say that agree
  /// with none before it.
  template <Executor Exec = Serial>
  [[nodiscard]] std::vector<Hypothesis> hypotheses(const MatchedPoints& points, Index count, const Exec& executor = {},
                                                   const Deadline& deadline = {}) const {
    std::vector<Hypothesis> found;
    if (points.size() < Rotation::least_points) return found;
    const BitGraph graph = consistency_graph(points, consistency, executor);
    std::vector<Index> left(static_cast<std::size_t>(points.size()));
    for (Index i = 0; i < points.size(); ++i) left[static_cast<std::size_t>(i)] = i;
    for (Index k = 0; k < count && to_index(left.size()) >= min_consensus && !(k > 0 && deadline.passed()); ++k) {
      const std::vector<Index> consistent =
          k == 0 ? prune(graph, executor, deadline) : prune(graph.among(left), executor, deadline);
      std::vector<Index> chosen;
      for (const Index i : consistent) chosen.push_back(left[static_cast<std::size_t>(i)]);
      const std::optional<Hypothesis> hypothesis = fit(points, chosen);
      if (!hypothesis || hypothesis->consensus < std::max(min_consensus, Rotation::least_points)) break;
      found.push_back(*hypothesis);
      const std::vector<double> agree = detail::agreeing(points, hypothesis->T_target_source, max_distance);
      std::erase_if(left, [&](Index i) {
        return agree[static_cast<std::size_t>(i)] > 0 || std::binary_search(chosen.begin(), chosen.end(), i);
      });
    }
    std::stable_sort(found.begin(), found.end(),
                     [](const Hypothesis& a, const Hypothesis& b) { return a.gain > b.gain; });
    return found;
  }

 private:
  template <class Exec>
  [[nodiscard]] std::vector<Index> prune(const BitGraph& graph, const Exec& executor, const Deadline& deadline) const {
    if (pruning == Pruning::clique) return max_clique(graph, clique_starts, clique_budget, deadline, executor).vertices;
    const CoreNumbers cores = core_numbers(graph);
    std::vector<Index> core;
    for (Index i = 0; i < graph.size(); ++i)
      if (cores.of_vertex[static_cast<std::size_t>(i)] == cores.largest) core.push_back(i);
    return core;
  }

  [[nodiscard]] std::optional<Hypothesis> fit(const MatchedPoints& points, std::span<const Index> chosen) const {
    std::vector<Eigen::Vector3d> source, target;
    for (const Index i : chosen) {
      source.push_back(points.source[static_cast<std::size_t>(i)]);
      target.push_back(points.target[static_cast<std::size_t>(i)]);
    }
    const std::optional<GncResult> solved = gnc.solve(source, target);
    if (!solved) return std::nullopt;
    const Hypothesis judged = detail::judge(points, solved->T_target_source, max_distance);
    return detail::RefitTable(points).refit(judged, max_distance, refits, gnc.rotation);
  }
};

}  // namespace chainslam
