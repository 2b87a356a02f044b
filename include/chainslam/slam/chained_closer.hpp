#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/slam/adjacency_graph.hpp"
#include "chainslam/slam/breadth_first_search.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/connected_components.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/slam/submap.hpp"

namespace chainslam {

/// Keyframes and the accepted closures between them; an edge knows its position among the map's closures. What is
/// connected is known without a walk, however large the map.
class ClosureGraph : public AdjacencyGraph<Index> {
 public:
  /// So many keyframes without closures.
  explicit ClosureGraph(Index nodes = 0) : AdjacencyGraph(nodes), components_(nodes) {}

  Index add_node() = delete;  ///< `resize` adds keyframes
  /// Adds keyframes until there are `nodes` of them.
  void resize(Index nodes) {
    AdjacencyGraph::resize(nodes);
    components_.resize(nodes);
  }
  /// Adds a closure.
  void add_edge(Index a, Index b, Index closure) {
    AdjacencyGraph::add_edge(a, b, closure);
    components_.connect(a, b);
  }
  /// Which keyframes closures connect, over any others.
  [[nodiscard]] const ConnectedComponents& components() const { return components_; }

 private:
  ConnectedComponents components_;
};

/// Adds the map's closures that are factors, from a position on.
[[gnu::cold]] inline void connect_closures(ClosureGraph& graph, const SlamMap& map, Index first) {
  graph.resize(to_index(map.keyframes.size()));
  for (Index i = first; i < to_index(map.closures.size()); ++i)
    if (const LoopClosure& closure = map.closures[static_cast<std::size_t>(i)]; closure.is_factor())
      graph.add_edge(closure.from.value, closure.to.value, i);
}

/// Aligns one keyframe's scan to another's submap, and knows which pairs may be closed: what chaining and merging take
/// from the loop closer. `refine`, with the arguments of `align`, is used for guesses through a chain if there is one.
template <class C>
concept ClosureAligner = requires(C& closer, std::span<const Keyframe> keyframes, const Keyframe& keyframe,
                                  const SE3d& guess) {
  { closer.align(keyframes, keyframe.id, keyframe.id, guess, Serial{}) } -> std::same_as<LoopClosure>;
  { closer.eligible(keyframe, keyframe) } -> std::same_as<bool>;
};

/// Aligns a scan to several submaps at a time, each as `align` and `refine` of one guess do: how a chain's alignments
/// are made if the loop closer can.
template <class C>
concept BatchAligner = ClosureAligner<C> &&
    requires(C& closer, std::span<const Keyframe> keyframes, std::span<const AlignmentGuess> guesses, KeyframeId to) {
  { closer.align(keyframes, guesses, to, Serial{}) } -> std::same_as<std::vector<LoopClosure>>;
  { closer.refine(keyframes, guesses, to, Serial{}) } -> std::same_as<std::vector<LoopClosure>>;
};

/// Tries to close loops with the newest keyframe, the last of `keyframes`.
///
/// `close(keyframes, index, executor)` gives what was tried, each with its verdict. `index` holds the positions of all
/// keyframes in the newest one's frame. It is called once for each keyframe, in order. A back end that merges also
/// calls `search(keyframes, index, query, executor)`, for any keyframe.
template <class C>
concept ClosureFinder = requires(C& closer, std::span<const Keyframe> keyframes, const PositionIndex& index) {
  { closer.close(keyframes, index, Serial{}) } -> std::same_as<std::vector<LoopClosure>>;
};

/// Which chained closures are tried and accepted.
struct ChainOptions {
  bool enabled = true;  ///< whether closures are chained at all
  /// Whether the search walks through keyframes of the current session too (the paper's Algorithm 1).
  bool through_current_session = true;
  /// Keyframes on each side of j whose closures count as j's: the scan was aligned to all of their scans. 0: j alone
  /// (the paper), which seldom meets the same keyframe twice unless closures fuse the whole map into one component.
  Index reach = 4;
  /// Where an alignment starts: the direct closure carried over to k by the map, or what the graph thinks of i (the
  /// paper). The drift of the current session is gone from the first.
  bool guess_through_chain = true;
  double max_distance = 20.0;  ///< metres between i and k, as guessed: beyond, they share no view; 0: any (the paper)
  Index min_separation = 20;   ///< keyframes between two partners of one session: nearer, their submaps share scans
  Index max_alignments = 4;    ///< for one direct closure; 0: all (the paper)
  /// Metres by which others must be nearer than keyframes within `min_separation` of the last direct closure's
  /// partners, whose submaps are there already, if not all may be tried. 0: the nearest are tried, whatever their
  /// session.
  double hysteresis = 5.0;
  double max_translation = 2.0;  ///< metres from the guess, beyond which a closure contradicts the chain; 0: any
  double max_rotation = 0.1;     ///< radians
  /// How much of the information of closures that share a scan is the same: 0 none (the paper), 1 all.
  double correlation = 0.5;
};

/// Chained loop closure (Algorithm 1 of the paper): whoever is connected with the partner of a direct closure by
/// closures of any session is tried with the same scan.
class ChainedCloser {
 public:
  explicit ChainedCloser(const ChainOptions& options = {}) : options_(options) {}  ///< starts without closures

  /// The loaded keyframes that closures connect with j, without j, in the order of the search: N(j) of the paper.
  /// @param loaded  keyframes before this one are of earlier sessions (N_L).
  /// @param submap  the keyframes whose closures count as j's.
  [[nodiscard]] std::vector<KeyframeId> connected(const ClosureGraph& graph, KeyframeId j, SubmapRange submap,
                                                  Index loaded) {
    std::vector<KeyframeId> found;
    collect(graph, j, loaded, found);
    // Components do not overlap: one that has a node in common with what was found was walked already.
    for (Index near = submap.begin; near < submap.end; ++near)
      if (near != j.value && graph.degree(near) > 0 &&
          std::find(found.begin(), found.end(), KeyframeId{near}) == found.end())
        collect(graph, KeyframeId{near}, loaded, found);
    return found;
  }
  /// The same where the closures of j alone count.
  [[nodiscard]] std::vector<KeyframeId> connected(const ClosureGraph& graph, KeyframeId j, Index loaded) {
    return connected(graph, j, {j.value, j.value + 1}, loaded);
  }

  /// Those of `connected`, walking through any session, that lie within `radius` metres of a position; by id. Costs
  /// what lies there, not what is connected.
  /// @param index  has the positions of the keyframes.
  [[nodiscard]] [[gnu::cold]] static std::vector<KeyframeId> connected_near(const ClosureGraph& graph, KeyframeId j,
                                                                            SubmapRange submap, Index loaded,
                                                                            const PositionIndex& index,
                                                                            const Eigen::Vector3d& center,
                                                                            double radius);

  /// Tries keyframes connected with the partner of `direct` against the same scan.
  ///
  /// @param graph   all accepted closures so far.
  /// @param direct  accepted, from a keyframe j to the current keyframe i; its information is shared out over the
  /// group.
  /// @param loaded  N_L; nothing is tried if j is not among these.
  /// @param index   the positions of the keyframes, if there is one: then only what lies near is looked at.
  /// @returns what was tried, each with its verdict.
  template <ClosureAligner Closer, Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> close(std::span<const Keyframe> keyframes,
                                                             const ClosureGraph& graph, LoopClosure& direct,
                                                             Index loaded, Closer& closer, const E& executor = {},
                                                             const PositionIndex* index = nullptr);

  [[nodiscard]] const ChainOptions& options() const { return options_; }  ///< its settings

 private:
  /// Step 1 of Algorithm 1: walks everything reachable, keeps what is loaded.
  struct Collect {
    std::vector<KeyframeId>& found;
    Index j, loaded;
    bool through_current_session;

    void discover(Index node) const {
      const KeyframeId id{node};
      if (node < loaded && node != j) found.push_back(id);
    }
    [[nodiscard]] BfsAction examine(Index node) const {
      return through_current_session || node < loaded ? BfsAction::expand : BfsAction::skip;
    }
  };

  void collect(const ClosureGraph& graph, KeyframeId from, Index loaded, std::vector<KeyframeId>& found) {
    breadth_first_search(graph, from.value, Collect{found, from.value, loaded, options_.through_current_session}, {},
                         workspace_);
  }

  template <class Closer>
  [[nodiscard]] [[gnu::cold]] detail::Table<AlignmentGuess> candidates(std::span<const Keyframe> keyframes,
                                                                       const ClosureGraph& graph,
                                                                       const LoopClosure& direct, Index loaded,
                                                                       const Closer& closer,
                                                                       const PositionIndex* index);

  /// What comes through the chain is off by decimetres at most, or wrong: no need to look farther around.
  template <class Closer, class E>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> aligned(std::span<const Keyframe> keyframes,
                                                               std::span<const AlignmentGuess> candidates,
                                                               KeyframeId to, Closer& closer, const E& executor) const {
    if constexpr (BatchAligner<Closer>) {
      return options_.guess_through_chain ? closer.refine(keyframes, candidates, to, executor)
                                          : closer.align(keyframes, candidates, to, executor);
    } else {
      std::vector<LoopClosure> closures;
      for (const AlignmentGuess& one : candidates) closures.push_back(aligned(keyframes, one, to, closer, executor));
      return closures;
    }
  }
  template <class Closer, class E>
  [[nodiscard]] LoopClosure aligned(std::span<const Keyframe> keyframes, const AlignmentGuess& candidate, KeyframeId to,
                                    Closer& closer, const E& executor) const {
    if constexpr (requires { closer.refine(keyframes, candidate.from, to, candidate.T_from_to, executor); })
      if (options_.guess_through_chain)
        return closer.refine(keyframes, candidate.from, to, candidate.T_from_to, executor);
    return closer.align(keyframes, candidate.from, to, candidate.T_from_to, executor);
  }

  /// Whether the submap of one is largely that of the other.
  [[nodiscard]] bool are_alike(std::span<const Keyframe> keyframes, KeyframeId one, KeyframeId other) const {
    const auto session = [&](KeyframeId id) { return keyframes[static_cast<std::size_t>(id.value)].session; };
    return std::abs(one.value - other.value) < options_.min_separation && session(one) == session(other);
  }
  [[nodiscard]] bool is_like_any(std::span<const Keyframe> keyframes, KeyframeId one,
                                 const detail::Table<KeyframeId>& others) const {
    return std::any_of(others.begin(), others.end(),
                       [&](KeyframeId other) { return are_alike(keyframes, one, other); });
  }

  /// Puts the nearest first; equally near ones stay as they are.
  [[gnu::cold]] void sort(std::span<const Keyframe> keyframes, detail::Table<AlignmentGuess>& candidates) const {
    detail::Table<Ranked> order;  // by distance
    for (const AlignmentGuess& one : candidates) {
      const double nearer = is_like_any(keyframes, one.from, partners_) ? options_.hysteresis : 0.0;
      order.push_back({one.T_from_to.translation().norm() - nearer, static_cast<Index>(order.size())});
    }
    sort_ranked(order.all());
    detail::Table<AlignmentGuess> sorted;
    for (const Ranked& one : order) sorted.push_back(candidates[one.index]);
    candidates = std::move(sorted);
  }

  /// Leaves out those whose submap is largely that of one before.
  [[nodiscard]] [[gnu::cold]] detail::Table<AlignmentGuess> spread_out(
      std::span<const Keyframe> keyframes, KeyframeId j, const detail::Table<AlignmentGuess>& candidates) const {
    detail::Table<KeyframeId> partners(1, j);
    detail::Table<AlignmentGuess> kept;
    for (const AlignmentGuess& candidate : candidates) {
      if (is_like_any(keyframes, candidate.from, partners)) continue;
      partners.push_back(candidate.from);
      kept.push_back(candidate);
    }
    return kept;
  }

  [[nodiscard]] bool contradicts(const LoopClosure& closure, const SE3d& guess) const {
    if (options_.max_translation <= 0) return false;
    const SE3d correction = guess.inverse() * closure.T_from_to;
    return !(correction.translation().norm() <= options_.max_translation &&
             correction.rotation().log().norm() <= options_.max_rotation);
  }

  /// m measurements of variance s^2, any two correlated by r, know as much as m / (1 + (m - 1) r) independent ones.
  void share_information(LoopClosure& direct, std::vector<LoopClosure>& tried) const {
    Index others = 0;
    for (const LoopClosure& closure : tried) others += closure.verdict == ClosureVerdict::accepted ? 1 : 0;
    const double scale = 1 / std::sqrt(1 + others * options_.correlation);
    const auto weaken = [&](LoopClosure& closure) {
      for (int k = 0; k < 36; ++k) closure.sqrt_information.data()[k] *= scale;
    };
    weaken(direct);
    for (LoopClosure& closure : tried) weaken(closure);
  }

  ChainOptions options_;
  BfsWorkspace workspace_;
  detail::Table<KeyframeId> partners_;  ///< of the last direct closure and what was chained from it
};

inline std::vector<KeyframeId> ChainedCloser::connected_near(const ClosureGraph& graph, KeyframeId j,
                                                             SubmapRange submap, Index loaded,
                                                             const PositionIndex& index, const Eigen::Vector3d& center,
                                                             double radius) {
  constexpr double rounding = 1e-6;  // metres; who asks measures exactly
  const ConnectedComponents& components = graph.components();
  detail::Table<Index> starts(1, j.value), reached(1, components.component_of(j.value));
  const auto is_among = [](const detail::Table<Index>& some, Index one) {
    return std::find(some.begin(), some.end(), one) != some.end();
  };
  for (Index near = submap.begin; near < submap.end; ++near)
    if (graph.degree(near) > 0 && !is_among(reached, components.component_of(near))) {
      starts.push_back(near);
      reached.push_back(components.component_of(near));
    }
  std::vector<KeyframeId> found;
  index.for_each_near(center, radius + rounding, [&](KeyframeId id, const Eigen::Vector3d& position) {
    if (id.value >= loaded || graph.degree(id.value) == 0 || is_among(starts, id.value)) return;
    if (squared_distance<3>(position.data(), center.data()) > (radius + rounding) * (radius + rounding)) return;
    if (is_among(reached, components.component_of(id.value))) found.push_back(id);
  });
  std::sort(found.begin(), found.end());
  return found;
}

template <ClosureAligner Closer, Executor E>
std::vector<LoopClosure> ChainedCloser::close(std::span<const Keyframe> keyframes, const ClosureGraph& graph,
                                              LoopClosure& direct, Index loaded, Closer& closer, const E& executor,
                                              const PositionIndex* index) {
  if (!options_.enabled || direct.from.value >= loaded) return {};
  const detail::Table<AlignmentGuess> all = candidates(keyframes, graph, direct, loaded, closer, index);
  std::span<const AlignmentGuess> some = all.all();
  if (options_.max_alignments > 0)
    some = some.first(std::min(some.size(), static_cast<std::size_t>(options_.max_alignments)));
  std::vector<LoopClosure> tried = aligned(keyframes, some, direct.to, closer, executor);
  for (std::size_t k = 0; k < tried.size(); ++k) {
    LoopClosure& closure = tried[k];
    closure.kind = ClosureKind::chained;
    if (closure.verdict != ClosureVerdict::accepted || !contradicts(closure, some[k].T_from_to)) continue;
    closure.verdict = ClosureVerdict::inconsistent;
    std::fill_n(closure.sqrt_information.data(), 36, 0.0);
  }
  partners_.assign(1, direct.from);
  for (const LoopClosure& closure : tried) partners_.push_back(closure.from);
  share_information(direct, tried);
  return tried;
}

template <class Closer>
detail::Table<AlignmentGuess> ChainedCloser::candidates(std::span<const Keyframe> keyframes, const ClosureGraph& graph,
                                                        const LoopClosure& direct, Index loaded, const Closer& closer,
                                                        const PositionIndex* index) {
  const auto at = [&](KeyframeId id) -> const Keyframe& { return keyframes[static_cast<std::size_t>(id.value)]; };
  const Keyframe& i = at(direct.to);
  const SE3d T_map_i = options_.guess_through_chain ? at(direct.from).T_map_body * direct.T_from_to : i.T_map_body;
  detail::Table<AlignmentGuess> all;
  const SubmapRange submap = submap_range(keyframes, direct.from, options_.reach);
  const bool looks_around = index != nullptr && options_.max_distance > 0 && options_.through_current_session;
  for (const KeyframeId k : looks_around ? connected_near(graph, direct.from, submap, loaded, *index,
                                                          T_map_i.translation(), options_.max_distance)
                                         : connected(graph, direct.from, submap, loaded)) {
    if (!closer.eligible(at(k), i) || graph.connected(k.value, i.id.value)) continue;
    const SE3d guess = at(k).T_map_body.inverse() * T_map_i;
    if (options_.max_distance > 0 && !(guess.translation().norm() <= options_.max_distance)) continue;
    all.push_back({k, guess});
  }
  sort(keyframes, all);
  return options_.min_separation > 0 ? spread_out(keyframes, direct.from, all) : all;
}

/// Tries nothing: direct closures only.
struct NoChaining {
  /// Nothing.
  template <class Closer, Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> close(std::span<const Keyframe> /*keyframes*/, const ClosureGraph& /*graph*/,
                                               LoopClosure& /*direct*/, Index /*loaded*/, Closer& /*closer*/,
                                               const E& /*executor*/ = {}) const {
    return {};
  }
};

}  // namespace chainslam
