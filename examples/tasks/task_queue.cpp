#include "tasks/task_queue.hpp"

#include <algorithm>
#include <utility>

namespace chainslam::tasks {

namespace {

bool contains(std::span<const int> workers, int worker) {
  return std::find(workers.begin(), workers.end(), worker) != workers.end();
}

}  // namespace

TaskQueue::TaskQueue(std::vector<Bytes> tasks, int max_attempts) : max_attempts_(max_attempts) {
  for (Bytes& task : tasks) entries_.push_back({.task = std::move(task)});
}

std::optional<Index> TaskQueue::take(int worker, std::span<const int> live) {
  for (Index number = 0; number < size(); ++number) {
    Entry& entry = at(number);
    if (entry.outcome || !entry.workers.empty()) continue;
    const bool others = std::ranges::any_of(live, [&](int other) { return !contains(entry.failed, other); });
    if (contains(entry.failed, worker) && others) continue;
    entry.workers.push_back(worker);
    return number;
  }
  return std::nullopt;
}

void TaskQueue::finish(Index number, int worker, Bytes result) {
  Entry& entry = at(number);
  std::erase(entry.workers, worker);
  if (!entry.outcome) entry.outcome = TaskOutcome{.failed = false, .bytes = std::move(result)};
}

void TaskQueue::fail(Index number, int worker, Bytes reason) {
  Entry& entry = at(number);
  if (std::erase(entry.workers, worker) == 0 || entry.outcome) return;
  entry.failed.push_back(worker);
  if (std::cmp_greater_equal(entry.failed.size(), max_attempts_))
    entry.outcome = TaskOutcome{.failed = true, .bytes = std::move(reason)};
}

void TaskQueue::lose(int worker, const Bytes& reason) {
  for (Index number = 0; number < size(); ++number) fail(number, worker, reason);
}

void TaskQueue::drop_from(Index number, const Bytes& reason) {
  for (; number < size(); ++number)
    if (Entry& entry = at(number); !entry.outcome) entry.outcome = TaskOutcome{.failed = true, .bytes = reason};
}

Index TaskQueue::done() const {
  return to_index(std::ranges::count_if(entries_, [](const Entry& entry) { return entry.outcome.has_value(); }));
}

}  // namespace chainslam::tasks
