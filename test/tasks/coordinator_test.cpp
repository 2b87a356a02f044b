#include "tasks/coordinator.hpp"

#include <doctest/doctest.h>

#include <atomic>
#include <chrono>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "chainslam/core/random.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"
#include "tasks/worker.hpp"

// A job of threads: each has a mailbox, and an executor whose tasks take a random time and may fail.

namespace {

using namespace chainslam;
using namespace chainslam::tasks;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

/// The mailboxes of a job.
class Mail {
 public:
  explicit Mail(int size) : boxes_(static_cast<std::size_t>(size)), cut_(static_cast<std::size_t>(size)) {}

  void send(int from, int to, const Message& message) {
    const std::lock_guard lock(mutex_);
    if (cut_[static_cast<std::size_t>(from)] || cut_[static_cast<std::size_t>(to)]) return;
    boxes_[static_cast<std::size_t>(to)].push_back({from, message});
  }
  std::optional<ReceivedMessage> receive(int of) {
    const std::lock_guard lock(mutex_);
    auto& box = boxes_[static_cast<std::size_t>(of)];
    if (box.empty()) return std::nullopt;
    ReceivedMessage message = box.front();
    box.pop_front();
    return message;
  }
  /// Nothing comes from a process any more, and nothing reaches it, as if it had been killed.
  void cut(int process, bool cut = true) {
    const std::lock_guard lock(mutex_);
    cut_[static_cast<std::size_t>(process)] = cut;
  }
  [[nodiscard]] int size() const { return static_cast<int>(boxes_.size()); }

 private:
  std::mutex mutex_;
  std::vector<std::deque<ReceivedMessage>> boxes_;
  std::vector<bool> cut_;
};

class MailTransport final : public Transport {
 public:
  MailTransport(Mail& mail, int process) : mail_(mail), process_(process) {}
  [[nodiscard]] int size() const override { return mail_.size(); }
  void send(int to, const Message& message) override { mail_.send(process_, to, message); }
  [[nodiscard]] std::optional<ReceivedMessage> receive() override { return mail_.receive(process_); }

 private:
  Mail& mail_;
  int process_;
};

/// What the executors of a job share: how often a task fails, and who has tried it.
struct Work {
  std::mutex mutex{};
  std::map<Bytes, int> failures{};  ///< left, by task
  std::map<Bytes, std::vector<int>> tried{};
};

Bytes result_of(const Bytes& task) { return "result of " + task; }

class RandomExecutor final : public TaskExecutor {
 public:
  RandomExecutor(Work& work, int process, Rng rng, double max_ms)
      : work_(work), process_(process), rng_(rng), max_ms_(max_ms) {}

  void start(const Bytes& task) override {
    task_ = task;
    shown_ = false;
    end_ = Clock::now() + std::chrono::microseconds(static_cast<int>(1000 * rng_.uniform(0, max_ms_)));
    const std::lock_guard lock(work_.mutex);
    work_.tried[task].push_back(process_);
  }
  [[nodiscard]] std::optional<TaskEvent> poll() override {
    if (task_.empty()) return std::nullopt;
    if (!std::exchange(shown_, true)) return TaskEvent{TaskEvent::Kind::progress, "half of " + task_};
    if (Clock::now() < end_) return std::nullopt;
    const Bytes task = std::exchange(task_, {});
    const std::lock_guard lock(work_.mutex);
    if (int& left = work_.failures[task]; left > 0) {
      --left;
      return TaskEvent{TaskEvent::Kind::failure, "no luck with " + task};
    }
    return TaskEvent{TaskEvent::Kind::result, result_of(task)};
  }
  void stop() override { task_.clear(); }

 private:
  Work& work_;
  int process_;
  Rng rng_;
  double max_ms_;
  Bytes task_;
  bool shown_ = false;
  Clock::time_point end_{};
};

constexpr Timing quick_timing{.poll = milliseconds(1),
                              .alive = milliseconds(20),
                              .worker_lost = milliseconds(300),
                              .job_lost = milliseconds(20'000)};

/// Process 0, and a thread for each of the others.
class Job {
 public:
  Job(int size, Work& work, std::uint64_t seed, double max_ms, const Timing& timing = quick_timing)
      : mail(size), own_(work, 0, Rng(seed), max_ms), transport_(mail, 0), ends(static_cast<std::size_t>(size)) {
    for (int process = 1; process < size; ++process)
      workers_.emplace_back([this, process, &work, seed, max_ms, timing] {
        MailTransport transport(mail, process);
        RandomExecutor executor(work, process, Rng(seed).fork(static_cast<std::uint64_t>(process)), max_ms);
        ends[static_cast<std::size_t>(process)] = serve(
            transport, executor, [this, process] { return leaving == process; }, timing);
      });
    coordinator = std::make_unique<Coordinator>(transport_, own_, timing);
  }
  ~Job() { join(); }

  void join() {
    coordinator.reset();
    for (std::thread& worker : workers_)
      if (worker.joinable()) worker.join();
  }

  Mail mail;
  std::atomic<int> leaving = -1;
  std::unique_ptr<Coordinator> coordinator;

 private:
  RandomExecutor own_;
  MailTransport transport_;
  std::vector<std::thread> workers_;

 public:
  std::vector<WorkerEnd> ends;
};

std::vector<Bytes> job_of(int count) {
  std::vector<Bytes> tasks;
  for (int i = 0; i < count; ++i) tasks.push_back("task " + std::to_string(i));
  return tasks;
}

}  // namespace

TEST_SUITE("tasks/coordinator") {
  THREADS_TEST_CASE("tasks/coordinator", "results are the same for any number of processes, times and failures") {
    test::for_all(24, [](Rng& rng, int) {
      Work work;
      const auto tasks = job_of(1 + rng.uniform_index(12));
      for (const Bytes& task : tasks) work.failures[task] = rng.uniform_index(3);  // of three attempts
      Job job(1 + rng.uniform_index(4), work, rng.bits(), 4);
      job.coordinator->begin(tasks);
      for (std::size_t i = 0; i < tasks.size(); ++i) {
        const auto outcome = job.coordinator->await(static_cast<Index>(i), {});
        REQUIRE(outcome);
        CHECK(!outcome->failed);
        CHECK(outcome->bytes == result_of(tasks[i]));
      }
    });
  }

  THREADS_TEST_CASE("tasks/coordinator", "processes that are killed cost their tasks, which others do again") {
    Work work;
    Timing timing = quick_timing;
    timing.job_lost = milliseconds(2000);
    Job job(4, work, 1, 60, timing);
    const auto tasks = job_of(24);
    job.coordinator->begin(tasks);
    static_cast<void>(job.coordinator->await(0, {}));
    job.mail.cut(1);
    job.mail.cut(3);
    for (std::size_t i = 0; i < tasks.size(); ++i)
      CHECK(job.coordinator->await(static_cast<Index>(i), {})->bytes == result_of(tasks[i]));
    const auto notes = job.coordinator->take_notes();
    CHECK(notes.size() == 2);
    for (const std::string& note : notes) CHECK(note.find("does not answer") != std::string::npos);
    CHECK(job.coordinator->lost_any());
    job.join();
    CHECK(job.ends == std::vector{WorkerEnd::quit, WorkerEnd::job_lost, WorkerEnd::abandoned, WorkerEnd::job_lost});
  }

  THREADS_TEST_CASE("tasks/coordinator", "a process that was silent for a while is used again") {
    Work work;
    Job job(2, work, 2, 5);
    job.mail.cut(1);
    std::this_thread::sleep_for(milliseconds(500));
    job.mail.cut(1, false);
    const auto tasks = job_of(40);
    job.coordinator->begin(tasks);
    for (std::size_t i = 0; i < tasks.size(); ++i)
      CHECK(job.coordinator->await(static_cast<Index>(i), {})->bytes == result_of(tasks[i]));
    CHECK(!job.coordinator->lost_any());
    int by_the_other = 0;
    for (const auto& [task, processes] : work.tried) by_the_other += processes.back() == 1 ? 1 : 0;
    CHECK(by_the_other > 5);
  }

  THREADS_TEST_CASE("tasks/coordinator",
                    "a task that fails each time is tried by three processes, and says why at last") {
    Work work{.failures = {{"task 1", 100}}};
    Job job(4, work, 3, 10);
    job.coordinator->begin(job_of(3));
    const auto outcome = job.coordinator->await(1, {});
    REQUIRE(outcome);
    CHECK(outcome->failed);
    CHECK(outcome->bytes == "no luck with task 1");
    CHECK(!job.coordinator->await(2, {})->failed);
    job.join();
    std::vector<int> tried = work.tried["task 1"];
    CHECK(tried.size() == 3);
    std::sort(tried.begin(), tried.end());
    CHECK(std::unique(tried.begin(), tried.end()) == tried.end());
  }

  THREADS_TEST_CASE("tasks/coordinator",
                    "a process that is asked to end gives its task back, and stays to the job's end") {
    Work work;
    Job job(2, work, 4, 100);
    job.coordinator->begin(job_of(6));
    std::this_thread::sleep_for(milliseconds(60));
    job.leaving = 1;
    for (Index i = 0; i < 6; ++i) CHECK(!job.coordinator->await(i, {})->failed);
    CHECK(!job.coordinator->lost_any());
    job.join();
    CHECK(job.ends[1] == WorkerEnd::quit);
  }

  THREADS_TEST_CASE("tasks/coordinator", "a requested stop ends waiting, and what is not needed any more ends") {
    Work work;
    Job job(3, work, 5, 60'000);
    job.coordinator->begin(job_of(9));
    std::stop_source stop;
    int waited = 0;
    const auto outcome = job.coordinator->await(0, stop.get_token(), [&] {
      if (++waited == 3) stop.request_stop();
    });
    CHECK(!outcome);
    CHECK(waited == 3);
    CHECK(job.coordinator->progress()[0] == "half of task 0");
    const auto begin = Clock::now();
    job.coordinator->end();
    CHECK(job.coordinator->await(8, {})->failed);
    job.join();
    CHECK(Clock::now() - begin < std::chrono::seconds(10));
    CHECK(job.ends[1] == WorkerEnd::quit);
  }

  THREADS_TEST_CASE("tasks/coordinator", "workers end when process 0 is gone") {
    Work work;
    Timing timing = quick_timing;
    timing.job_lost = milliseconds(300);
    Job job(2, work, 6, 60'000, timing);
    job.coordinator->begin(job_of(2));
    std::this_thread::sleep_for(milliseconds(100));
    job.mail.cut(0);
    job.join();
    CHECK(job.ends[1] == WorkerEnd::job_lost);
  }
}
