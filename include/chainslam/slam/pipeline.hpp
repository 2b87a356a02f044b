#pragma once

#include <cstddef>
#include <exception>
#include <span>
#include <stdexcept>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/core/channel.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// No-op callback for the steps of the back end.
struct NoCallback {
  template <class BackEnd>
  void operator()(const BackEnd& /*back_end*/) const {}  ///< does nothing
};

/// Runs a back end on a thread of its own, so that odometry on the caller's thread never waits for a loop to close:
/// only for capacity, when the back end is `capacity` items behind.
///
/// Items are worked off one by one in the order in which they came, so threads and speed change nothing in the map. The
/// back end says where odometry's frame lies in the map by `T_map_odom`, and never touches odometry itself.
/// @tparam BackEnd  `BackEnd` with its policies, or anything with the same `begin_session` and `add`s.
/// @tparam E        what the back end's own loops run on.
/// @tparam AfterEach  called with the back end after each item, on its thread: a journal, a progress line.
template <class BackEnd, Executor E = Serial, class AfterEach = NoCallback>
class Pipeline {
 public:
  /// @param back_end  must outlive the pipeline, as must `executor`; belongs to its thread until `finish` returns.
  explicit Pipeline(BackEnd& back_end, const E& executor, AfterEach after_each = {}, std::size_t capacity = 64)
      : items_(capacity), thread_([this, &back_end, &executor, after_each = std::move(after_each)]() mutable {
          run(back_end, executor, after_each);
        }) {}

  Pipeline(const Pipeline&) = delete;
  Pipeline& operator=(const Pipeline&) = delete;
  /// Drops what is still waiting.
  ~Pipeline() {
    items_.close();
    stop_.request_stop();
  }

  /// @name The back end's calls of the same names, worked off later.
  /// @throws what a call before has thrown in the back end, which then has stopped; std::invalid_argument after that,
  /// and after `finish`.
  /// @{
  void begin_session(std::string name) { push(SessionStart{std::move(name)}); }  ///< see `BackEnd`
  void add(Keyframe keyframe) { push(std::move(keyframe)); }                     ///< see `BackEnd`
  void add(const GnssFix& fix) { push(fix); }                                    ///< see `BackEnd`
  void add(std::vector<FrameRecord> frames) { push(std::move(frames)); }         ///< see `BackEnd`
  /// Any of these.
  void push(MapInput input) {
    if (items_.push(std::move(input))) return;
    finish();
    throw std::invalid_argument("Pipeline: nothing can be added once it has finished");
  }
  /// @}

  /// Items that wait; none once the back end has thrown.
  [[nodiscard]] std::size_t backlog() const { return items_.size(); }

  /// Waits until all is worked off. @throws what the back end has thrown.
  void finish() {
    items_.close();
    if (thread_.joinable()) thread_.join();
    if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
  }

 private:
  void run(BackEnd& back_end, const E& executor, AfterEach& after_each) {
    const std::stop_token stop = stop_.get_token();
    try {
      while (auto item = items_.pop(stop)) {
        if (auto* session = std::get_if<SessionStart>(&*item))
          back_end.begin_session(std::move(session->name), executor);
        else if (auto* keyframe = std::get_if<Keyframe>(&*item))
          back_end.add(std::move(*keyframe), executor);
        else if (const auto* frames = std::get_if<std::vector<FrameRecord>>(&*item))
          back_end.add(std::span<const FrameRecord>(*frames));
        else
          back_end.add(std::get<GnssFix>(*item), executor);
        after_each(std::as_const(back_end));
      }
    } catch (...) {
      failure_ = std::current_exception();
      items_.close();  // whoever adds more hears of it
      // Nobody works off what waits, so whoever watches the backlog must not wait for it.
      while (items_.pop(stop)) continue;
    }
  }

  Channel<MapInput> items_;
  std::stop_source stop_;
  std::exception_ptr failure_;
  std::jthread thread_;
};

}  // namespace chainslam
