#pragma once

#include <sys/types.h>

#include <optional>
#include <string>
#include <vector>

#include "tasks/task_executor.hpp"

namespace chainslam::tasks {

/// Does each task in a process of its own: whatever ends that, costs the task alone, and all memory goes back.
///
/// The process reads the task from its standard input, and writes lines to its standard output: `p` and how far it is,
/// at the end `r` and the result, or `f` and why there is none. What else ends it is a failure. SIGPIPE must be
/// ignored.
class ChildExecutor final : public TaskExecutor {
 public:
  /// @param command  the program, as a path, and its arguments
  explicit ChildExecutor(std::vector<std::string> command) : command_(std::move(command)) {}
  ~ChildExecutor() override { stop(); }

  void start(const Bytes& task) override;
  [[nodiscard]] std::optional<TaskEvent> poll() override;
  /// Asks the process to end (SIGTERM), and ends it (SIGKILL) if it has not after two seconds.
  void stop() override;

 private:
  void write_input();
  void read_output();
  [[nodiscard]] TaskEvent ended();
  void close_pipes();

  std::vector<std::string> command_;
  ::pid_t process_ = -1;
  int input_ = -1, output_ = -1;  ///< its own, seen from here
  Bytes unsent_;
  std::string unread_;
  std::optional<TaskEvent> last_;  ///< that it has written, not given yet
};

/// Reads a task from standard input, to its end.
[[nodiscard]] Bytes read_task();
/// Ends this process when its parent ends, also where that is killed.
void end_with_parent();

}  // namespace chainslam::tasks
