#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam::tasks {

/// What a task is made of, and its result; what is in them is between whoever gives tasks and whoever does them.
using Bytes = std::string;

/// What came of a task.
struct TaskOutcome {
  bool failed = false;
  Bytes bytes;  ///< the result; of a task that failed, what its last attempt said
};

/// Tasks in the order in which their results are needed, and who works on each. A task whose worker fails or is lost
/// waits again, for another worker where there is one, until it has failed `max_attempts` times.
///
/// Which worker does a task, and when, does not show in what comes of it, if the tasks' results do not depend on it.
/// For one thread.
class TaskQueue {
 public:
  explicit TaskQueue(std::vector<Bytes> tasks = {}, int max_attempts = 3);

  /// The first task that waits and may be given to `worker`, which then has it: one that failed there is given again
  /// only if it failed for each of `live`. @returns nothing if there is none.
  [[nodiscard]] std::optional<Index> take(int worker, std::span<const int> live);
  [[nodiscard]] const Bytes& task(Index number) const { return at(number).task; }

  /// A worker's result, also if the worker had been taken for lost. The first one counts.
  void finish(Index number, int worker, Bytes result);
  void fail(Index number, int worker, Bytes reason);
  /// All that a worker has fails.
  void lose(int worker, const Bytes& reason);
  /// No task from this one on is given any more; what waits then fails for this reason.
  void drop_from(Index number, const Bytes& reason);

  /// Nothing as long as the task waits or a worker has it.
  [[nodiscard]] const std::optional<TaskOutcome>& outcome(Index number) const { return at(number).outcome; }
  [[nodiscard]] Index size() const { return to_index(entries_.size()); }
  [[nodiscard]] Index done() const;

 private:
  struct Entry {
    Bytes task;
    std::vector<int> workers{};  ///< that have it
    std::vector<int> failed{};   ///< that had it, once for each time
    std::optional<TaskOutcome> outcome{};
  };
  [[nodiscard]] const Entry& at(Index number) const { return entries_.at(static_cast<std::size_t>(number)); }
  [[nodiscard]] Entry& at(Index number) { return entries_.at(static_cast<std::size_t>(number)); }

  std::vector<Entry> entries_;
  int max_attempts_;
};

}  // namespace chainslam::tasks
