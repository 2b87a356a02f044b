#include "tasks/child_executor.hpp"

#include <doctest/doctest.h>

#include <chrono>
#include <csignal>
#include <string>
#include <thread>
#include <vector>

namespace {

using namespace chainslam::tasks;
using Clock = std::chrono::steady_clock;

/// Runs a task in a shell; all its events.
std::vector<TaskEvent> events_of(ChildExecutor& executor, const Bytes& task) {
  std::signal(SIGPIPE, SIG_IGN);
  executor.start(task);
  std::vector<TaskEvent> events;
  const auto patience = Clock::now() + std::chrono::seconds(30);
  while (Clock::now() < patience && (events.empty() || events.back().kind == TaskEvent::Kind::progress)) {
    if (auto event = executor.poll())
      events.push_back(*event);
    else
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return events;
}

std::vector<TaskEvent> events_of(const std::string& script, const Bytes& task = "") {
  ChildExecutor executor({"/bin/sh", "-c", script});
  return events_of(executor, task);
}

bool is_failure(const std::vector<TaskEvent>& events, const std::string& text) {
  return events.size() == 1 && events[0].kind == TaskEvent::Kind::failure && events[0].bytes.find(text) != Bytes::npos;
}

}  // namespace

TEST_SUITE("tasks/child_executor") {
  TEST_CASE("a process reads its task, says how far it is, and gives a result; one after the other") {
    ChildExecutor executor({"/bin/sh", "-c", "t=$(cat); echo p1; echo noise; echo p2; echo \"rdone: $t\""});
    for (const std::string task : {"a", "b"}) {
      const auto events = events_of(executor, task);
      REQUIRE(events.size() == 3);
      CHECK(events[0].kind == TaskEvent::Kind::progress);
      CHECK(events[1].bytes == "2");
      CHECK(events[2].kind == TaskEvent::Kind::result);
      CHECK(events[2].bytes == "done: " + task);
    }
    CHECK(!executor.poll());
  }

  TEST_CASE("tasks and results may be larger than a pipe, and need not be read") {
    const Bytes large(3'000'000, 'x');
    const auto events = events_of("printf r; cat; echo", large);
    REQUIRE(events.size() == 1);
    CHECK(events[0].bytes == large);
    CHECK(events_of("exec <&-; echo rearly", large).at(0).bytes == "early");
  }

  TEST_CASE("whatever ends a process without a result is a failure that says what") {
    CHECK(is_failure(events_of("echo 'fdisk full'"), "disk full"));
    CHECK(is_failure(events_of("exit 3"), "exit code 3"));
    CHECK(is_failure(events_of("kill -SEGV $$"), "signal 11"));
    CHECK(is_failure(events_of("kill -KILL $$"), "want of memory"));
    ChildExecutor none({"/nowhere/program"});
    CHECK(is_failure(events_of(none, "task"), "No such file"));
  }

  TEST_CASE("a task is stopped, also where its process does not want to end") {
    for (const std::string script : {"exec sleep 60", "trap '' TERM; while :; do sleep 0.1; done"}) {
      ChildExecutor executor({"/bin/sh", "-c", script});
      executor.start("");
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
      CHECK(!executor.poll());
      const auto begin = Clock::now();
      executor.stop();
      CHECK(Clock::now() - begin < std::chrono::seconds(10));
      CHECK(!executor.poll());
    }
  }
}
