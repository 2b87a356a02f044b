#pragma once

#include <optional>
#include <utility>

#include "chainslam/core/finite.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/gnss_fix.hpp"

namespace chainslam {

/// Gives keyframes the GNSS position at their own time, between the fixes around it.
class GnssInterpolator {
 public:
  /// @param max_gap  between two fixes: over longer outages nothing is interpolated.
  explicit GnssInterpolator(Duration max_gap = seconds(2.0)) : max_gap_(max_gap) {}

  /// A keyframe that waits for the next fix; times ascend.
  void add(KeyframeId id, Timestamp time) { waiting_.push_back({id, time}); }

  /// Takes the next fix and calls `assign(id, fix)` for each waiting keyframe that lies between it and the one before.
  /// Fixes without a position or not later than the last are left out.
  template <class Assign>
  void add(const GnssFix& fix, Assign&& assign) {
    if (fix.quality == GnssQuality::none || !is_finite(fix.position_ecef) || !is_finite(fix.covariance_ecef)) return;
    if (last_ && fix.time <= last_->time) return;
    Offset passed = 0;
    for (; passed < waiting_.size() && waiting_[passed].time <= fix.time; ++passed) {
      const Waiting& keyframe = waiting_[passed];
      if (last_ && keyframe.time >= last_->time && fix.time - last_->time <= max_gap_)
        assign(keyframe.id, between(*last_, fix, keyframe.time));
    }
    if (passed > 0) waiting_ = detail::Table<Waiting>(waiting_.range(passed, waiting_.size()));
    last_ = fix;
  }

 private:
  struct Waiting {
    KeyframeId id;
    Timestamp time;
  };

  /// The worse quality of both; the covariance is not reduced by averaging, since errors of fixes are correlated.
  [[nodiscard]] static GnssFix between(const GnssFix& a, const GnssFix& b, Timestamp time) {
    const double share = to_seconds(time - a.time) / to_seconds(b.time - a.time);
    GnssFix fix;
    fix.time = time;
    const auto blend = [share](double from, double to) { return from + share * (to - from); };
    for (int i = 0; i < 3; ++i) fix.position_ecef[i] = blend(a.position_ecef[i], b.position_ecef[i]);
    for (int i = 0; i < 9; ++i)
      fix.covariance_ecef.data()[i] = blend(a.covariance_ecef.data()[i], b.covariance_ecef.data()[i]);
    fix.quality = a.quality < b.quality ? a.quality : b.quality;
    return fix;
  }

  Duration max_gap_;
  std::optional<GnssFix> last_;
  detail::Table<Waiting> waiting_;
};

}  // namespace chainslam
