#pragma once

#include <chrono>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam::support {

/// Times of one stage of a run, seconds.
struct StageTime {
  std::string stage{};
  Index count = 0;
  double total = 0.0;
  double p50 = 0.0;
  double p99 = 0.0;
  double max = 0.0;
};

/// Collects how long the steps of each stage take. Any number of threads may add.
class StageTimes {
 public:
  using Clock = std::chrono::steady_clock;

  /// Adds the time between its making and its end.
  class Measurement {
   public:
    Measurement(StageTimes& times, std::string stage) : times_(times), stage_(std::move(stage)) {}
    Measurement(const Measurement&) = delete;
    Measurement& operator=(const Measurement&) = delete;
    ~Measurement() { times_.add(stage_, std::chrono::duration<double>(Clock::now() - start_).count()); }

   private:
    StageTimes& times_;
    std::string stage_;
    Clock::time_point start_ = Clock::now();
  };

  [[nodiscard]] Measurement measure(std::string stage) { return {*this, std::move(stage)}; }

  void add(const std::string& stage, double seconds);

  /// One row for each stage, in the order in which they came first. Percentiles are the smallest sample that at least
  /// that share of samples does not exceed (nearest rank).
  [[nodiscard]] std::vector<StageTime> rows() const;

 private:
  mutable std::mutex mutex_;
  std::vector<std::pair<std::string, std::vector<double>>> samples_;
};

/// The nearest-rank percentile of samples in any order; 0 of none.
/// @param share  in (0, 1].
[[nodiscard]] double percentile(std::vector<double> samples, double share);

/// The middle and the end of a list of samples; zeros of none.
struct Spread {
  double p50 = 0.0;
  double p99 = 0.0;
  double max = 0.0;
};

/// Nearest-rank percentiles of samples in any order.
[[nodiscard]] Spread spread_of(const std::vector<double>& samples);

}  // namespace chainslam::support
