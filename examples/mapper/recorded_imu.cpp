#include <algorithm>
#include <cmath>
#include <string>
#include <string_view>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/text.hpp"
#include "chainslam/io/input_file.hpp"
#include "recorded_input.hpp"
#include "support/configuration.hpp"

namespace chainslam::mapper {

namespace {

/// One interval as "FROM:TO".
std::optional<SkippedInterval> interval_of(const std::string& text) {
  const std::size_t colon = text.find(':');
  if (colon == std::string::npos) return std::nullopt;
  const auto from = detail::parse_double(std::string_view(text).substr(0, colon));
  const auto to = detail::parse_double(std::string_view(text).substr(colon + 1));
  if (!from || !to || !(*from < *to)) return std::nullopt;
  return SkippedInterval{*from, *to};
}

void read_intervals(const std::filesystem::path& path, const SimulateArguments& arguments,
                    const std::vector<Timestamp>& frame_times, std::vector<SkippedInterval>& intervals) {
  InputFile file(path);
  const std::string name = arguments.trajectory.filename().string();
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty() || text.starts_with('#')) continue;
    LineFields fields(file, text), count(file, text);
    int columns = 0;
    for (; count.more(); ++columns) static_cast<void>(count.text("row"));
    const bool named = columns == 3;
    if (named && !name.starts_with(fields.text("sequence"))) continue;
    if (named && frame_times.empty())
      file.fail(file.place_of_line(), "frames of a trajectory that has times of its own",
                "write rows `FROM TO` in seconds");
    SkippedInterval interval;
    interval.from = fields.number("from");
    interval.to = fields.number("to");
    fields.end("`FROM TO` in seconds, or `SEQUENCE FROM TO` in frames");
    if (named)
      for (double* end : {&interval.from, &interval.to})
        *end = to_seconds(time_of_frame(frame_times, *end) - Timestamp());
    intervals.push_back(interval);
  }
}

}  // namespace

Timestamp time_of_frame(const std::vector<Timestamp>& frame_times, double frame) {
  const double last = static_cast<double>(frame_times.size()) - 2.0;
  frame = std::clamp(frame, -1e6, last + 1e6);
  const double whole = std::clamp(std::floor(frame), 0.0, last);
  const auto i = static_cast<std::size_t>(whole);
  return frame_times[i] + seconds((frame - whole) * to_seconds(frame_times[i + 1] - frame_times[i]));
}

std::vector<SkippedInterval> read_skipped(const SimulateArguments& arguments,
                                          const std::vector<Timestamp>& frame_times) {
  std::vector<SkippedInterval> intervals;
  for (const std::string& text : arguments.skips) {
    if (const auto interval = interval_of(text))
      intervals.push_back(*interval);
    else if (std::filesystem::is_regular_file(text))
      read_intervals(text, arguments, frame_times, intervals);
    else
      throw support::ConfigError("--skip", "neither an interval nor a file", text,
                                 "write FROM:TO in seconds, such as 12.5:14, or name a file of intervals");
  }
  return intervals;
}

void read_recorded_imu(const SimulateArguments& arguments, const std::vector<Timestamp>& frame_times,
                       const std::vector<SkippedInterval>& skipped, RecordedInput& input) {
  InputFile file(arguments.imu);
  const auto header = file.read_line();
  const std::string_view first = header ? header->substr(0, header->find(',')) : std::string_view();
  const bool frames = first == "nominal_frame";
  if (!frames && first != "timestamp")
    file.fail("line 1", header ? "a header that begins with " + std::string(first) : "an empty file",
              "write the header timestamp,gx,gy,gz,ax,ay,az (seconds, rad/s, m/s^2)");
  if (frames && frame_times.empty())
    file.fail("line 1", "nominal_frame, beside a trajectory with times of its own",
              "give the frames' poses as KITTI's rows, with --times or --rate");
  // Samples a little before and after the scans tell an estimator where they begin.
  const Timestamp start = std::max(Timestamp(), input.trajectory.times.front() - seconds(1.0));
  const Timestamp end = input.trajectory.times.back() + seconds(1.0);
  std::size_t inside = 0;
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty()) continue;
    LineFields fields(file, text, ',');
    ImuSample sample;
    sample.time =
        frames ? time_of_frame(frame_times, fields.number("nominal_frame")) : fields.time_in_seconds("timestamp");
    sample.time = sample.time + seconds(arguments.imu_offset);
    for (int axis = 0; axis < 3; ++axis) sample.gyro[axis] = fields.number("rate");
    for (int axis = 0; axis < 3; ++axis) sample.accel[axis] = fields.number("acceleration");
    fields.end("seven fields: time, rates, accelerations");
    const double time = to_seconds(sample.time - Timestamp());
    const bool skip = std::ranges::any_of(
        skipped, [&](const SkippedInterval& interval) { return time >= interval.from && time <= interval.to; });
    if (skip || sample.time < start || sample.time > end) {
      ++input.imu_dropped;
      continue;
    }
    if (!input.imu.empty() && sample.time <= input.imu.back().time)
      file.fail(file.place_of_line(), "a time that is not later than the one before it", "sort the rows by time");
    inside += sample.time >= input.trajectory.times.front() && sample.time <= input.trajectory.times.back() ? 1U : 0U;
    std::string row;
    detail::append_seconds(row, sample.time);
    input.imu_rows.push_back(row.append(text.substr(text.find(','))));
    input.imu.push_back(sample);
  }
  if (inside < 2)
    file.fail("", "no rows at the time of the trajectory",
              "give both on one clock, or the difference as --imu-offset SECONDS");
}

}  // namespace chainslam::mapper
