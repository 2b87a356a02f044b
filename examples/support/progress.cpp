#include "support/progress.hpp"

#include <unistd.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <cmath>
#include <fstream>
#include <string>

#include "chainslam/core/error.hpp"

namespace chainslam::support {
namespace {

/// A figure of /proc/self/status, which states it in KiB.
std::uint64_t memory_figure(std::string_view name) {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);)
    if (line.starts_with(name)) return std::stoull(line.substr(name.size())) * 1024;
  return 0;
}

std::string fixed(double value, int decimals) {
  char buffer[64];
  std::snprintf(buffer, sizeof buffer, "%.*f", decimals, value);
  return buffer;
}

std::string time_left(double total_seconds) {
  const auto whole = static_cast<long long>(std::llround(total_seconds));
  if (whole < 60) return std::to_string(whole) + " s";
  if (whole < 3600) return std::to_string(whole / 60) + " min " + std::to_string(whole % 60) + " s";
  return std::to_string(whole / 3600) + " h " + std::to_string(whole % 3600 / 60) + " min";
}

std::string memory_text(std::uint64_t bytes) {
  const double mebibytes = static_cast<double>(bytes) / (1 << 20);
  return mebibytes < 1024 ? fixed(mebibytes, 0) + " MiB" : fixed(mebibytes / 1024, 1) + " GiB";
}

int tenths_done(const ProgressState& state) {
  return state.total > 0 ? static_cast<int>(10LL * state.done / state.total) : 0;
}

}  // namespace

std::uint64_t current_memory() { return memory_figure("VmRSS:"); }
std::uint64_t peak_memory() { return memory_figure("VmHWM:"); }
void return_free_memory() {
#ifdef __GLIBC__
  ::malloc_trim(0);
#endif
}

std::string progress_line(const ProgressState& state, double elapsed_seconds, std::uint64_t memory) {
  std::string line = state.stage;
  if (state.done > 0 || state.total > 0) line += " " + std::to_string(state.done);
  if (state.total > 0) line += "/" + std::to_string(state.total);
  if (state.data_seconds > 0 && elapsed_seconds > 0)
    line += " | " + fixed(state.data_seconds / elapsed_seconds, 1) + "x real time";
  if (state.done > 0 && state.total > state.done && elapsed_seconds > 1)
    line += " | " + time_left(elapsed_seconds * (state.total - state.done) / state.done) + " left";
  if (state.keyframes > 0) {
    line += " | " + std::to_string(state.keyframes) + " keyframes";
    line += " | closures " + std::to_string(state.direct_closures) + " direct + " +
            std::to_string(state.chained_closures) + " chained";
  }
  if (memory > 0) line += " | " + memory_text(memory);
  return line;
}

Progress::Progress(std::FILE* stream, std::optional<bool> terminal)
    : stream_(stream), terminal_(terminal.value_or(isatty(fileno(stream)) != 0)) {}

void Progress::update(const ProgressState& state, Clock::time_point now) {
  if (!started_ || state.stage != state_.stage) {
    finish(now);
    started_ = true;
    stage_start_ = now;
    tenths_shown_ = -1;
    last_shown_ = {};
  }
  state_ = state;
  shown_last_ = false;
  constexpr auto renewal = std::chrono::milliseconds(100);
  if (terminal_ ? now - last_shown_ >= renewal : tenths_done(state_) > tenths_shown_) show(now);
}

void Progress::warning(std::string_view text) {
  clear_line();
  std::fprintf(stream_, "warning: %s\n", printable(text).c_str());
  std::fflush(stream_);
}

void Progress::finish(Clock::time_point now) {
  if (!started_) return;
  if (!shown_last_) show(now);
  if (line_open_) std::fputc('\n', stream_);
  std::fflush(stream_);
  line_open_ = false;
  started_ = false;
}

void Progress::show(Clock::time_point now) {
  const double elapsed = std::chrono::duration<double>(now - stage_start_).count();
  clear_line();
  std::string line = printable(progress_line(state_, elapsed, current_memory()));
  if (!terminal_) line += '\n';
  std::fputs(line.c_str(), stream_);
  std::fflush(stream_);
  line_open_ = terminal_;
  last_shown_ = now;
  tenths_shown_ = tenths_done(state_);
  shown_last_ = true;
}

void Progress::clear_line() {
  if (line_open_) std::fputs("\r\x1b[K", stream_);
  line_open_ = false;
}

}  // namespace chainslam::support
