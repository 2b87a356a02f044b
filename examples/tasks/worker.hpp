#pragma once

#include <chrono>
#include <functional>

#include "tasks/task_executor.hpp"
#include "tasks/transport.hpp"

namespace chainslam::tasks {

/// How long the processes of a job wait for each other.
struct Timing {
  std::chrono::milliseconds poll{5};
  std::chrono::milliseconds alive{1000};         ///< from one sign of life to the next
  std::chrono::milliseconds worker_lost{15000};  ///< without one: the worker's task is given to another
  std::chrono::milliseconds job_lost{60000};     ///< without one from the process that gives tasks: the worker ends
};

/// The message that tells process 0 of an event.
[[nodiscard]] inline MessageKind message_kind(TaskEvent::Kind event) {
  switch (event) {
    case TaskEvent::Kind::progress:
      return MessageKind::progress;
    case TaskEvent::Kind::result:
      return MessageKind::result;
    case TaskEvent::Kind::failure:
      break;
  }
  return MessageKind::failure;
}

/// How a worker ended.
enum class WorkerEnd {
  quit,       ///< the job is done
  abandoned,  ///< the job is done, and another worker was lost: nothing may wait for all
  job_lost    ///< process 0 was lost
};

/// Does the tasks that come from process 0, until that says that the job is done.
/// @param leaves  asked often: whether the worker is to take no more tasks, and to end the one that it has.
[[nodiscard]] WorkerEnd serve(Transport& transport, TaskExecutor& executor, const std::function<bool()>& leaves,
                              const Timing& timing = {});

}  // namespace chainslam::tasks
