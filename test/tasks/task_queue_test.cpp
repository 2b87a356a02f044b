#include "tasks/task_queue.hpp"

#include <doctest/doctest.h>

#include <map>
#include <numeric>
#include <set>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "support/property.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::tasks;

std::vector<Bytes> numbered(Index count) {
  std::vector<Bytes> tasks;
  for (Index i = 0; i < count; ++i) tasks.push_back("task " + std::to_string(i));
  return tasks;
}

bool succeeded(const TaskQueue& queue, Index number, const Bytes& bytes) {
  const auto& outcome = queue.outcome(number);
  return outcome && !outcome->failed && outcome->bytes == bytes;
}

bool failed(const TaskQueue& queue, Index number, const Bytes& bytes) {
  const auto& outcome = queue.outcome(number);
  return outcome && outcome->failed && outcome->bytes == bytes;
}

}  // namespace

TEST_SUITE("tasks/task_queue") {
  TEST_CASE("tasks are given in their order, each to one worker") {
    TaskQueue queue(numbered(3));
    const std::vector<int> live{0, 1};
    CHECK(queue.take(1, live) == 0);
    CHECK(queue.task(0) == "task 0");
    CHECK(queue.take(0, live) == 1);
    queue.finish(0, 1, "a");
    CHECK(queue.take(1, live) == 2);
    CHECK(!queue.take(1, live));
    queue.finish(2, 1, "c");
    CHECK(succeeded(queue, 0, "a"));
    CHECK(!queue.outcome(1));
    CHECK(succeeded(queue, 2, "c"));
    CHECK(queue.done() == 2);
  }

  TEST_CASE("a task that fails is tried by other workers first, and three times in all") {
    TaskQueue queue(numbered(1));
    const std::vector<int> live{0, 1};
    REQUIRE(queue.take(0, live) == 0);
    queue.fail(0, 0, "first");
    CHECK(!queue.take(0, live));
    REQUIRE(queue.take(1, live) == 0);
    queue.fail(0, 1, "second");
    CHECK(!queue.outcome(0));
    REQUIRE(queue.take(0, live) == 0);  // it has failed for all there are
    queue.fail(0, 0, "third");
    CHECK(failed(queue, 0, "third"));
    CHECK(!queue.take(1, live));
  }

  TEST_CASE("the only worker that is left tries again what failed there") {
    TaskQueue queue(numbered(1));
    REQUIRE(queue.take(0, std::vector<int>{0, 1}) == 0);
    queue.fail(0, 0, "once");
    CHECK(!queue.take(0, std::vector<int>{0, 1}));
    CHECK(queue.take(0, std::vector<int>{0}) == 0);
  }

  TEST_CASE("a lost worker's task waits again; its late result counts, if it is the first") {
    for (const bool late_is_first : {true, false}) {
      TaskQueue queue(numbered(1));
      const std::vector<int> live{0, 1};
      REQUIRE(queue.take(1, live) == 0);
      queue.lose(1, "silent");
      REQUIRE(queue.take(0, std::vector<int>{0}) == 0);
      queue.finish(0, late_is_first ? 1 : 0, "one");
      queue.finish(0, late_is_first ? 0 : 1, "other");
      CHECK(succeeded(queue, 0, "one"));
    }
  }

  TEST_CASE("what is dropped is not given any more, and what is done stays done") {
    TaskQueue queue(numbered(4));
    const std::vector<int> live{0};
    REQUIRE(queue.take(0, live) == 0);
    queue.finish(0, 0, "a");
    REQUIRE(queue.take(0, live) == 1);
    queue.drop_from(0, "not needed");
    CHECK(succeeded(queue, 0, "a"));
    CHECK(failed(queue, 1, "not needed"));
    CHECK(failed(queue, 3, "not needed"));
    CHECK(!queue.take(0, live));
  }

  TEST_CASE("whatever workers do, each task is done once, by one at a time, and fails only at its third attempt") {
    test::for_all(200, [](Rng& rng, int size) {
      const Index count = size, workers = 1 + rng.uniform_index(5);
      std::vector<int> live(static_cast<std::size_t>(workers));
      std::iota(live.begin(), live.end(), 0);
      TaskQueue queue(numbered(count));
      std::map<int, Index> has;         // by worker
      std::map<Index, int> failures;    // by task
      std::map<Index, Bytes> expected;  // results
      for (int step = 0; step < 40 * count && queue.done() < count; ++step) {
        const int worker = rng.uniform_index(workers);
        if (!has.contains(worker)) {
          if (const auto task = queue.take(worker, live)) {
            for (const auto& [other, others_task] : has) CHECK(others_task != *task);
            CHECK(!expected.contains(*task));
            has[worker] = *task;
          }
          continue;
        }
        const Index task = has[worker];
        has.erase(worker);
        if (rng.uniform() < 0.3) {
          queue.fail(task, worker, "failed");
          ++failures[task];
        } else {
          expected[task] = "result " + std::to_string(task);
          queue.finish(task, worker, expected[task]);
        }
      }
      REQUIRE(queue.done() == count);
      for (Index task = 0; task < count; ++task) {
        CHECK(failures[task] <= 3);
        if (failures[task] == 3)
          CHECK(failed(queue, task, "failed"));
        else
          CHECK(succeeded(queue, task, expected.at(task)));
      }
    });
  }
}
