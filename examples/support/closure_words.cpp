#include "support/closure_words.hpp"

#include <cstdio>

#include "chainslam/slam/closure_descent.hpp"
#include "support/report_data.hpp"

namespace chainslam::support {
namespace {

std::string with_number(const char* format, double value) {
  char text[96];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string why_tried(const SlamMap& map, const LoopClosure& closure) {
  const std::string cause = std::to_string(closure.cause);
  switch (closure.kind) {
    case ClosureKind::direct: {
      if (closure.cause < 0) return "near by the estimate";
      const bool merge = map.closures[static_cast<std::size_t>(closure.cause)].kind == ClosureKind::merge;
      return (merge ? "searched again after merge " : "followed from closure ") + cause;
    }
    case ClosureKind::chained:
      return closure.cause < 0 ? "closures connect it with a direct one" : "closures connect it with closure " + cause;
    case ClosureKind::merge:
      return "place recognition between two frames";
  }
  return "";
}

/// The other places of a merge that were accepted with one.
std::string other_places(const detail::Table<Index>& events, Index number) {
  std::string others;
  Index count = 0;
  for (Index k = events[number]; k < events.size(); ++k)
    if (events[k] == events[number] && k != number) {
      others += (others.empty() ? "" : ", ") + std::to_string(k);
      ++count;
    }
  return others.empty() ? "" : (count == 1 ? "place " : "places ") + others;
}

std::string outcome_of_kept(const LoopClosure& closure, const detail::Table<Index>& events, Index number) {
  const bool merge = closure.kind == ClosureKind::merge;
  switch (closure.verdict) {
    case ClosureVerdict::accepted: {
      const std::string others = merge ? other_places(events, number) : "";
      return others.empty() ? "accepted" : "accepted with " + others;
    }
    case ClosureVerdict::reverted:
      return merge ? "taken back: later places, fixes or closures contradicted the merge"
                   : "taken back with the merge that it rested on";
    default:
      return "rejected: " + name_of(closure.verdict);
  }
}

std::string outcome_of_refused(const LoopClosure& refusal) {
  std::string text = "refused: ";
  switch (refusal.verdict) {
    case ClosureVerdict::too_few_inliers:
      return text + name_of(refusal.verdict) + with_number(" (%.0f %% of the scan)", 100 * refusal.inlier_ratio);
    case ClosureVerdict::low_fitness:
      return text + name_of(refusal.verdict) + with_number(" (%.0f %% of the submap)", 100 * refusal.inlier_ratio);
    case ClosureVerdict::high_residual:
      return text + name_of(refusal.verdict) + with_number(" (%.3g m^2)", refusal.mean_squared_error);
    case ClosureVerdict::inconsistent:
      return text +
             (refusal.kind == ClosureKind::chained ? "contradicts the chain that led to it" : name_of(refusal.verdict));
    case ClosureVerdict::reverted:
      return text + "repeats what `chainslam undo` had removed";
    default:
      return text + name_of(refusal.verdict);
  }
}

}  // namespace

std::vector<ClosureAccount> closure_accounts(const SlamMap& map) {
  const auto session = [&](KeyframeId id) { return map.keyframes[static_cast<std::size_t>(id.value)].session; };
  const detail::Table<Index> events = merge_events(map);
  std::vector<ClosureAccount> accounts;
  const auto add = [&](const LoopClosure& closure, Index number, std::string outcome) {
    accounts.push_back(
        {number, &closure, session(closure.from), session(closure.to), why_tried(map, closure), std::move(outcome)});
  };
  for (std::size_t i = 0; i < map.closures.size(); ++i)
    add(map.closures[i], to_index(i), outcome_of_kept(map.closures[i], events, to_index(i)));
  for (const LoopClosure& refusal : map.refusals) add(refusal, -1, outcome_of_refused(refusal));
  return accounts;
}

}  // namespace chainslam::support
