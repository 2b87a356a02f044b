#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/matching.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/consistency_graph.hpp"
#include "chainslam/registration/detail/consensus.hpp"
#include "chainslam/registration/detail/refit.hpp"
#include "chainslam/registration/gnc.hpp"
#include "chainslam/registration/matched_points.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

/// For each vertex the largest k for which it belongs to a part of the graph in which all have k neighbours or more
/// (Matula and Beck 1983): a clique of k + 1 vertices lies among those with k or more.
struct CoreNumbers {
  std::vector<Index> of_vertex;  ///< core number of each vertex
  std::vector<Index> order;      ///< vertices as they were taken away, one with the fewest neighbours left each time
  Index largest = 0;             ///< largest core number
};

[[nodiscard]] inline CoreNumbers core_numbers(const BitGraph& graph) {
  const auto size = static_cast<std::size_t>(graph.size());
  CoreNumbers cores{std::vector<Index>(size), {}, 0};
  std::vector<Index> degrees(size);
  std::vector<std::vector<Index>> buckets(size + 1);  // by degree; entries of vertices that moved on stay behind
  for (Index i = 0; i < graph.size(); ++i) {
    degrees[static_cast<std::size_t>(i)] = graph.degree(i);
    buckets[static_cast<std::size_t>(degrees[static_cast<std::size_t>(i)])].push_back(i);
  }
  BitSet left(graph.size());
  for (Index i = 0; i < graph.size(); ++i) left.insert(i);
  std::size_t lowest = 0;
  while (cores.order.size() < size) {
    while (buckets[lowest].empty()) ++lowest;
    const Index vertex = buckets[lowest].back();
    buckets[lowest].pop_back();
    if (!left.contains(vertex) || degrees[static_cast<std::size_t>(vertex)] != static_cast<Index>(lowest)) continue;
    cores.largest = std::max(cores.largest, static_cast<Index>(lowest));
    cores.of_vertex[static_cast<std::size_t>(vertex)] = cores.largest;
    cores.order.push_back(vertex);
    left.erase(vertex);
    BitSet neighbors(graph.row(vertex));
    neighbors.intersect(left.words());
    neighbors.for_each([&](Index other) {
      const Index degree = --degrees[static_cast<std::size_t>(other)];
      buckets[static_cast<std::size_t>(degree)].push_back(other);
      lowest = std::min(lowest, static_cast<std::size_t>(degree));
    });
  }
  return cores;
}

/// A set of vertices that are all connected with each other.
struct Clique {
  std::vector<Index> vertices;  ///< ascending
  bool proved = false;          ///< none is larger; else the budget, or the time, ran out
};

namespace detail {

/// Branch and bound with colours for the bound (Tomita and Kameda 2007) on rows of bits (San Segundo et al. 2011).
class CliqueSearch {
 public:
  CliqueSearch(const BitGraph& graph, Index budget, const Deadline& deadline)
      : graph_(graph), budget_(budget), deadline_(deadline) {}

  /// Vertices should be numbered such that those with many neighbours come first.
  /// @param enough  sizes up to this are of no interest.
  [[nodiscard]] std::vector<Index> run(Index enough) {
    best_size_ = enough;
    BitSet all(graph_.size());
    for (Index i = 0; i < graph_.size(); ++i) all.insert(i);
    expand(all);
    return best_;
  }
  [[nodiscard]] bool finished() const { return budget_ > 0; }

 private:
  struct Colored {
    Index vertex, color;
  };

  /// Gives each candidate a colour that none of its neighbours has: a clique has no two of one colour. In the order of
  /// colours, without those that cannot lead beyond the best.
  void color(const BitSet& candidates, std::vector<Colored>& colored) const {
    const auto size = static_cast<Index>(chosen_.size());
    BitSet uncolored = candidates;
    BitSet available;
    Index first = uncolored.first();
    for (Index color = 1; first >= 0; ++color, first = uncolored.first(first)) {
      available = uncolored;
      for (Index vertex = first; vertex >= 0; vertex = available.first(vertex)) {
        uncolored.erase(vertex);
        available.erase(vertex);
        available.subtract(graph_.row(vertex), vertex);
        if (size + color > best_size_) colored.push_back({vertex, color});
      }
    }
  }

  void expand(const BitSet& candidates) {
    if (budget_ <= 0) return;
    if (--budget_ % 64 == 0 && deadline_.passed()) budget_ = 0;
    std::vector<Colored> colored;
    color(candidates, colored);
    BitSet left = candidates;
    for (auto next = colored.rbegin(); next != colored.rend() && budget_ > 0; ++next) {
      if (static_cast<Index>(chosen_.size()) + next->color <= best_size_) return;
      chosen_.push_back(next->vertex);
      BitSet common = left;
      common.intersect(graph_.row(next->vertex));
      if (common.first() >= 0) {
        expand(common);
      } else if (static_cast<Index>(chosen_.size()) > best_size_) {
        best_size_ = static_cast<Index>(chosen_.size());
        best_ = chosen_;
      }
      chosen_.pop_back();
      left.erase(next->vertex);
    }
  }

  const BitGraph& graph_;
  Index budget_;
  const Deadline& deadline_;
  Index best_size_ = 0;
  std::vector<Index> chosen_, best_;
};

/// Grows a clique from a vertex: each time the candidate with the most others among its neighbours, the first of
/// equals.
[[nodiscard]] inline std::vector<Index> grow_clique(const BitGraph& graph, Index start) {
  std::vector<Index> clique{start};
  BitSet candidates(graph.row(start));
  while (candidates.first() >= 0) {
    Index best = -1, most = -1;
    candidates.for_each([&](Index i) {
      const Index common = candidates.count_common(graph.row(i));
      if (common <= most) return;
      best = i;
      most = common;
    });
    clique.push_back(best);
    candidates.intersect(graph.row(best));
  }
  return clique;
}

}  // namespace detail

/// A clique of the most vertices, or one as large as could be found: greedily from the vertices of the highest cores,
/// and then by branch and bound among those whose core leaves a larger one possible.
///
/// @param starts  greedy cliques to grow, at least one.
/// @param budget  steps of branch and bound; 0: only greedy ones.
/// @param executor  grows the greedy ones; the result is the same for any.
/// @returns a result that depends on the arguments alone, unless the deadline passes.
template <Executor Exec = Serial>
[[nodiscard]] Clique max_clique(const BitGraph& graph, Index starts = 16, Index budget = 500,
                                const Deadline& deadline = {}, const Exec& executor = {}) {
  Clique clique;
  if (graph.size() == 0) return {{}, true};
  const CoreNumbers cores = core_numbers(graph);
  const Index tries = std::clamp(starts, Index{1}, graph.size());
  std::vector<std::vector<Index>> grown(static_cast<std::size_t>(tries));
  executor.for_chunks(tries, 1, [&](Index begin, Index end) {
    for (Index k = begin; k < end; ++k)
      if (k == 0 || !deadline.passed())
        grown[static_cast<std::size_t>(k)] =
            detail::grow_clique(graph, cores.order[static_cast<std::size_t>(graph.size() - 1 - k)]);
  });
  for (std::vector<Index>& one : grown)
    if (one.size() > clique.vertices.size()) clique.vertices = std::move(one);
  std::vector<Index> hopeful;  // those with many neighbours first
  for (auto vertex = cores.order.rbegin(); vertex != cores.order.rend(); ++vertex)
    if (cores.of_vertex[static_cast<std::size_t>(*vertex)] >= to_index(clique.vertices.size()))
      hopeful.push_back(*vertex);
  clique.proved = hopeful.size() <= clique.vertices.size();
  if (!clique.proved && budget > 0) {
    const BitGraph part = graph.among(hopeful);
    detail::CliqueSearch search(part, budget, deadline);
    const std::vector<Index> larger = search.run(to_index(clique.vertices.size()));
    clique.proved = search.finished();
    if (!larger.empty()) {
      clique.vertices.clear();
      for (const Index i : larger) clique.vertices.push_back(hopeful[static_cast<std::size_t>(i)]);
    }
  }
  std::sort(clique.vertices.begin(), clique.vertices.end());
  return clique;
}

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
