#include "support/session_joins.hpp"

#include <algorithm>
#include <cstddef>
#include <map>
#include <utility>

namespace chainslam::support {
namespace {

void count(const LoopClosure& closure, SessionJoin& join) {
  const bool merge = closure.kind == ClosureKind::merge;
  switch (closure.verdict) {
    case ClosureVerdict::accepted:
      ++(merge ? join.places : closure.kind == ClosureKind::direct ? join.direct : join.chained);
      break;
    case ClosureVerdict::reverted:
      ++(merge ? join.reverted_places : join.reverted);
      break;
    default:
      ++join.rejected;
  }
}

void count_refused(const LoopClosure& refusal, SessionJoin& join) {
  if (refusal.kind != ClosureKind::merge) return;
  if (refusal.verdict == ClosureVerdict::unconfirmed)
    ++join.unconfirmed;
  else if (refusal.verdict == ClosureVerdict::against_fixes)
    ++join.against_fixes;
  else
    ++join.not_found;
}

std::string counted(Index count, const std::string& thing) {
  return std::to_string(count) + ' ' + thing + (count == 1 ? "" : "s");
}

}  // namespace

std::vector<SessionJoin> session_joins(const SlamMap& map) {
  std::map<std::pair<SessionId, SessionId>, SessionJoin> joins;
  const auto add = [&](const std::vector<LoopClosure>& closures, auto&& count_one) {
    for (const LoopClosure& closure : closures) {
      const SessionId from = map.keyframes[static_cast<std::size_t>(closure.from.value)].session;
      const SessionId to = map.keyframes[static_cast<std::size_t>(closure.to.value)].session;
      if (from == to) continue;
      SessionJoin& join = joins[{std::min(from, to), std::max(from, to)}];
      join.first = std::min(from, to);
      join.second = std::max(from, to);
      count_one(closure, join);
    }
  };
  add(map.closures, count);
  add(map.refusals, count_refused);
  std::vector<SessionJoin> list;
  for (const auto& [sessions, join] : joins) list.push_back(join);
  return list;
}

std::string evidence_of(const SessionJoin& join) {
  if (!join.connected()) return "nothing";
  return counted(join.places, "place") + ", " + std::to_string(join.direct) + " direct, " +
         std::to_string(join.chained) + " chained closures";
}

std::string doubts_of(const SessionJoin& join) {
  std::string text;
  const auto add = [&](Index number, const std::string& words) {
    if (number > 0) text += (text.empty() ? "" : ", ") + words;
  };
  add(join.rejected, counted(join.rejected, "closure") + " rejected");
  add(join.reverted_places + join.reverted,
      counted(join.reverted_places, "place") + " and " + counted(join.reverted, "closure") + " reverted");
  add(join.unconfirmed, counted(join.unconfirmed, "place") + " unconfirmed");
  add(join.against_fixes, counted(join.against_fixes, "place") + " against the fixes");
  add(join.not_found, counted(join.not_found, "place") + " not recognized");
  return text;
}

}  // namespace chainslam::support
