#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "support/frame_health.hpp"
#include "support/imu_calibration.hpp"
#include "support/odometry_failures.hpp"
#include "support/statistics.hpp"

namespace chainslam::support {

/// A bound that the configuration set, and what came out.
struct GoalResult {
  std::string name{};
  double bound = 0.0;
  double value = 0.0;
  bool met = false;
};

/// One session of the map.
struct SessionSummary {
  std::string name{};
  bool loaded = false;          ///< from a map that was saved before; it then has keyframes, but no scans
  Index frame = 0;              ///< number of the session in whose frame it lies: its own, until a merge joins it
  Index scans = 0;              ///< given to odometry
  Index frames = 0;             ///< answered by odometry
  Index lost_frames = 0;        ///< of these, without a match in the map
  Index degenerate_frames = 0;  ///< of these, with directions that the scan says nothing about
  Index keyframes = 0;
  double data_seconds = 0.0;  ///< time that the data spans
  double path_length = 0.0;   ///< metres
  /// "optimized.ape.translation.rmse", ... under an alignment of its own; each dot is a level
  std::map<std::string, double> errors{};
  /// "samples", "rejected.spikes", ...: samples of the IMU by what became of them; each dot is a level
  std::map<std::string, std::int64_t> imu{};
  std::optional<ImuCalibration> calibration{};  ///< if the session's IMU was compared with its scans
  std::vector<std::string> notes{};
  SessionHealth health{};                   ///< of its frames, also of those that a saved map has
  std::vector<OdometryFailure> failures{};  ///< steps of its odometry that the map contradicts

  /// Scans that odometry did not register: lost, or without a frame.
  [[nodiscard]] Index unregistered_scans() const { return std::max(scans, frames) - frames + lost_frames; }
  /// Of all scans; 0 to 1.
  [[nodiscard]] double lost_share() const {
    return scans > 0 ? static_cast<double>(unregistered_scans()) / std::max(scans, frames) : 0.0;
  }
};

/// The components of the adjacency graph, whose edges are the accepted closures. Keyframes without one are none.
struct ComponentSummary {
  Index count = 0;
  Index keyframes = 0;                 ///< in all of them
  Index largest = 0;                   ///< keyframes in the largest
  double widest = 0;                   ///< metres from the middle of one to a keyframe of it, at most
  std::map<Index, Index> histogram{};  ///< how many there are of each size
};

/// How far apart closures were sought, and how far they reach. The paper asks for v / f_lc > r_lc, so that components
/// of the adjacency graph stay as far apart as places are: the way from one search to the next is v / f_lc as it was.
struct SearchSpacing {
  double radius = 0;    ///< metres: r_lc
  Index intervals = 0;  ///< from one search to the next in the same session, without those of rechecks
  double mean = 0;      ///< metres along the path
  double shortest = 0;
  Index within_radius = 0;  ///< intervals that are no longer than the radius

  [[nodiscard]] bool kept() const { return intervals > 0 && mean > radius; }
};

/// @param spacing  metres along the path, of each interval.
[[nodiscard]] SearchSpacing search_spacing(const std::vector<double>& spacing, double radius);

/// What the back end did, and what each keyframe and each closure cost it.
struct BackEndSummary {
  Index optimizations = 0;
  Index failed_optimizations = 0;
  Index alignments = 0;          ///< scans registered to submaps, accepted or not
  Index keyframes = 0;           ///< added in this run
  Spread seconds{};              ///< per keyframe
  Spread keyframe_alignments{};  ///< registrations per keyframe
  Spread closure_alignments{};   ///< registrations per direct closure: its own and those of its chain
};

/// What a run came to, in figures that scripts can read.
struct RunSummary {
  std::string dataset{};
  bool interrupted = false;     ///< the data were not read to their end
  Index scans = 0;              ///< given to odometry
  Index frames = 0;             ///< answered by odometry
  Index lost_frames = 0;        ///< of these, without a match in the map
  Index degenerate_frames = 0;  ///< of these, with directions that the scan says nothing about
  Index keyframes = 0;
  std::vector<SessionSummary> sessions{};  ///< of the map, the loaded ones too
  Index merges = 0;                        ///< frames joined
  Index direct_closures = 0;
  Index chained_closures = 0;
  Index merge_closures = 0;
  std::map<std::string, Index> refusals{};                                 ///< by reason
  std::map<std::string, std::map<std::string, Index>> refusals_by_kind{};  ///< by kind of closure, then by reason
  ComponentSummary components{};
  SearchSpacing spacing{};
  BackEndSummary back_end{};
  double data_seconds = 0.0;      ///< time that the data spans, all sessions of this run
  double wall_seconds = 0.0;      ///< time that the run took
  double path_length = 0.0;       ///< metres, all sessions of this run
  std::uint64_t peak_memory = 0;  ///< bytes
  std::vector<StageTime> stages{};
  std::map<std::string, double> errors{};  ///< "optimized.ape.translation.rmse", ...; each dot is a level
  std::vector<GoalResult> goals{};
  std::vector<std::string> notes{};
};

/// Whether a run came to what was asked for, in words for its first line and its last.
struct Verdict {
  bool failed = false;                   ///< a goal was missed
  std::string headline{};                ///< "failed: 82 of 228 scans lost (36 %) ..."
  std::vector<std::string> sentences{};  ///< one for each session of the run that lost scans or restarted its local map
};

/// How a session lost its scans: "drive: 82 of 228 scans lost (36 %) from 12.3 s on, 7 restarts of the local map: the
/// map is not to be trusted there"; of a few scans, "the poses there are predicted". Empty if it lost none.
[[nodiscard]] std::string health_sentence(const SessionSummary& session);

/// Whether the paper's rule for closures held, by the way between searches and the components that came of it: "kept:
/// 18.2 m between two searches on average (16.1 m at least), radius 15 m; ..."; empty without two searches.
[[nodiscard]] std::string spacing_sentence(const RunSummary& summary);

[[nodiscard]] Verdict verdict_of(const RunSummary& summary);

/// The summary as JSON text: `verdict`, `sessions[].health.intervals[]`, `scans`, `keyframes`, `sessions[]`,
/// `closures.direct`, `closures.chained`, `closures.merge`, `refusals.<reason>`, `refusals_by_kind.<kind>.<reason>`,
/// `components`, `closure_spacing`, `back_end`, `sessions[].imu.rejected.<kind>`, `sessions[].imu.time_offset` and so
/// on as the settings take them, `sessions[].health.imu_use`, `stages.<name>.p50_ms`, `peak_memory_bytes`, `errors...`
/// and so on. A figure that is not finite is null.
[[nodiscard]] std::string summary_json(const RunSummary& summary);

/// Writes `summary_json` to a file that appears whole or not at all. @throws IoError
void write_summary(const FileTarget& target, const RunSummary& summary);

}  // namespace chainslam::support
