#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/matching.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/detail/consensus.hpp"
#include "chainslam/registration/detail/refit.hpp"
#include "chainslam/registration/matched_points.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

/// Makes a hypothesis better that beats those before it.
///
/// Law: `improve(points, hypothesis, max_distance)` returns one whose gain is not smaller.
template <class L>
concept LocalOptimization = requires(const L& local, const MatchedPoints& points, const Hypothesis& hypothesis,
                                     double max_distance) {
  { local.improve(points, hypothesis, max_distance) } -> std::same_as<Hypothesis>;
};

/// Leaves hypotheses as the triples gave them.
struct NoLocalOptimization {
  /// The hypothesis as it is.
  [[nodiscard]] Hypothesis improve(const MatchedPoints& /*points*/, const Hypothesis& hypothesis,
                                   double /*max_distance*/) const {
    return hypothesis;
  }
};

/// Fits the motion again to all matches that agree, while that makes it better (Chum, Matas and Kittler 2003).
struct Refit {
  Index rounds = 10;  ///< at most; 0: not at all

  /// Fits the pose to the matches that agree, again and again.
  [[nodiscard]] Hypothesis improve(const MatchedPoints& points, const Hypothesis& hypothesis,
                                   double max_distance) const {
    return detail::RefitTable(points).refit(hypothesis, max_distance, rounds, AnyRotation{});
  }
};
static_assert(LocalOptimization<NoLocalOptimization> && LocalOptimization<Refit>);

/// Judges a hypothesis by the matches, which come in random order, and may stop before the last.
///
/// Law: `give_up(seen, count, agreed, gain, largest_gain, least_gain)`, asked after each block of matches, is true
/// where the hypothesis need not be looked at further: `seen` of `count` matches have been judged, `agreed` of them
/// agree, with `gain` in all; one match gains at most `largest_gain`; a hypothesis with no more than `least_gain` is of
/// no use.
template <class B>
concept BailOut = requires(const B& bail_out, Index number, double gain) {
  { bail_out.give_up(number, number, number, gain, gain, gain) } -> std::same_as<bool>;
};

/// Always looks at all matches.
struct NoBailOut {
  [[nodiscard]] bool give_up(Index, Index, Index, double, double, double) const { return false; }  ///< never
};

/// Stops where even if all other matches fitted perfectly the hypothesis would not be of use: changes no result.
struct BoundedScoring {
  /// Whether no better score can be reached.
  [[nodiscard]] bool give_up(Index seen, Index count, Index /*agreed*/, double gain, double largest_gain,
                             double least_gain) const {
    return gain + (count - seen) * largest_gain <= least_gain;
  }
};

/// Stops where the matches seen speak for a hypothesis from wrong matches and against one from right ones, by Wald's
/// sequential probability ratio test (Chum and Matas 2008): a right one is rejected by mistake in `mistakes` of cases.
struct SequentialTest {
  double right_share = 0.1;    ///< of all matches, least, that agree with a right hypothesis
  double chance_share = 0.01;  ///< that agree with a wrong one
  double mistakes = 0.01;      ///< share of wrong decisions that is accepted

  /// Whether the matches seen so far speak against the hypothesis (Wald's test).
  [[nodiscard]] bool give_up(Index seen, Index count, Index agreed, double gain, double largest_gain,
                             double least_gain) const {
    if (BoundedScoring{}.give_up(seen, count, agreed, gain, largest_gain, least_gain)) return true;
    const double evidence = agreed * std::log(chance_share / right_share) +
                            (seen - agreed) * std::log((1 - chance_share) / (1 - right_share));
    return evidence > -std::log(mistakes);
  }
};
static_assert(BailOut<NoBailOut> && BailOut<BoundedScoring> && BailOut<SequentialTest>);

/// Finds the rigid motion that most matches agree on, where most matches may be wrong: random sample consensus
/// (Fischler and Bolles 1981) over triples of matches.
///
/// A triple whose two triangles differ in an edge is dropped before a motion is fitted to it, and the motion is dropped
/// if it does not bring the triple itself together. The best is the one with the least sum of squared distances, each
/// cut off at the largest allowed (Torr and Zisserman 2000, MSAC): fitting it again to the matches that agree, as is
/// done with each triple that beats those before it, cannot make it worse. The number of hypotheses follows from its
/// consensus.
///
/// @tparam Local  makes a new best motion better: `Refit` or `NoLocalOptimization`.
/// @tparam Bail   when to stop judging a motion: `BoundedScoring`, `SequentialTest` or `NoBailOut`.
template <class Local = Refit, class Bail = BoundedScoring>
struct BasicRansac {
  static_assert(LocalOptimization<Local>,
                "BasicRansac: Local needs `Hypothesis improve(points, hypothesis, max_distance) const`, as in Refit; "
                "see chainslam/registration/ransac.hpp");
  static_assert(BailOut<Bail>,
                "BasicRansac: Bail needs `bool give_up(seen, count, agreed, gain, largest_gain, least_gain) const`, as "
                "in BoundedScoring; see chainslam/registration/ransac.hpp");

  double max_distance = 1.0;       ///< metres, of a match that agrees; of an inlier
  double edge_length_ratio = 0.9;  ///< least ratio of the shorter to the longer edge
  Index max_iterations = 10'000;   ///< hypotheses
  double confidence = 0.999;       ///< that a triple of right matches is among the hypotheses, for stopping early
  Index min_consensus = 10;  ///< matches that must agree; three always do, and of other places eight did by chance
  std::uint64_t seed = 0;    ///< of the random draws
  [[no_unique_address]] Local local_optimization{};  ///< improves hypotheses
  [[no_unique_address]] Bail bail_out{};             ///< ends the scoring of bad ones early

  /// @param source    points in the source's frame, metres.
  /// @param target    search over points in the target's frame; `position(i)` takes the matches' target indices.
  /// @param matches   putative; those with a point that is not finite are passed over.
  /// @param executor  runs the hypotheses; the result is the same to the bit for any.
  /// @param deadline  looked at every some hundred hypotheses; past it, the best so far is the answer.
  /// @returns pose, figures and status; never throws for what points and matches are like.
  /// @throws std::invalid_argument if an option makes no sense or a match names a source point that is not there.
  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] GlobalAlignResult align(const Source& source, const Target& target,
                                        std::span<const FeatureMatch> matches, const Exec& executor = {},
                                        const Deadline& deadline = {}) const {
    check();
    const MatchedPoints points = gather_matches(source, target, matches, "Ransac");
    GlobalAlignResult result;
    result.matches = points.size();
    result.status = GlobalAlignStatus::too_few_matches;
    if (points.size() < sample_size) return result;
    const Hypothesis best = search(points, result.iterations, executor, deadline);
    result.status = GlobalAlignStatus::no_consensus;
    if (best.consensus < std::max(min_consensus, sample_size)) return result;
    detail::report(result, best, source, target, max_distance, executor);
    return result;
  }

 private:
  static constexpr Index sample_size = 3;

  [[gnu::cold]] void check() const {
    if (!(max_distance > 0) || !(edge_length_ratio >= 0 && edge_length_ratio <= 1))
      throw std::invalid_argument("Ransac: max_distance must be positive, edge_length_ratio in [0, 1]");
    if (max_iterations < 1 || !(confidence > 0 && confidence < 1))
      throw std::invalid_argument("Ransac: max_iterations must be at least 1, confidence in (0, 1)");
  }

  /// Tries hypotheses 0, 1, ... as one thread would, which stops after the one that makes it confident; batches only
  /// look ahead.
  template <class Exec>
  [[nodiscard]] Hypothesis search(const MatchedPoints& points, Index& iterations, const Exec& executor,
                                  const Deadline& deadline) const {
    constexpr Index grain = 64, largest_batch = 2048;
    const Rng rng(seed);
    const detail::MatchTable table(points, shuffled(points.size(), rng));
    Hypothesis best;
    double most_by_triple = 0;  // triples compete as they are: one fitted again would keep better ones out
    detail::Table<Hypothesis> batch;
    Index enough = max_iterations;
    for (Index size = 2 * grain; iterations < enough; size = std::min(2 * size, largest_batch)) {
      if (iterations > 0 && deadline.passed()) break;
      batch.assign(std::min(size, enough - iterations), {});
      executor.for_chunks(static_cast<Index>(batch.size()), grain, [&](Index begin, Index end) {
        for (Index i = begin; i < end; ++i)
          batch[i] = hypothesis(points, table, rng.fork(static_cast<std::uint64_t>(iterations + i)), most_by_triple);
      });
      for (Offset i = 0; i < batch.size() && iterations < enough; ++i, ++iterations) {
        if (!(batch[i].gain > most_by_triple)) continue;
        most_by_triple = batch[i].gain;
        const Hypothesis judged = detail::judge(points, batch[i].T_target_source, max_distance);
        const Hypothesis improved = local_optimization.improve(points, judged, max_distance);
        if (improved.gain > best.gain) best = improved;
        enough = std::min(enough, needed(best.consensus, points.size()));
      }
    }
    return best;
  }

  /// The matches in random order, so that the first are representative.
  [[nodiscard]] static std::vector<Index> shuffled(Index count, const Rng& rng) {
    constexpr std::uint64_t stream = ~std::uint64_t{0};  // no hypothesis has this number
    Rng draws = rng.fork(stream);
    std::vector<Index> order(static_cast<std::size_t>(count));
    for (Index i = 0; i < count; ++i) order[static_cast<std::size_t>(i)] = i;
    for (Index i = count - 1; i > 0; --i)
      std::swap(order[static_cast<std::size_t>(i)], order[static_cast<std::size_t>(draws.uniform_index(i + 1))]);
    return order;
  }

  /// Hypotheses after which a triple of right matches has been among them with `confidence`, if `consensus` of `count`
  /// matches are right: log(1 - confidence) / log(1 - ratio^3).
  [[nodiscard]] Index needed(Index consensus, Index count) const {
    const double ratio = static_cast<double>(consensus) / count;
    const double iterations = std::log1p(-confidence) / std::log1p(-ratio * ratio * ratio);
    return static_cast<Index>(std::ceil(std::clamp(iterations, 1.0, static_cast<double>(max_iterations))));
  }

  /// One triple, the motion that it determines and all that agree; no consensus if the triple itself does not, or if
  /// they cannot gain more than `least_gain`.
  [[nodiscard]] Hypothesis hypothesis(const MatchedPoints& points, const detail::MatchTable& table, Rng rng,
                                      double least_gain) const {
    const Index count = points.size();
    std::array<Index, sample_size> chosen{rng.uniform_index(count), rng.uniform_index(count), rng.uniform_index(count)};
    if (chosen[0] == chosen[1] || chosen[0] == chosen[2] || chosen[1] == chosen[2]) return {};
    std::array<Eigen::Vector3d, sample_size> source, target;
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      source[i] = points.source[static_cast<std::size_t>(chosen[i])];
      target[i] = points.target[static_cast<std::size_t>(chosen[i])];
    }
    if (!edges_alike(source, target)) return {};
    constexpr std::array<double, sample_size> alike{1, 1, 1};
    const std::optional<SE3d> T = fit_motion<AnyRotation>(source, target, alike);
    if (!T) return {};
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      const Eigen::Vector3d moved = *T * source[i];
      if (squared_distance<3>(moved.data(), target[i].data()) > max_distance * max_distance) return {};
    }
    return judge_quickly(table, *T, least_gain);
  }

  [[nodiscard]] bool edges_alike(std::span<const Eigen::Vector3d> source,
                                 std::span<const Eigen::Vector3d> target) const {
    const double least = edge_length_ratio * edge_length_ratio;
    for (std::size_t i = 0; i < source.size(); ++i) {
      const std::size_t next = (i + 1) % source.size();
      const double a = squared_distance<3>(source[i].data(), source[next].data());
      const double b = squared_distance<3>(target[i].data(), target[next].data());
      if (!(std::min(a, b) >= least * std::max(a, b))) return false;
    }
    return true;
  }

  [[nodiscard]] Hypothesis judge_quickly(const detail::MatchTable& table, const SE3d& T, double least_gain) const {
    constexpr std::size_t block = 64;
    const double largest = max_distance * max_distance;
    const detail::MatchTable::Pose pose = table.centered(T);
    Hypothesis judged{.T_target_source = T};
    for (std::size_t i = 0; i < table.size(); i += block) {
      table.add_gain(pose, static_cast<float>(largest), i, i + block, judged.gain, judged.consensus);
      const auto seen = static_cast<Index>(std::min(i + block, table.size()));
      if (bail_out.give_up(seen, static_cast<Index>(table.size()), judged.consensus, judged.gain, largest, least_gain))
        return {};
    }
    return judged;
  }
};

/// RANSAC as it is best for most.
using Ransac = BasicRansac<>;

}  // namespace chainslam
