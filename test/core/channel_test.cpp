#include "chainslam/core/channel.hpp"

#include <doctest/doctest.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <stop_token>
#include <thread>
#include <vector>

#include "support/threads_cases.hpp"

namespace chainslam {
namespace {

using Item = std::unique_ptr<int>;

TEST_SUITE("core/channel") {
  THREADS_TEST_CASE("core/channel", "items come out in the order in which they went in") {
    Channel<int> channel(3);
    std::vector<int> received;
    std::jthread writer([&] {
      for (int i = 0; i < 1000; ++i) CHECK(channel.push(int(i)));
      channel.close();
    });
    while (const auto item = channel.pop()) received.push_back(*item);
    REQUIRE(received.size() == 1000);
    for (int i = 0; i < 1000; ++i) CHECK(received[static_cast<std::size_t>(i)] == i);
  }

  THREADS_TEST_CASE("core/channel",
                    "a closed channel is drained, takes nothing more, and leaves the refused item with its owner") {
    Channel<Item> channel(2);
    CHECK(channel.push(std::make_unique<int>(1)));
    channel.close();
    CHECK(channel.closed());
    Item refused = std::make_unique<int>(2);
    CHECK_FALSE(channel.push(std::move(refused)));
    CHECK_FALSE(channel.try_push(std::move(refused)));
    CHECK(refused != nullptr);
    CHECK(**channel.pop() == 1);
    CHECK_FALSE(channel.pop().has_value());
  }

  THREADS_TEST_CASE("core/channel", "a full channel refuses try_push and never holds more than its capacity") {
    Channel<int> channel(2);
    CHECK(channel.try_push(1));
    CHECK(channel.try_push(2));
    CHECK_FALSE(channel.try_push(3));
    CHECK(channel.size() == channel.capacity());
    CHECK(*channel.pop() == 1);
    CHECK(channel.try_push(3));
  }

  THREADS_TEST_CASE("core/channel", "no capacity is refused") {
    CHECK_THROWS_AS(Channel<int>(0), std::invalid_argument);
  }

  THREADS_TEST_CASE("core/channel", "a stop request wakes a reader of an empty channel and a writer to a full one") {
    Channel<int> empty(1), full(1);
    REQUIRE(full.push(7));
    std::atomic<bool> read = true, written = true;
    {
      std::jthread reader([&](const std::stop_token& stop) { read = empty.pop(stop).has_value(); });
      std::jthread writer([&](const std::stop_token& stop) { written = full.push(8, stop); });
    }  // asks both to stop, and joins them
    CHECK_FALSE(read);
    CHECK_FALSE(written);
    CHECK(full.size() == 1);
  }

  THREADS_TEST_CASE("core/channel", "closing wakes everyone who waits") {
    Channel<int> empty(1), full(1);
    REQUIRE(full.push(7));
    {
      std::jthread reader([&] { CHECK_FALSE(empty.pop().has_value()); });
      std::jthread writer([&] { CHECK_FALSE(full.push(8)); });
      std::this_thread::yield();
      empty.close();
      full.close();
    }
  }

  THREADS_TEST_CASE("core/channel", "many writers and readers lose nothing and double nothing") {
    constexpr int writers = 4, per_writer = 500;
    Channel<int> channel(5);
    std::vector<std::atomic<int>> seen(writers * per_writer);
    std::vector<std::jthread> readers;
    for (int r = 0; r < 3; ++r)
      readers.emplace_back([&] {
        while (const auto item = channel.pop()) ++seen[static_cast<std::size_t>(*item)];
      });
    {
      std::vector<std::jthread> threads;
      for (int w = 0; w < writers; ++w)
        threads.emplace_back([&channel, w] {
          for (int i = 0; i < per_writer; ++i) CHECK(channel.push(w * per_writer + i));
        });
    }
    channel.close();
    readers.clear();
    for (const auto& count : seen) CHECK(count == 1);
  }
}

TEST_SUITE("core/snapshot") {
  THREADS_TEST_CASE("core/snapshot", "is empty until something is stored") {
    Snapshot<int> snapshot;
    CHECK(snapshot.load() == nullptr);
    snapshot.store(std::make_shared<const int>(4));
    CHECK(*snapshot.load() == 4);
    CHECK(*Snapshot<int>(std::make_shared<const int>(5)).load() == 5);
  }

  THREADS_TEST_CASE("core/snapshot",
                    "readers see whole states, each at least as new as the last, and keep what they hold") {
    struct State {
      int version, same_version;
    };
    Snapshot<State> snapshot(std::make_shared<const State>(State{0, 0}));
    const auto first = snapshot.load();
    std::vector<std::jthread> readers;
    for (int r = 0; r < 3; ++r)
      readers.emplace_back([&] {
        for (int last = 0; last < 2000;) {
          const auto state = snapshot.load();
          CHECK(state->version == state->same_version);
          CHECK(state->version >= last);
          last = state->version;
        }
      });
    for (int version = 1; version <= 2000; ++version)
      snapshot.store(std::make_shared<const State>(State{version, version}));
    readers.clear();
    CHECK(first->version == 0);
  }
}

}  // namespace
}  // namespace chainslam
