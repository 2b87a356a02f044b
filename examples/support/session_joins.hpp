#pragma once

#include <string>
#include <vector>

#include "chainslam/slam/slam_map.hpp"

namespace chainslam::support {

/// What connects two sessions, and what was tried to: read off a map's closures and refusals.
struct SessionJoin {
  SessionId first{}, second{};    ///< in this order
  Index places = 0;               ///< at which they were found to meet: merge closures that count
  Index direct = 0, chained = 0;  ///< other closures between them that count
  Index rejected = 0;             ///< closures that contradict the map
  Index reverted_places = 0;      ///< of merges that were taken back,
  Index reverted = 0;             ///< and other closures that went with them
  Index unconfirmed = 0;          ///< places that nothing else agreed with
  Index against_fixes = 0;        ///< places that the GNSS fixes contradicted
  Index not_found = 0;            ///< attempts at a place that found none

  /// Whether anything that counts connects them.
  [[nodiscard]] bool connected() const { return places + direct + chained > 0; }
};

/// Each two sessions that something was found or tried between, in their order.
[[nodiscard]] std::vector<SessionJoin> session_joins(const SlamMap& map);

/// "2 places, 30 direct, 4 chained closures"; "nothing" if they are not connected.
[[nodiscard]] std::string evidence_of(const SessionJoin& join);
/// "3 closures rejected, 2 places and 5 closures reverted, 1 place unconfirmed"; empty if there is nothing to say.
[[nodiscard]] std::string doubts_of(const SessionJoin& join);

}  // namespace chainslam::support
