#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "proportion.hpp"
#include "slam/closure_gates/closure_figures.hpp"

namespace chainslam::bench {

/// The score of what no threshold accepts.
constexpr double never_accepted = std::numeric_limits<double>::infinity();

/// An alignment with what belongs to it.
struct MeasuredPair {
  const ClosurePair* pair = nullptr;
  bool full = false;
  ClosureFigures figures{};
};

/// A figure by which closures could be told: the lower, the likelier.
struct GateMeasure {
  std::string name;
  std::optional<double> threshold;  ///< in use; nothing if it is not used
  std::function<double(const ClosureFigures&)> of;
};

/// The misfit over the root of the least localizability, 0.2 at most: where a pose is wrong along an axis, only the
/// share of the residuals that determine it shows it.
[[nodiscard]] inline double misfit_by_localizability(const ClosureFigures& figures) {
  return figures.misfit / std::sqrt(std::clamp(figures.localizability, 0.03, 0.2) / 0.2);
}

/// The misfit by the nearest four fifths, only of what is sure or repeatable.
[[nodiscard]] inline double misfit_if_repeatable(const ClosureFigures& figures) {
  return figures.sure || figures.repeatable ? figures.partial_misfit : never_accepted;
}

[[nodiscard]] inline std::vector<GateMeasure> gate_measures() {
  const ClosureGate gate{};
  return {
      {"mean squared error, m^2 (the paper)", 0.3, [](const auto& f) { return f.aligned.mean_squared_error; }},
      {"share without a partner", 1 - gate.min_inlier_ratio, [](const auto& f) { return 1 - f.aligned.inlier_ratio; }},
      {"misfit", 2.0, [](const auto& f) { return f.misfit; }},
      {"misfit of the worst direction", 2.2, [](const auto& f) { return f.worst_misfit; }},
      {"misfit by localizability", 2.3, misfit_by_localizability},
      {"of the worst direction by the nearest four fifths", gate.max_misfit,
       [](const auto& f) { return f.partial_misfit; }},
      {"the same, if sure or repeatable", gate.max_misfit, misfit_if_repeatable},
      {"submap seen through by the scan", {}, [](const auto& f) { return f.contradiction; }},
      {"less 1.5 times by the scan at its centre", {}, [](const auto& f) { return f.seen_through; }},
      {"scan seen through by the submap's", {}, [](const auto& f) { return f.before_map; }},
  };
}

/// Scores of right and wrong alignments.
struct ScoreSets {
  std::vector<double> right, wrong;

  [[nodiscard]] static std::size_t accepted(const std::vector<double>& scores, double threshold) {
    return static_cast<std::size_t>(std::ranges::count_if(scores, [&](double score) { return score <= threshold; }));
  }
};

[[nodiscard]] inline ScoreSets scores_of(const std::vector<const MeasuredPair*>& pairs, const GateMeasure& measure) {
  ScoreSets sets;
  for (const MeasuredPair* pair : pairs) {
    const ClosureFigures& figures = pair->figures;
    const double score = figures.ended ? measure.of(figures) : never_accepted;
    if (figures.outcome == PairOutcome::right) sets.right.push_back(score);
    if (figures.outcome == PairOutcome::wrong) sets.wrong.push_back(score);
  }
  std::ranges::sort(sets.right);
  std::ranges::sort(sets.wrong);
  return sets;
}

/// The largest threshold that accepts no more than `share` of the wrong ones: the largest score of a right one below
/// the first wrong one too many. Minus infinity if there is none.
[[nodiscard]] inline double best_threshold(const ScoreSets& sets, double share) {
  const auto allowed = static_cast<std::size_t>(std::floor(share * static_cast<double>(sets.wrong.size())));
  const double bound = allowed < sets.wrong.size() ? sets.wrong[allowed] : std::numeric_limits<double>::infinity();
  double best = -std::numeric_limits<double>::infinity();
  for (const double score : sets.right)
    if (score < bound) best = std::max(best, score);
  return best;
}

[[nodiscard]] inline std::string text(const char* format, auto... values) {
  std::array<char, 256> buffer{};
  std::snprintf(buffer.data(), buffer.size(), format, values...);
  return buffer.data();
}

/// "95.2 % (93 to 97)" with Wilson's bounds.
[[nodiscard]] inline std::string share_text(std::size_t hits, std::size_t trials) {
  const ShareBounds bounds = wilson(hits, trials);
  const double share = trials > 0 ? static_cast<double>(hits) / static_cast<double>(trials) : 0.0;
  return text("%.1f %% (%.0f to %.0f)", 100 * share, 100 * bounds.low, 100 * bounds.high);
}

/// "2 (< 0.6 %)": how many, and what share it is below.
[[nodiscard]] inline std::string wrong_text(std::size_t hits, std::size_t trials) {
  return text("%zu (< %.2f %%)", hits, 100 * largest_share(hits, trials));
}

/// Pairs that are judged together.
struct PairGroup {
  std::string name;
  std::vector<const MeasuredPair*> pairs;
};

[[nodiscard]] inline std::string tables_of(const std::vector<PairGroup>& groups) {
  const std::vector<GateMeasure> measures = gate_measures();
  std::string table = "| scans | right | wrong |", rule = "|---|---|---|";
  for (const GateMeasure& measure : measures) {
    table += " " + measure.name + " |";
    rule += "---|";
  }
  table += " defaults: right kept, wrong accepted |\n" + rule + "---|\n";
  for (const PairGroup& group : groups) {
    ScoreSets all = scores_of(group.pairs, {"", {}, [](const auto& f) { return f.accepted ? 0.0 : 1.0; }});
    table += "| " + group.name + text(" | %zu | %zu |", all.right.size(), all.wrong.size());
    for (const GateMeasure& measure : measures) {
      const ScoreSets sets = scores_of(group.pairs, measure);
      const double best = best_threshold(sets, 0.001);
      table += text(" %.1f %% at %.3g",
                    100.0 * static_cast<double>(ScoreSets::accepted(sets.right, best)) /
                        static_cast<double>(std::max<std::size_t>(sets.right.size(), 1)),
                    best);
      if (measure.threshold)
        table += "; " + share_text(ScoreSets::accepted(sets.right, *measure.threshold), sets.right.size()) + ", " +
                 wrong_text(ScoreSets::accepted(sets.wrong, *measure.threshold), sets.wrong.size());
      table += " |";
    }
    table += " " + share_text(ScoreSets::accepted(all.right, 0.5), all.right.size()) + ", " +
             wrong_text(ScoreSets::accepted(all.wrong, 0.5), all.wrong.size()) + " |\n";
  }
  return table;
}

/// Right kept and wrong accepted over thresholds at every hundredth of the right ones, for each group and measure.
[[nodiscard]] inline std::string roc_csv(const std::vector<PairGroup>& groups) {
  std::string csv = "scans,measure,threshold,right_kept,right,wrong_accepted,wrong\n";
  for (const PairGroup& group : groups)
    for (const GateMeasure& measure : gate_measures()) {
      const ScoreSets sets = scores_of(group.pairs, measure);
      double last = -std::numeric_limits<double>::infinity();
      for (std::size_t percent = 1; percent <= 100 && !sets.right.empty(); ++percent) {
        const double threshold = sets.right[(sets.right.size() * percent + 99) / 100 - 1];
        if (!std::isfinite(threshold) || threshold <= last) continue;
        last = threshold;
        csv += "\"" + group.name + "\",\"" + measure.name + "\"" +
               text(",%.6g,%zu,%zu,%zu,%zu\n", threshold, ScoreSets::accepted(sets.right, threshold), sets.right.size(),
                    ScoreSets::accepted(sets.wrong, threshold), sets.wrong.size());
      }
    }
  return csv;
}

/// One line for each pair with all figures.
[[nodiscard]] inline std::string pairs_csv(const std::vector<MeasuredPair>& pairs) {
  std::string csv =
      "sensor,map,query,from,to,kind,full,outcome,accepted,metres_off,degrees_off,status,inlier_ratio,mse,residual,"
      "rmse,overlap,noise,misfit,worst_misfit,partial_misfit,contradiction,own_contradiction,before_map,correction,"
      "turn,"
      "localizability,sure,repeatable,"
      "align_"
      "us,fit_us,repeat_us,"
      "scan_view_us,map_view_us\n";
  for (const MeasuredPair& measured : pairs) {
    const ClosurePair& pair = *measured.pair;
    const ClosureFigures& f = measured.figures;
    csv +=
        pair.query->sensor + "," + pair.map->name + "," + pair.query->name +
        text(",%zu,%zu,%s,%d,%s,%d,%.3f,%.3f,%d,", pair.from, pair.to, name_of(pair.kind), measured.full ? 1 : 0,
             name_of(f.outcome), f.accepted ? 1 : 0, f.metres_off, f.degrees_off, static_cast<int>(f.aligned.status)) +
        text("%.4f,%.5f,%.5f,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f,", f.aligned.inlier_ratio, f.aligned.mean_squared_error,
             f.aligned.mean_squared_residual, f.rmse, f.overlap, f.noise, f.misfit, f.worst_misfit, f.partial_misfit) +
        text("%.5f,%.5f,%.5f,%.3f,%.4f,%.5f,%d,%d,", f.contradiction, f.own_contradiction, f.before_map, f.correction,
             f.turn, f.localizability, f.sure ? 1 : 0, f.repeatable ? 1 : 0) +
        text("%.0f,%.0f,%.0f,%.0f,%.0f\n", f.align_us, f.fit_us, f.repeat_us, f.scan_view_us, f.map_view_us);
  }
  return csv;
}

}  // namespace chainslam::bench
