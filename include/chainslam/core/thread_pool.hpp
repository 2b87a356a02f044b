#pragma once

#include <algorithm>
#include <atomic>
#include <concepts>
#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <stop_token>
#include <thread>
#include <type_traits>
#include <vector>

#include "chainslam/core/executor.hpp"

namespace chainslam {

/// Threads that share the chunks of loops. Models `Executor`.
///
/// The calling thread takes chunks too, so that a pool of n threads starts n - 1 workers, and a pool of none or one
/// runs everything on the caller. Several threads may call `for_chunks` at the same time. A loop inside a chunk runs on
/// the thread it is on: loops nest without waiting for one another.
class ThreadPool {
 public:
  /// @param threads  that may run a loop's chunks at the same time, the caller counted; 0 and 1 start no worker.
  explicit ThreadPool(Index threads = hardware_threads()) {
    const Index workers = std::max<Index>(threads - 1, 0);
    workers_.reserve(static_cast<std::size_t>(workers));
    for (Index i = 0; i < workers; ++i) workers_.emplace_back([this](const std::stop_token& stop) { work(stop); });
  }

  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  /// Threads that may run a loop's chunks at the same time, the caller counted.
  [[nodiscard]] Index threads() const { return static_cast<Index>(workers_.size()) + 1; }

  /// What the machine can run at the same time, at least 1.
  [[nodiscard]] static Index hardware_threads() {
    return static_cast<Index>(std::max(1U, std::thread::hardware_concurrency()));
  }

  /// See `Executor`.
  template <std::invocable<Index, Index> Body>
  void for_chunks(Index count, Index grain, Body&& body) const {
    if (workers_.empty() || inside_chunk() || count <= grain) return Serial{}.for_chunks(count, grain, body);
    detail::require_grain(grain);
    using Callable = std::remove_reference_t<Body>;
    Loop loop(count, grain, const_cast<void*>(static_cast<const void*>(std::addressof(body))),
              [](void* callable, Index begin, Index end) { (*static_cast<Callable*>(callable))(begin, end); });
    run(loop);
  }

 private:
  /// One loop that is being shared out; lives on its caller's stack until every thread has left it.
  struct Loop {
    using Call = void (*)(void* callable, Index begin, Index end);

    Loop(Index count_in, Index grain_in, void* callable_in, Call call_in)
        : count(count_in),
          grain(grain_in),
          chunks(detail::count_chunks(count_in, grain_in)),
          callable(callable_in),
          call(call_in) {}

    const Index count;
    const Index grain;
    const Index chunks;
    void* const callable;
    const Call call;
    std::atomic<Index> next{0};  ///< the chunk to hand out next; chunks go out in order
    Index visitors = 0;          ///< workers inside; guarded by the pool's mutex
    std::mutex failure_mutex;
    Index failed_chunk = -1;  ///< the first in chunk order that threw, or -1
    std::exception_ptr failure;
  };

  static bool& inside_chunk() {
    thread_local bool inside = false;
    return inside;
  }

  void run(Loop& loop) const {
    {
      const std::scoped_lock lock(mutex_);
      loops_.push_back(&loop);
    }
    loop_added_.notify_all();
    take_chunks(loop);
    {
      std::unique_lock lock(mutex_);
      std::erase(loops_, &loop);
      worker_left_.wait(lock, [&] { return loop.visitors == 0; });
    }
    if (loop.failure) std::rethrow_exception(loop.failure);
  }

  void work(const std::stop_token& stop) const {
    std::unique_lock lock(mutex_);
    while (loop_added_.wait(lock, stop, [this] { return !loops_.empty(); })) {
      Loop& loop = *loops_.front();
      ++loop.visitors;
      lock.unlock();
      take_chunks(loop);
      lock.lock();
      std::erase(loops_, &loop);
      if (--loop.visitors == 0) worker_left_.notify_all();
    }
  }

  /// Runs chunks until none is left to hand out.
  static void take_chunks(Loop& loop) {
    inside_chunk() = true;
    for (Index chunk = take(loop); chunk < loop.chunks; chunk = take(loop)) {
      const Index begin = chunk * loop.grain;
      const Index end = loop.count - begin > loop.grain ? begin + loop.grain : loop.count;
      try {
        loop.call(loop.callable, begin, end);
      } catch (...) {
        record_failure(loop, chunk, std::current_exception());
      }
    }
    inside_chunk() = false;
  }

  /// The next chunk, or a number past the last. Never counts beyond `chunks`, so that it cannot overflow.
  static Index take(Loop& loop) {
    Index chunk = loop.next.load(std::memory_order_relaxed);
    while (chunk < loop.chunks && !loop.next.compare_exchange_weak(chunk, chunk + 1, std::memory_order_relaxed)) {
    }
    return chunk;
  }

  /// Keeps the failure that is first in chunk order and hands out no further chunk. All chunks before it have been
  /// handed out already, so that which failure is first does not depend on the threads.
  static void record_failure(Loop& loop, Index chunk, std::exception_ptr failure) {
    const std::scoped_lock lock(loop.failure_mutex);
    if (loop.failed_chunk < 0 || chunk < loop.failed_chunk) {
      loop.failed_chunk = chunk;
      loop.failure = std::move(failure);
    }
    loop.next.store(loop.chunks, std::memory_order_relaxed);
  }

  mutable std::mutex mutex_;
  mutable std::condition_variable_any loop_added_;
  mutable std::condition_variable worker_left_;
  mutable std::vector<Loop*> loops_;   ///< with chunks to hand out, oldest first
  std::vector<std::jthread> workers_;  ///< last: they stop before what they use goes
};
static_assert(Executor<ThreadPool>);

}  // namespace chainslam
