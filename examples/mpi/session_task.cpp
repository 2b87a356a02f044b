#include "session_task.hpp"

#define XXH_INLINE_ALL  // the library of Debian is not linked
#include <xxhash.h>

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cstdio>
#include <iterator>
#include <memory>
#include <utility>

#include "build_description.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/detail/input_stream.hpp"
#include "datasets/odometry_recording.hpp"
#include "output.hpp"
#include "saved_settings.hpp"
#include "session_recorder.hpp"
#include "simulated_dataset.hpp"
#include "support/progress.hpp"
#include "support/statistics.hpp"

namespace chainslam::mpi {

namespace fs = std::filesystem;

namespace {

// Beside the recording in its folder: of what it was made, and the session's result.
constexpr const char* input_name = "input.txt";
constexpr const char* result_name = "result.json";

void write_text(const fs::path& path, const std::string& text) {
  AtomicFile file(path);
  file.write(text);
  file.commit();
}

std::optional<std::string> text_of(const fs::path& path) {
  std::error_code error;
  if (!fs::is_regular_file(path, error)) return std::nullopt;
  auto file = detail::input_stream(path);
  return std::string(std::istreambuf_iterator<char>(file), {});
}

/// Number, size and newest date of the files of a data set.
std::string files_of(const fs::path& data) {
  std::uintmax_t count = 0, bytes = 0;
  fs::file_time_type newest = fs::file_time_type::min();
  std::error_code error;
  const auto add = [&](const fs::path& file) {
    ++count;
    bytes += fs::file_size(file, error);
    newest = std::max(newest, fs::last_write_time(file, error));
  };
  if (fs::is_regular_file(data, error)) add(data);
  for (fs::recursive_directory_iterator entry(data, fs::directory_options::follow_directory_symlink, error), end;
       !error && entry != end; entry.increment(error))
    if (entry->is_regular_file(error)) add(entry->path());
  return std::to_string(count) + " files, " + std::to_string(bytes) + " bytes, newest " +
         std::to_string(std::chrono::nanoseconds(newest.time_since_epoch()).count());
}

/// Nothing is shown but what is passed on.
class NoStream {
 public:
  NoStream() : file_(std::fopen("/dev/null", "w")) {}
  NoStream(const NoStream&) = delete;
  NoStream& operator=(const NoStream&) = delete;
  ~NoStream() {
    if (file_ != nullptr) std::fclose(file_);
  }
  [[nodiscard]] std::FILE* file() const { return file_ != nullptr ? file_ : stderr; }

 private:
  std::FILE* file_;
};

}  // namespace

std::string input_of(const std::string& data, const std::string& configuration, Index max_scans) {
  const fs::path folder = data.starts_with("simulate:") ? data.substr(data.find(':') + 1) : data;
  return mapper::build_description() + "\n" + data + "\n" + files_of(folder) + "\nscans " + std::to_string(max_scans) +
         "\n" + configuration;
}

std::string name_of_set(const std::string& session, const std::string& input) {
  char hash[20];
  std::snprintf(hash, sizeof hash, "%016llx", static_cast<unsigned long long>(XXH3_64bits(input.data(), input.size())));
  std::string name = session.substr(0, 100);
  std::ranges::replace_if(
      name, [](unsigned char c) { return std::isalnum(c) == 0 && c != '-' && c != '_'; }, '_');
  return name + "-" + hash;
}

std::optional<SessionResult> finished_session(const fs::path& set, const std::string& input) {
  if (text_of(set / input_name) != input) return std::nullopt;
  const std::optional<std::string> text = text_of(set / result_name);
  if (!text) return std::nullopt;
  SessionResult result = result_of(*text);
  if (result.run.failure) return std::nullopt;  // the disk or the data may have been repaired
  return result;
}

std::unique_ptr<datasets::Dataset> open_session(const std::string& data, const datasets::DatasetOptions& options) {
  auto simulated = mapper::open_simulation(data);
  return simulated ? std::move(simulated) : datasets::open_dataset(data, options);
}

SessionResult record_session(const SessionTask& task, const std::function<void(Index, Index)>& show) {
  if (auto finished = finished_session(task.set, task.input)) return std::move(*finished);
  const mapper::MapperOptions options =
      mapper::saved_settings(task.configuration, "settings", "start the same program on all machines").options;
  const auto dataset = open_session(task.data, options.dataset);
  std::error_code ignored;
  fs::remove_all(task.set, ignored);  // data that could not be read to their end, before
  mapper::OutputFolder folder(task.set, false);
  folder.drop_all_unless_committed();
  const NoStream nothing;
  support::Progress progress(nothing.file(), false);
  support::StageTimes times;
  const mapper::MappingRun run{.options = options,
                               .threads = std::max(Index{1}, task.threads),
                               .max_scans = task.max_scans,
                               .max_memory = task.max_memory,
                               .progress = progress,
                               .times = times};
  datasets::OdometryRecording recording(folder.path());
  mapper::MappingResult recorded = mapper::record_odometry(
      *dataset, run, recording, [&](const support::ProgressState& state) { show(state.done, state.total); });
  if (recorded.memory_full)
    throw_output_error(task.data, "memory",
                       "more than " + std::to_string(task.max_memory / 1'000'000) + " MB in use (--max-memory)",
                       "allow more, or start fewer processes on a machine");
  SessionResult result{.run = std::move(recorded.sessions[0]),
                       .warnings = dataset->info().warnings,
                       .frames = to_index(recorded.map->frames.size())};
  recording.finish(mapper::recording_info(dataset->info(), result.run, options), std::nullopt);
  write_text(folder.path() / result_name, bytes_of(result));
  write_text(folder.path() / input_name, task.input);
  folder.commit();
  return result;
}

}  // namespace chainslam::mpi
