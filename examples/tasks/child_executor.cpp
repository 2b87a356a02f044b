#include "tasks/child_executor.hpp"

#include <fcntl.h>
#include <spawn.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <system_error>
#include <thread>
#include <utility>

extern char** environ;

namespace chainslam::tasks {

namespace {

constexpr std::size_t chunk = 1 << 16;

class Pipe {
 public:
  Pipe() {
    if (::pipe2(ends_.data(), O_CLOEXEC) != 0) throw std::system_error(errno, std::generic_category(), "a pipe");
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;
  ~Pipe() {
    for (const int end : ends_)
      if (end >= 0) ::close(end);
  }

  [[nodiscard]] int read_end() const { return ends_[0]; }
  [[nodiscard]] int write_end() const { return ends_[1]; }
  [[nodiscard]] int release_read_end() { return released(ends_[0]); }
  [[nodiscard]] int release_write_end() { return released(ends_[1]); }

 private:
  /// From now on the caller's, who reads or writes without waiting.
  static int released(int& end) {
    ::fcntl(end, F_SETFL, O_NONBLOCK);
    return std::exchange(end, -1);
  }

  std::array<int, 2> ends_{-1, -1};
};

::pid_t spawned(const std::vector<std::string>& command, int input, int output) {
  std::vector<std::string> words = command;
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t files;
  ::posix_spawn_file_actions_init(&files);
  ::posix_spawn_file_actions_adddup2(&files, input, STDIN_FILENO);
  ::posix_spawn_file_actions_adddup2(&files, output, STDOUT_FILENO);
  // A signal to this process and all that it has started would come twice, with the one of `stop`.
  posix_spawnattr_t attributes;
  ::posix_spawnattr_init(&attributes);
  ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);
  ::posix_spawnattr_setpgroup(&attributes, 0);
  ::pid_t process = -1;
  const int error = ::posix_spawn(&process, argv[0], &files, &attributes, argv.data(), environ);
  ::posix_spawnattr_destroy(&attributes);
  ::posix_spawn_file_actions_destroy(&files);
  if (error != 0) throw std::system_error(error, std::generic_category(), "starting " + command.front());
  return process;
}

std::string end_of(int status) {
  if (WIFSIGNALED(status)) {
    const int number = WTERMSIG(status);
    return "killed by signal " + std::to_string(number) + (number == SIGKILL ? ", perhaps for want of memory" : "");
  }
  return "ended with exit code " + std::to_string(WEXITSTATUS(status)) + ", without a result";
}

/// @returns its status; nothing if it still runs and `wait` is false.
std::optional<int> status_of(::pid_t process, bool wait) {
  int status = 0;
  ::pid_t got = 0;
  do got = ::waitpid(process, &status, wait ? 0 : WNOHANG);
  while (got < 0 && errno == EINTR);
  return got == 0 ? std::nullopt : std::optional(status);
}

}  // namespace

void ChildExecutor::start(const Bytes& task) {
  unread_.clear();
  last_.reset();
  try {
    Pipe input, output;
    process_ = spawned(command_, input.read_end(), output.write_end());
    input_ = input.release_write_end();
    output_ = output.release_read_end();
    unsent_ = task;
  } catch (const std::system_error& error) {  // too many processes or files
    last_ = TaskEvent{TaskEvent::Kind::failure, error.what()};
  }
}

/// A process that has closed its input gets no more: what it says, or how it ended, is heard all the same.
void ChildExecutor::write_input() {
  while (!unsent_.empty()) {
    const ssize_t written = ::write(input_, unsent_.data(), unsent_.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0 && errno == EAGAIN) return;
    unsent_.erase(0, written < 0 ? unsent_.size() : static_cast<std::size_t>(written));
  }
  ::close(std::exchange(input_, -1));
}

void ChildExecutor::read_output() {
  std::array<char, chunk> bytes{};
  for (;;) {
    const ssize_t got = ::read(output_, bytes.data(), bytes.size());
    if (got < 0 && errno == EINTR) continue;
    if (got > 0) {
      unread_.append(bytes.data(), static_cast<std::size_t>(got));
      continue;
    }
    if (got == 0 || errno != EAGAIN) close_pipes();
    return;
  }
}

std::optional<TaskEvent> ChildExecutor::poll() {
  if (process_ < 0) return std::exchange(last_, std::nullopt);
  if (input_ >= 0) write_input();
  if (output_ >= 0) read_output();
  for (auto end = unread_.find('\n'); end != std::string::npos; end = unread_.find('\n')) {
    const std::string line = unread_.substr(0, end);
    unread_.erase(0, end + 1);
    if (line.starts_with('p')) return TaskEvent{TaskEvent::Kind::progress, line.substr(1)};
    if (line.starts_with('r')) last_ = TaskEvent{TaskEvent::Kind::result, line.substr(1)};
    if (line.starts_with('f')) last_ = TaskEvent{TaskEvent::Kind::failure, line.substr(1)};
  }
  if (output_ >= 0) return std::nullopt;
  return ended();
}

/// Its output is at its end: so is the process, or it will be soon.
TaskEvent ChildExecutor::ended() {
  const std::optional<int> status = status_of(std::exchange(process_, -1), true);
  if (last_) return *std::exchange(last_, std::nullopt);
  return {TaskEvent::Kind::failure, end_of(*status)};
}

void ChildExecutor::stop() {
  last_.reset();
  if (process_ < 0) return;
  ::kill(process_, SIGTERM);
  const auto patience = std::chrono::steady_clock::now() + std::chrono::seconds(2);
  while (!status_of(process_, false)) {
    if (std::chrono::steady_clock::now() > patience) {
      ::kill(process_, SIGKILL);
      static_cast<void>(status_of(process_, true));
      break;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  process_ = -1;
  close_pipes();
}

void ChildExecutor::close_pipes() {
  for (int* end : {&input_, &output_})
    if (*end >= 0) ::close(std::exchange(*end, -1));
}

Bytes read_task() {
  Bytes task;
  std::array<char, chunk> bytes{};
  for (;;) {
    const ssize_t got = ::read(STDIN_FILENO, bytes.data(), bytes.size());
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) return task;
    task.append(bytes.data(), static_cast<std::size_t>(got));
  }
}

void end_with_parent() { ::prctl(PR_SET_PDEATHSIG, SIGKILL); }

}  // namespace chainslam::tasks
