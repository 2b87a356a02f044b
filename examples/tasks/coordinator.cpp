#include "tasks/coordinator.hpp"

#include <algorithm>
#include <utility>

namespace chainslam::tasks {

namespace {

constexpr const char* not_needed = "not needed any more";

}  // namespace

Coordinator::Coordinator(Transport& transport, TaskExecutor& own, const Timing& timing)
    : transport_(transport), own_(own), timing_(timing), workers_(static_cast<std::size_t>(transport.size())) {
  workers_[0].live = true;
  thread_ = std::thread([this] { run(); });
}

Coordinator::~Coordinator() {
  {
    const std::lock_guard lock(mutex_);
    quit_ = true;
  }
  thread_.join();
}

void Coordinator::begin(std::vector<Bytes> tasks) {
  const std::lock_guard lock(mutex_);
  progress_.assign(tasks.size(), {});
  queue_ = TaskQueue(std::move(tasks));
}

std::optional<TaskOutcome> Coordinator::await(Index task, const std::stop_token& stop,
                                              const std::function<void()>& waiting) {
  std::unique_lock lock(mutex_);
  while (!queue_.outcome(task)) {
    if (failure_) std::rethrow_exception(failure_);
    if (stop.stop_requested()) return std::nullopt;
    if (waiting) {
      lock.unlock();
      waiting();
      lock.lock();
    }
    if (!queue_.outcome(task)) changed_.wait_for(lock, std::chrono::milliseconds(100));
  }
  return queue_.outcome(task);
}

std::vector<Bytes> Coordinator::progress() const {
  const std::lock_guard lock(mutex_);
  return progress_;
}

void Coordinator::drop_from(Index task) {
  const std::lock_guard lock(mutex_);
  queue_.drop_from(task, not_needed);
}

void Coordinator::end() {
  std::unique_lock lock(mutex_);
  queue_.drop_from(0, not_needed);
  changed_.wait(lock, [&] { return workers_[0].task < 0 || failure_; });
}

std::vector<std::string> Coordinator::take_notes() {
  const std::lock_guard lock(mutex_);
  return std::exchange(notes_, {});
}

bool Coordinator::lost_any() const {
  const std::lock_guard lock(mutex_);
  return std::ranges::any_of(workers_, [](const Worker& worker) {
    return !worker.live && !worker.left && worker.heard != Clock::time_point{};  // or it has not started yet
  });
}

void Coordinator::run() {
  try {
    for (;;) {
      {
        const std::lock_guard lock(mutex_);
        if (quit_) break;
        step();
      }
      changed_.notify_all();
      std::this_thread::sleep_for(timing_.poll);
    }
    own_.stop();
    const MessageKind end = lost_any() ? MessageKind::abandon : MessageKind::quit;
    for (int worker = 1; worker < transport_.size(); ++worker) transport_.send(worker, {end});
  } catch (...) {
    const std::lock_guard lock(mutex_);
    failure_ = std::current_exception();
  }
  changed_.notify_all();
}

void Coordinator::step() {
  while (const auto received = transport_.receive()) take(*received);
  take_own_events();
  find_lost();
  stop_unneeded();
  give();
  show_life();
}

void Coordinator::take(const ReceivedMessage& received) {
  const auto& [from, message] = received;
  Worker& worker = at(from);
  worker.heard = Clock::now();
  if (message.kind == MessageKind::leave) {
    if (!std::exchange(worker.left, true)) drop(from, "was asked to end");
    return;
  }
  if (!std::exchange(worker.live, true) && worker.task >= 0)
    notes_.push_back("process " + std::to_string(from) + " is back");
  switch (message.kind) {
    case MessageKind::progress:
      if (message.task < queue_.size() && message.task == worker.task)
        progress_[static_cast<std::size_t>(message.task)] = message.bytes;
      break;
    case MessageKind::result:
    case MessageKind::failure:
      end_task(from, message);
      break;
    default:
      break;
  }
}

void Coordinator::take_own_events() {
  Worker& own = workers_[0];
  while (const auto event = own.task >= 0 ? own_.poll() : std::nullopt)
    take({0, {message_kind(event->kind), own.task, event->bytes}});
}

void Coordinator::end_task(int from, const Message& message) {
  Worker& worker = at(from);
  if (message.task != worker.task) return;  // of a task that was stopped meanwhile
  worker.task = -1;
  if (message.kind == MessageKind::failure) {
    queue_.fail(message.task, from, message.bytes);
    return;
  }
  queue_.finish(message.task, from, message.bytes);
  progress_[static_cast<std::size_t>(message.task)] = message.bytes;
}

void Coordinator::find_lost() {
  const Clock::time_point now = Clock::now();
  for (int worker = 1; worker < transport_.size(); ++worker)
    if (at(worker).live && now - at(worker).heard > timing_.worker_lost) drop(worker, "does not answer");
}

/// What it has is given to another. Its number stays with it: a result may still come.
void Coordinator::drop(int number, const std::string& why) {
  Worker& worker = at(number);
  worker.live = false;
  const std::string note = "process " + std::to_string(number) + " " + why;
  notes_.push_back(note + (worker.task >= 0 ? ": its task is done again" : ""));
  queue_.lose(number, note);
  if (worker.left) worker.task = -1;
}

void Coordinator::stop_unneeded() {
  for (int number = 0; number < transport_.size(); ++number) {
    Worker& worker = at(number);
    if (worker.task < 0 || !worker.live || !queue_.outcome(worker.task)) continue;
    if (number == 0)
      own_.stop();
    else
      transport_.send(number, {MessageKind::stop, worker.task});
    worker.task = -1;
  }
}

void Coordinator::give() {
  std::vector<int> live;
  for (int number = 0; number < transport_.size(); ++number)
    if (at(number).live) live.push_back(number);
  for (const int number : live) {
    Worker& worker = at(number);
    if (worker.task >= 0) continue;
    const std::optional<Index> task = queue_.take(number, live);
    if (!task) continue;
    worker.task = *task;
    if (number == 0)
      own_.start(queue_.task(*task));
    else
      transport_.send(number, {MessageKind::task, *task, queue_.task(*task)});
  }
}

void Coordinator::show_life() {
  if (Clock::now() - said_ < timing_.alive) return;
  said_ = Clock::now();
  for (int number = 1; number < transport_.size(); ++number)
    if (const Worker& worker = at(number); worker.live || worker.left || worker.heard == Clock::time_point{})
      transport_.send(number, {MessageKind::alive});
}

}  // namespace chainslam::tasks
