#include "tasks/worker.hpp"

#include <optional>
#include <thread>
#include <utility>

namespace chainslam::tasks {

namespace {

using Clock = std::chrono::steady_clock;

class Worker {
 public:
  Worker(Transport& transport, TaskExecutor& executor, const Timing& timing)
      : transport_(transport), executor_(executor), timing_(timing) {}

  /// @returns how the worker ends, if it does.
  [[nodiscard]] std::optional<WorkerEnd> take_messages() {
    while (const auto received = transport_.receive()) {
      heard_ = Clock::now();
      switch (received->message.kind) {
        case MessageKind::task:
          start(received->message);
          break;
        case MessageKind::stop:
          end_task();
          break;
        case MessageKind::quit:
          return WorkerEnd::quit;
        case MessageKind::abandon:
          return WorkerEnd::abandoned;
        default:
          break;
      }
    }
    if (Clock::now() - heard_ > timing_.job_lost) return WorkerEnd::job_lost;
    return std::nullopt;
  }

  void pass_events() {
    while (const auto event = task_ >= 0 ? executor_.poll() : std::nullopt) {
      const bool last = event->kind != TaskEvent::Kind::progress;
      say({message_kind(event->kind), last ? std::exchange(task_, -1) : task_, event->bytes});
    }
  }

  void show_life() {
    if (Clock::now() - said_ >= timing_.alive) say({left_ ? MessageKind::leave : MessageKind::alive});
  }

  void leave() {
    if (std::exchange(left_, true)) return;
    end_task();
    say({MessageKind::leave});
  }

  void end_task() {
    executor_.stop();
    task_ = -1;
  }

 private:
  void start(const Message& message) {
    if (left_) return say({MessageKind::leave});
    end_task();
    task_ = message.task;
    executor_.start(message.bytes);
  }

  void say(const Message& message) {
    transport_.send(0, message);
    said_ = Clock::now();
  }

  Transport& transport_;
  TaskExecutor& executor_;
  const Timing& timing_;
  Index task_ = -1;
  bool left_ = false;
  Clock::time_point heard_ = Clock::now(), said_{};
};

}  // namespace

WorkerEnd serve(Transport& transport, TaskExecutor& executor, const std::function<bool()>& leaves,
                const Timing& timing) {
  Worker worker(transport, executor, timing);
  for (;;) {
    if (const auto end = worker.take_messages()) {
      worker.end_task();
      return *end;
    }
    if (leaves()) worker.leave();
    worker.pass_events();
    worker.show_life();
    std::this_thread::sleep_for(timing.poll);
  }
}

}  // namespace chainslam::tasks
