#include "recorded_sessions.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <string_view>
#include <system_error>
#include <thread>
#include <utility>

#include "datasets/odometry_recording.hpp"
#include "options.hpp"
#include "session_front_end.hpp"

namespace chainslam::mpi {

namespace fs = std::filesystem;

namespace {

constexpr const char* lock_name = "lock";

Index number_in(const tasks::Bytes& bytes) {
  Index number = 0;
  std::from_chars(bytes.data(), bytes.data() + bytes.size(), number);
  return number;
}

/// What a run says of a session whose task has failed as often as it is tried.
IoError error_for(const tasks::Bytes& reason, const std::string& data) {
  if (auto error = error_of(reason)) return *error;
  return {IoError::Kind::output,
          {data, "odometry", "tried several times, at last: " + reason,
           "give the machines more memory, or start fewer processes on each; the same command continues with the "
           "sessions that are done"}};
}

/// As it can be opened from any folder and on any machine that has it.
std::string openable_anywhere(const fs::path& given) {
  constexpr std::string_view simulated = "simulate:";
  const std::string text = given.string();
  if (!text.starts_with(simulated)) return fs::absolute(given).string();
  const fs::path folder = text.substr(simulated.size());
  std::error_code error;
  return fs::is_directory(folder, error) ? std::string(simulated) + fs::absolute(folder).string() : text;
}

/// Waits until a recording of another machine is seen here: network file systems show it some seconds late.
void await_files(const fs::path& set) {
  const auto patience = std::chrono::steady_clock::now() + std::chrono::minutes(2);
  while (!datasets::is_recorded_odometry(set)) {
    if (std::chrono::steady_clock::now() > patience)
      throw_input_error(set.string(), "", "no recording, though another machine has written it there",
                        "give an --out in a folder that all machines share, under the same path");
    std::error_code ignored;
    static_cast<void>(fs::directory_iterator(set.parent_path(), ignored));  // makes the system ask again
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
}

/// Folders of recordings that were not completed: of processes that were killed.
void remove_incomplete(const fs::path& folder) {
  std::error_code error;
  std::vector<fs::path> found;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error))
    if (entry->is_directory(error) && entry->path().filename().string().find(".partial") != std::string::npos)
      found.push_back(entry->path());
  for (const fs::path& path : found) fs::remove_all(path, error);
}

}  // namespace

RecordedSessions::~RecordedSessions() {
  if (folder_.empty()) return;
  coordinator_.end();
  if (const std::size_t done = finished(); done > 0) {
    std::fprintf(stderr, "note: odometry of %zu of %zu sessions is kept in %s: the same command continues with it\n",
                 done, sessions_.size(), printable(folder_.native()).c_str());
  } else {
    std::error_code ignored;
    fs::remove(folder_ / lock_name, ignored);
    fs::remove(folder_, ignored);  // only if nothing is in it
  }
  ::close(lock_);
}

void RecordedSessions::make_folder(const fs::path& out) {
  fs::path folder = out;
  folder += ".sessions";
  const auto fail = [&](const std::string& found, const char* remedy) {
    throw_output_error(folder.string(), "", found, remedy);
  };
  std::error_code error;
  fs::create_directory(folder, error);
  if (error) fail(error.message(), "choose a folder that you may write to");
  lock_ = ::open((folder / lock_name).c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
  if (lock_ < 0) fail(std::generic_category().message(errno), "choose a folder that you may write to");
  if (::flock(lock_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
    ::close(lock_);
    fail("another run has it", "wait for its end, or give another --out");
  }
  folder_ = folder;
  remove_incomplete(folder_);
}

RecordedSessions::Session RecordedSessions::described(const datasets::Dataset& dataset, const fs::path& given,
                                                      const mapper::MappingRun& run) const {
  Session session;
  session.name = dataset.info().name;
  session.scans = mapper::expected_scans(dataset.info(), run.max_scans);
  SessionTask& task = session.task;
  task.data = openable_anywhere(given);
  task.configuration = mapper::configuration_text(run.options);
  task.input = input_of(task.data, task.configuration, run.max_scans);
  task.set = folder_ / name_of_set(session.name, task.input);
  task.max_scans = run.max_scans;
  const auto cores = to_index(std::max(1U, std::thread::hardware_concurrency()));
  task.threads = run.threads == cores ? 0 : run.threads;
  task.max_memory = run.max_memory;
  return session;
}

void RecordedSessions::begin(std::vector<std::unique_ptr<datasets::Dataset>>& datasets, std::span<const fs::path> given,
                             const mapper::MappingRun& run, const fs::path& out) {
  make_folder(out);
  std::vector<tasks::Bytes> tasks;
  for (auto& dataset : datasets) {
    if (dataset->info().has_odometry) {
      sessions_.push_back(nullptr);
      continue;
    }
    sessions_.push_back(std::make_unique<Session>(described(*dataset, given[sessions_.size()], run)));
    Session& session = *sessions_.back();
    session.result = finished_session(session.task.set, session.task.input);
    if (!session.result) {
      session.number = to_index(tasks.size());
      tasks.push_back(bytes_of(session.task));
    }
    dataset = std::make_unique<RemoteSession>(std::move(dataset), run.options.dataset, run.options.keyframes,
                                              [this, &session, &run] { return await(session, run); });
  }
  if (const std::size_t done = finished(); done > 0)
    std::fprintf(stderr, "note: odometry of %zu of %zu sessions is there from a run before\n", done, sessions_.size());
  coordinator_.begin(std::move(tasks));
}

std::optional<RemoteSession::Recorded> RecordedSessions::await(Session& session, const mapper::MappingRun& run) {
  if (!session.result) {
    const auto measurement = run.times.measure("waiting for odometry");
    const auto outcome = coordinator_.await(session.number, run.stop, [&] { show_progress(run); });
    if (!outcome) return std::nullopt;
    if (outcome->failed) throw error_for(outcome->bytes, session.task.data);
    session.result = result_of(outcome->bytes);
    if (session.result->frames > 0) await_files(session.task.set);
  }
  if (session.result->run.failure) coordinator_.drop_from(session.number + 1);  // the run ends with this session
  return RemoteSession::Recorded{session.task.set, *session.result};
}

void RecordedSessions::show_progress(const mapper::MappingRun& run) {
  for (const std::string& note : coordinator_.take_notes()) run.progress.warning(note);
  support::ProgressState state{.stage = "odometry of " + std::to_string(sessions_.size()) + " sessions"};
  const std::vector<tasks::Bytes> progress = coordinator_.progress();
  for (const auto& session : sessions_) {
    if (!session) continue;
    const tasks::Bytes heard =
        session->number < 0 ? tasks::Bytes() : progress[static_cast<std::size_t>(session->number)];
    const bool is_result = heard.starts_with('{');
    const Index scans = session->result ? session->result->run.scans
                        : is_result     ? result_of(heard).run.scans
                                        : number_in(heard);
    state.done += scans;
    state.total += std::max(scans, session->scans);
  }
  run.progress.update(state);
}

std::size_t RecordedSessions::finished() const {
  return static_cast<std::size_t>(std::ranges::count_if(sessions_, [](const auto& session) {
    return session && finished_session(session->task.set, session->task.input).has_value();
  }));
}

void RecordedSessions::complete(std::size_t number, mapper::SessionRun& run) {
  const Session* session = sessions_.at(number).get();
  // Of a run that was interrupted, the last session is not all that was recorded.
  if (session == nullptr || !session->result || std::cmp_not_equal(run.odometry.size(), session->result->frames))
    return;
  const mapper::SessionRun& recorded = session->result->run;
  run.scans = recorded.scans;
  run.imu = recorded.imu;
  run.calibration = recorded.calibration;
  run.notes.insert(run.notes.begin(), recorded.notes.begin(), recorded.notes.end());
}

void RecordedSessions::map_saved() {
  std::error_code error;
  fs::remove_all(folder_, error);
  folder_.clear();
  ::close(lock_);
}

}  // namespace chainslam::mpi
