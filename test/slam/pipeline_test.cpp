#include "chainslam/slam/pipeline.hpp"

#include <doctest/doctest.h>

#include <atomic>
#include <chrono>
#include <latch>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "slam/street.hpp"
#include "support/threads_cases.hpp"

namespace chainslam {
namespace {

using test::keyframe_at;

/// Writes down what it is told, on which thread, and throws or waits where it is asked to.
struct DiaryBackEnd {
  std::vector<std::string> diary{};
  std::thread::id thread{};
  double throws_at = -1;        ///< seconds: the keyframe that it cannot bear
  std::latch* opens = nullptr;  ///< before which it takes no keyframe
  std::atomic<int> keyframes{0};

  void begin_session(const std::string& name, const Serial& = {}) { diary.push_back("session " + name); }
  template <Executor E>
  void add(const Keyframe& keyframe, const E&) {
    if (opens != nullptr) opens->wait();
    thread = std::this_thread::get_id();
    if (keyframe.time.to_seconds() == throws_at) throw std::runtime_error("too much");
    diary.push_back("keyframe " + std::to_string(keyframe.time.to_seconds()));
    ++keyframes;
  }
  template <Executor E>
  void add(const GnssFix& fix, const E&) {
    diary.push_back("fix " + std::to_string(fix.time.to_seconds()));
  }
  void add(std::span<const FrameRecord> frames) { diary.push_back(std::to_string(frames.size()) + " frames"); }
};

/// Counts how often it was called, and what the back end had seen by then.
struct CountKeyframes {
  std::vector<int>* seen;
  void operator()(const DiaryBackEnd& back_end) const { seen->push_back(back_end.keyframes); }
};

Keyframe keyframe(int second) { return keyframe_at(second, SE3d()); }
GnssFix fix(int second) { return {.time = Timestamp::from_seconds(second)}; }

const Serial serial;

/// Some calls, on a back end or on its pipeline.
template <class Add>
void drive(Add&& add) {
  add([](auto& to) { to.begin_session("morning"); });
  for (int i = 0; i < 50; ++i) {
    add([&](auto& to) { to.add(std::vector<FrameRecord>(static_cast<std::size_t>(i % 3))); });
    add([&](auto& to) {
      if constexpr (requires { to.backlog(); })
        to.add(keyframe(i));
      else
        to.add(keyframe(i), serial);
    });
    add([&](auto& to) {
      if constexpr (requires { to.backlog(); })
        to.add(fix(i));
      else
        to.add(fix(i), serial);
    });
    if (i == 24) add([](auto& to) { to.begin_session("evening"); });
  }
}

}  // namespace

TEST_SUITE("slam/pipeline") {
  THREADS_TEST_CASE("slam/pipeline",
                    "the back end hears of everything in the order in which it came, on a thread of its own") {
    DiaryBackEnd by_hand;
    drive([&](auto&& call) { call(by_hand); });
    for (const std::size_t capacity : {1U, 3U, 64U, 1000U}) {
      DiaryBackEnd back_end;
      Pipeline pipeline(back_end, serial, NoCallback{}, capacity);
      drive([&](auto&& call) { call(pipeline); });
      pipeline.finish();
      CHECK(back_end.diary == by_hand.diary);
      CHECK(back_end.thread != std::this_thread::get_id());
      CHECK(pipeline.backlog() == 0);
      pipeline.finish();  // nothing more to wait for
    }
  }

  THREADS_TEST_CASE("slam/pipeline", "after each item somebody may look at the back end") {
    DiaryBackEnd back_end;
    std::vector<int> seen;
    Pipeline pipeline(back_end, serial, CountKeyframes{&seen});
    pipeline.begin_session("");
    pipeline.add(keyframe(1));
    pipeline.add(fix(1));
    pipeline.add(keyframe(2));
    pipeline.finish();
    CHECK(seen == std::vector<int>{0, 1, 1, 2});
  }

  THREADS_TEST_CASE("slam/pipeline", "what the back end throws reaches whoever finishes, and what came before is in") {
    DiaryBackEnd back_end;
    back_end.throws_at = 3;
    Pipeline pipeline(back_end, serial);
    for (int i = 0; i < 10; ++i) {
      try {
        pipeline.add(keyframe(i));
      } catch (const std::runtime_error&) {  // the back end may have been that quick
        CHECK(back_end.diary.size() == 3);
        return;
      }
    }
    CHECK_THROWS_WITH_AS(pipeline.finish(), "too much", std::runtime_error);
    CHECK(back_end.diary.size() == 3);
    pipeline.finish();  // said once
  }

  THREADS_TEST_CASE("slam/pipeline", "what the back end throws reaches whoever adds, even one who waits for room") {
    DiaryBackEnd back_end;
    back_end.throws_at = 0;
    Pipeline pipeline(back_end, serial, NoCallback{}, 1);
    const auto add_on = [&] {
      for (int i = 0; i < 1000; ++i) pipeline.add(keyframe(i));
    };
    CHECK_THROWS_WITH_AS(add_on(), "too much", std::runtime_error);
    CHECK_THROWS_AS(pipeline.add(keyframe(9)), std::invalid_argument);
    pipeline.finish();
    CHECK(back_end.diary.empty());
  }

  THREADS_TEST_CASE("slam/pipeline", "once the back end has thrown nothing waits any more") {
    DiaryBackEnd back_end;
    back_end.throws_at = 0;
    std::latch opens(1);
    back_end.opens = &opens;
    Pipeline pipeline(back_end, serial);
    for (int i = 0; i < 20; ++i) pipeline.add(keyframe(i));
    CHECK(pipeline.backlog() >= 19);
    opens.count_down();
    for (int i = 0; i < 2000 && pipeline.backlog() > 0; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    CHECK(pipeline.backlog() == 0);
    CHECK_THROWS_WITH_AS(pipeline.finish(), "too much", std::runtime_error);
  }

  THREADS_TEST_CASE("slam/pipeline", "what whoever looks on throws is heard of too") {
    struct Impatient {
      void operator()(const DiaryBackEnd&) const { throw std::runtime_error("disk full"); }
    };
    DiaryBackEnd back_end;
    Pipeline pipeline(back_end, serial, Impatient{});
    pipeline.add(fix(1));
    CHECK_THROWS_WITH_AS(pipeline.finish(), "disk full", std::runtime_error);
  }

  THREADS_TEST_CASE("slam/pipeline", "nothing can be added after the end") {
    DiaryBackEnd back_end;
    Pipeline pipeline(back_end, serial);
    pipeline.add(keyframe(1));
    pipeline.finish();
    CHECK_THROWS_AS(pipeline.add(keyframe(2)), std::invalid_argument);
    CHECK_THROWS_AS(pipeline.begin_session("late"), std::invalid_argument);
    CHECK(back_end.diary.size() == 1);
  }

  THREADS_TEST_CASE("slam/pipeline", "a pipeline that is given up drops what waits and does not hang") {
    DiaryBackEnd back_end;
    std::latch opens(1);
    back_end.opens = &opens;
    std::jthread opener;
    {
      Pipeline pipeline(back_end, serial);
      for (int i = 0; i < 20; ++i) pipeline.add(keyframe(i));
      CHECK(pipeline.backlog() >= 19);  // the back end holds one at most
      opener = std::jthread([&] {
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
        opens.count_down();
      });
    }
    CHECK(back_end.keyframes <= 1);
    { Pipeline idle(back_end, serial); }
  }

  THREADS_TEST_CASE("slam/pipeline",
                    "adding waits for room, so that the back end is never farther behind than the capacity") {
    DiaryBackEnd back_end;
    std::latch opens(1);
    back_end.opens = &opens;
    Pipeline pipeline(back_end, serial, NoCallback{}, 2);
    std::atomic<int> added = 0;
    std::jthread front([&] {
      for (int i = 0; i < 10; ++i) {
        pipeline.add(keyframe(i));
        ++added;
      }
    });
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    CHECK(added <= 3);  // two wait, one is with the back end
    opens.count_down();
    front.join();
    pipeline.finish();
    CHECK(back_end.keyframes == 10);
  }
}

}  // namespace chainslam
