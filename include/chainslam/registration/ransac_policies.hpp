#pragma once

#include <cmath>
#include <concepts>

#include "chainslam/core/types.hpp"
#include "chainslam/registration/detail/consensus.hpp"
#include "chainslam/registration/detail/refit.hpp"
#include "chainslam/registration/matched_points.hpp"

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

}  // namespace chainslam
