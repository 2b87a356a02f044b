#pragma once

#include <condition_variable>
#include <exception>
#include <functional>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "tasks/task_executor.hpp"
#include "tasks/task_queue.hpp"
#include "tasks/transport.hpp"
#include "tasks/worker.hpp"

namespace chainslam::tasks {

/// Gives tasks to the workers of a job and to this process itself, on a thread of its own, which alone uses the
/// transport. Results are asked for by the task's number, in whatever order whoever needs them decides.
///
/// A worker that says nothing for `Timing::worker_lost` costs its task, which another does again; if the worker is
/// heard of after all, it gets tasks again, and what it did counts.
class Coordinator {
 public:
  /// @param own  does tasks of this process. All must outlive the object.
  Coordinator(Transport& transport, TaskExecutor& own, const Timing& timing = {});
  /// Ends all that runs; the workers quit, or abandon the job where one of them is lost.
  ~Coordinator();
  Coordinator(const Coordinator&) = delete;
  Coordinator& operator=(const Coordinator&) = delete;

  /// Starts with new tasks. Only when there are none, or the ones before have ended.
  void begin(std::vector<Bytes> tasks);
  /// Waits for a task. @param waiting  called some ten times a second.
  /// @returns nothing if a stop is requested before. @throws what the transport has thrown.
  [[nodiscard]] std::optional<TaskOutcome> await(Index task, const std::stop_token& stop,
                                                 const std::function<void()>& waiting = {});
  /// What was heard last of each task: its progress, its result, or nothing.
  [[nodiscard]] std::vector<Bytes> progress() const;
  /// No task from this one on is needed.
  void drop_from(Index task);
  /// No task is needed any more. Returns when this process does none; the others end soon.
  void end();
  /// What happened to workers since this was asked before, a line each.
  [[nodiscard]] std::vector<std::string> take_notes();
  /// Whether a worker is lost now: it may not answer any more.
  [[nodiscard]] bool lost_any() const;

 private:
  using Clock = std::chrono::steady_clock;
  struct Worker {
    bool live = false;  ///< gets tasks
    bool left = false;  ///< by its own wish
    Index task = -1;    ///< that it has
    Clock::time_point heard{};
  };

  void run();
  void step();
  void take(const ReceivedMessage& received);
  void take_own_events();
  void end_task(int worker, const Message& message);
  void find_lost();
  void drop(int worker, const std::string& why);
  void stop_unneeded();
  void give();
  void show_life();
  [[nodiscard]] Worker& at(int worker) { return workers_.at(static_cast<std::size_t>(worker)); }

  Transport& transport_;
  TaskExecutor& own_;
  const Timing timing_;
  mutable std::mutex mutex_;  ///< of all below
  std::condition_variable changed_;
  TaskQueue queue_;
  std::vector<Bytes> progress_;
  std::vector<Worker> workers_;  ///< by their number; 0: this process
  std::vector<std::string> notes_;
  std::exception_ptr failure_;
  bool quit_ = false;
  Clock::time_point said_{};
  std::thread thread_;
};

}  // namespace chainslam::tasks
