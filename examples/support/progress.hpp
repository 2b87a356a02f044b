#pragma once

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <string>
#include <string_view>

#include "chainslam/core/types.hpp"

namespace chainslam::support {

/// Resident memory of this process in bytes, now and at its highest; 0 where the system does not tell.
[[nodiscard]] std::uint64_t current_memory();
[[nodiscard]] std::uint64_t peak_memory();
/// Gives back what this process has freed and the allocator still holds, scattered between what is in use.
void return_free_memory();

/// Where a run stands.
struct ProgressState {
  std::string stage{};        ///< "mapping", "saving", ...
  Index done = 0;             ///< of `total`, in whatever the stage counts
  Index total = 0;            ///< 0 if unknown
  double data_seconds = 0.0;  ///< time that the data processed so far spans; 0 if it spans none
  Index keyframes = 0;
  Index direct_closures = 0;
  Index chained_closures = 0;
};

/// One line that says it all: stage, done / total, times real time, time left, keyframes, closures, memory.
/// @param elapsed_seconds  since the stage began.
/// @param memory           bytes; 0 leaves it out.
[[nodiscard]] std::string progress_line(const ProgressState& state, double elapsed_seconds, std::uint64_t memory);

/// Tells how a run goes: on a terminal one line that renews itself, otherwise a line for every 10 % of a stage.
class Progress {
 public:
  using Clock = std::chrono::steady_clock;

  /// @param terminal  overrides what the stream says of itself.
  explicit Progress(std::FILE* stream = stderr, std::optional<bool> terminal = std::nullopt);
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  ~Progress() { finish(); }

  /// Shows the state, if the line is old enough or the stage is new.
  void update(const ProgressState& state, Clock::time_point now = Clock::now());

  void warning(std::string_view text);

  /// Leaves the last line of the current stage standing.
  void finish(Clock::time_point now = Clock::now());

 private:
  void show(Clock::time_point now);
  void clear_line();

  std::FILE* stream_;
  bool terminal_;
  ProgressState state_;
  bool started_ = false;
  Clock::time_point stage_start_{};
  Clock::time_point last_shown_{};
  int tenths_shown_ = -1;
  bool line_open_ = false;   ///< the terminal's cursor stands behind a line of ours
  bool shown_last_ = false;  ///< the state that came last has been shown
};

}  // namespace chainslam::support
