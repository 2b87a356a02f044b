#pragma once

#include <optional>

#include "tasks/task_queue.hpp"

namespace chainslam::tasks {

/// What is heard of a task that runs.
struct TaskEvent {
  enum class Kind { progress, result, failure } kind = Kind::progress;
  Bytes bytes{};
};

/// Does one task at a time while its caller goes on. A result or a failure is the last event of each.
class TaskExecutor {
 public:
  TaskExecutor() = default;
  TaskExecutor(const TaskExecutor&) = delete;
  TaskExecutor& operator=(const TaskExecutor&) = delete;
  virtual ~TaskExecutor() = default;

  virtual void start(const Bytes& task) = 0;
  /// The next event; does not wait for one.
  [[nodiscard]] virtual std::optional<TaskEvent> poll() = 0;
  /// Ends the task that runs, if one does: no event follows.
  virtual void stop() = 0;
};

}  // namespace chainslam::tasks
