#include <doctest/doctest.h>

#include <algorithm>
#include <cstdio>
#include <numbers>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/back_end.hpp"
#include "chainslam/trajectory/inter_session.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "slam/nclt_drives.hpp"
#include "support/quick.hpp"
#include "support/real_data.hpp"

// Three real drives over one campus, 15 km, months apart: real odometry and truth. Scans are not at hand, so closures
// are what a registration with known noise would have measured: what is tested is the graph, chaining and merging.

namespace chainslam {
namespace {

using test::RealDrive;

/// Closures that are wrong by metres, and pass.
struct Wrong {
  double alone = 0;        ///< share of the measurements that are wrong each by itself
  double together = 0;     ///< share of the scans of which all measurements are wrong alike: one seed and its chain
  std::uint64_t seed = 0;  ///< of all that is drawn
};

/// Measures what a registration would: the true relative pose and noise, where scans of both places overlap.
class SampledRegistration {
 public:
  SampledRegistration(std::vector<SE3d> truth, double reach, double min_travel, const Wrong& wrong)
      : truth_(std::move(truth)), reach_(reach), min_travel_(min_travel), wrong_(wrong) {}

  /// Merges have their own tests: whether what comes next may be wrong.
  void set_honest(bool honest) { honest_ = honest; }

  template <Executor E = Serial>
  std::vector<LoopClosure> close(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                 const E& executor = {}) {
    const Keyframe& newest = keyframes.back();
    if (newest.id.value > 0)
      travelled_ += (keyframes[keyframes.size() - 2].T_odom_body.inverse() * newest.T_odom_body).translation().norm();
    if (travelled_ < min_travel_) return {};
    travelled_ = 0;
    return search(keyframes, index, newest.id, executor);
  }

  template <Executor E = Serial>
  std::vector<LoopClosure> search(std::span<const Keyframe> keyframes, const PositionIndex& index, KeyframeId query,
                                  const E& executor = {}) {
    std::vector<LoopClosure> tried;
    for (const KeyframeId candidate : candidates_.find(keyframes, index, query)) {
      tried.push_back(align(keyframes, candidate, query, SE3d(), executor));
      if (tried.back().verdict == ClosureVerdict::accepted) break;
    }
    return tried;
  }

  bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return candidates_.eligible(candidate, query);
  }

  template <Executor E = Serial>
  LoopClosure align(std::span<const Keyframe>, KeyframeId from, KeyframeId to, const SE3d&, const E& = {}) {
    const SE3d T = truth_[static_cast<std::size_t>(from.value)].inverse() * truth_[static_cast<std::size_t>(to.value)];
    LoopClosure closure{.from = from, .to = to, .T_from_to = T, .verdict = ClosureVerdict::too_few_inliers};
    if (T.translation().norm() > reach_) return closure;
    const std::uint64_t seed = 7'777'777 * wrong_.seed;
    Rng rng(seed + static_cast<std::uint64_t>(from.value) * 1'000'003 + static_cast<std::uint64_t>(to.value));
    Vector6d sigmas, noise;
    sigmas << Eigen::Vector3d::Constant(0.1), Eigen::Vector3d::Constant(0.005);
    for (Eigen::Index k = 0; k < 6; ++k) noise[k] = rng.normal(0, sigmas[k]);
    closure.T_from_to = T.retract(noise);
    Rng of_scan(seed + 99 + static_cast<std::uint64_t>(to.value));
    if (!honest_ && rng.uniform(0, 1) < wrong_.alone) spoil(closure, rng);
    if (!honest_ && of_scan.uniform(0, 1) < wrong_.together) spoil(closure, of_scan);
    closure.sqrt_information = NoiseModel<6>::from_sigmas(sigmas).sqrt_information();
    closure.verdict = ClosureVerdict::accepted;
    return closure;
  }

 private:
  /// Off by 2 to 10 m along the ground, half a metre up or down, and some degrees. It says so as a large error.
  static void spoil(LoopClosure& closure, Rng& rng) {
    const double way = rng.uniform(2, 10), direction = rng.uniform(0, 2 * std::numbers::pi);
    Vector6d off;
    off << way * std::cos(direction), way * std::sin(direction), rng.normal(0, 0.5), rng.normal(0, 0.05),
        rng.normal(0, 0.05), rng.normal(0, 0.2);
    closure.T_from_to = closure.T_from_to * SE3d::exp(off);
    closure.mean_squared_error = 1;
  }

  std::vector<SE3d> truth_;
  double reach_, min_travel_;
  Wrong wrong_;
  bool honest_ = false;
  double travelled_ = 1e9;
  ProximityCandidates candidates_;
};

/// Recognizes places by GNSS, as `MapMerger` does, and takes the sampled registration's word for them.
class SampledMerger {
 public:
  template <class Closer, Executor E = Serial>
  std::vector<LoopClosure> attempt(const SlamMap& map, KeyframeId query, Closer& closer, const E& executor = {}) {
    std::vector<LoopClosure> tried;
    for (const KeyframeId candidate : candidates_.find(map, query)) {
      closer.set_honest(true);
      tried.push_back(closer.align(map.keyframes, candidate, query, SE3d(), executor));
      closer.set_honest(false);
      tried.back().kind = ClosureKind::merge;
      if (tried.back().verdict == ClosureVerdict::accepted) break;
    }
    return tried;
  }
  std::vector<LoopClosure> withdraw() { return {}; }

 private:
  GnssCandidates candidates_;
};

/// The receiver's word for a true place: a bias for each drive and a metre of noise.
GnssFix fix_at(const SE3d& truth, const Eigen::Vector3d& bias, Rng& rng) {
  constexpr double earth_radius = 6378137;
  const Eigen::Vector3d noise(rng.normal(0, 1), rng.normal(0, 1), rng.normal(0, 2));
  const Eigen::Vector3d p = truth.translation() + bias + noise;  // north, east, down
  return {.position_ecef = {earth_radius - p.z(), p.y(), p.x()}, .quality = GnssQuality::three_dimensional};
}

template <class Chainer>
std::shared_ptr<const SlamMap> mapped(const std::vector<RealDrive>& drives,
                                      Chainer chainer,  // by value: parts belong to one back end
                                      const Wrong& wrong = {}) {
  std::vector<SE3d> truth;
  for (const RealDrive& drive : drives) truth.insert(truth.end(), drive.truth.begin(), drive.truth.end());
  BackEndOptions options;
  options.recheck_travel = 16.0;
  BackEnd<SampledRegistration, Chainer, SampledMerger> back_end(options, SampledRegistration(truth, 12.0, 16.0, wrong),
                                                                std::move(chainer), SampledMerger());
  Rng rng(1);
  for (const RealDrive& drive : drives) {
    const Eigen::Vector3d bias(rng.normal(0, 1), rng.normal(0, 1), rng.normal(0, 2));
    back_end.begin_session("drive");
    for (std::size_t i = 0; i < drive.times.size(); ++i) {
      // As a keyframe set has it: odometry that says nothing of its errors.
      const FrameRecord frame{.session = {}, .time = drive.times[i], .T_odom_body = drive.odometry[i]};
      back_end.add(std::span(&frame, 1));
      back_end.add(Keyframe{
          .time = drive.times[i], .T_odom_body = drive.odometry[i], .gnss = fix_at(drive.truth[i], bias, rng)});
    }
  }
  return back_end.finish();
}

std::vector<MatchedTrajectories> matched(const std::vector<RealDrive>& drives, const SlamMap& map) {
  std::vector<MatchedTrajectories> sessions(drives.size());
  for (std::size_t i = 0; i < drives.size(); ++i) sessions[i].reference.poses = drives[i].truth;
  for (const Keyframe& keyframe : map.keyframes)
    sessions[static_cast<std::size_t>(keyframe.session.value)].estimate.poses.push_back(keyframe.T_map_body);
  return sessions;
}

/// What is left of a map where each drive ends with its last keyframe that a right closure holds: behind it, nothing
/// tells where odometry that has just failed led to.
std::vector<MatchedTrajectories> held(std::vector<MatchedTrajectories> sessions, const SlamMap& map) {
  for (std::size_t s = 0; s < sessions.size(); ++s) {
    const Session& session = map.sessions[s];
    Index last = 0;
    for (const LoopClosure& closure : map.closures)
      for (const KeyframeId id : {closure.from, closure.to}) {
        const Index i = id.value - session.first_keyframe;
        if (closure.mean_squared_error == 0 && i < session.keyframes) last = std::max(last, i);
      }
    for (Trajectory* trajectory : {&sessions[s].reference, &sessions[s].estimate})
      trajectory->poses.resize(static_cast<std::size_t>(last) + 1);
  }
  return sessions;
}

struct Errors {
  double ape = 0, between = 0;
  double held_ape = 0;            ///< over what right closures hold
  Index wrong = 0, believed = 0;  ///< closures, and how many of them count in the end
};

Errors errors(const char* name, const std::vector<RealDrive>& drives, const SlamMap& map) {
  const std::vector<MatchedTrajectories> sessions = matched(drives, map);
  Errors result{ape(sessions).translation.rmse, inter_session_errors(sessions).translation.rmse,
                ape(held(sessions, map)).translation.rmse};
  for (const LoopClosure& closure : map.closures) {
    if (closure.mean_squared_error == 0) continue;
    ++result.wrong;
    if (closure.verdict == ClosureVerdict::accepted) ++result.believed;
  }
  const auto chained = std::ranges::count(map.closures, ClosureKind::chained, &LoopClosure::kind);
  std::printf(
      "FIGURE nclt, %s: joint ATE %.3f m, %.3f m of what right closures hold, between sessions %.3f m, %zu closures, "
      "%d of them chained, %d wrong, "
      "%d believed\n",
      name, result.ape, result.held_ape, result.between, map.closures.size(), static_cast<int>(chained), result.wrong,
      result.believed);
  return result;
}

/// With half of the closures wrong, one draw says little: 60 of them gave 0.58 to 0.81 m of what right closures hold,
/// 0.67 m on average, and up to 9 wrong closures of 280 that count, 4 on average. These eight come to 1.13 and 1.15 of
/// the map without wrong ones.
void check_half_wrong(const std::vector<RealDrive>& drives, const Errors& clean) {
  constexpr int draws = 8;
  double held = 0, whole = 0;
  Index wrong = 0, believed = 0;
  for (std::uint64_t seed = 0; seed < draws; ++seed) {
    CAPTURE(seed);
    const Errors half = errors("half wrong", drives, *mapped(drives, ChainedCloser(), {.alone = 0.5, .seed = seed}));
    CHECK(half.wrong > 200);
    CHECK(half.believed < half.wrong / 20);
    CHECK(half.held_ape < 1.4 * clean.held_ape);
    held += half.held_ape / draws;
    whole += half.ape / draws;
    wrong += half.wrong;
    believed += half.believed;
  }
  CHECK(believed < wrong / 40);
  CHECK(held < 1.15 * clean.held_ape);
  CHECK(whole < 1.2 * clean.ape);
}

}  // namespace

TEST_SUITE("slam/nclt_sessions") {
  TEST_CASE("three NCLT drives become one map; closures beat odometry, and chaining does not hurt" *
            doctest::skip(test::quick())) {
    const auto folder = test::real_data("trajectories/nclt");
    if (!folder) return;
    const std::vector<RealDrive> drives = test::read_nclt_drives(*folder, 6.0);
    double squares = 0, poses = 0;
    for (const RealDrive& drive : drives) {
      const double rmse =
          ape(Trajectory{.times = {}, .poses = drive.truth}, Trajectory{.times = {}, .poses = drive.odometry})
              .translation.rmse;
      squares += rmse * rmse * static_cast<double>(drive.truth.size());
      poses += static_cast<double>(drive.truth.size());
    }
    const double odometry = std::sqrt(squares / poses);
    std::printf("FIGURE nclt, odometry, each drive aligned by itself: ATE %.3f m\n", odometry);
    const auto unchained_map = mapped(drives, NoChaining());
    const auto chained_map = mapped(drives, ChainedCloser());
    for (const auto& map : {unchained_map, chained_map})
      for (const Session& session : map->sessions) CHECK(session.frame == SessionId{0});
    const Errors unchained = errors("unchained", drives, *unchained_map);
    const Errors chained = errors("chained", drives, *chained_map);
    CHECK(unchained.ape < 2.2);
    CHECK(chained.ape < 2.2);
    CHECK(chained.ape < odometry / 2);
    CHECK(chained.between <= 0.25);
    CHECK(chained.between <= unchained.between);
  }

  TEST_CASE("wrong closures among those of three NCLT drives are found out" * doctest::skip(test::quick())) {
    const auto folder = test::real_data("trajectories/nclt");
    if (!folder) return;
    const std::vector<RealDrive> drives = test::read_nclt_drives(*folder, 6.0);
    const Errors clean = errors("all closures right", drives, *mapped(drives, ChainedCloser()));
    const Errors few = errors("a tenth wrong", drives, *mapped(drives, ChainedCloser(), {.alone = 0.1}));
    CHECK(few.wrong > 40);
    CHECK(few.believed == 0);
    CHECK(few.ape < 1.1 * clean.ape);
    check_half_wrong(drives, clean);
    for (const std::uint64_t seed : {0, 1, 2, 3}) {
      CAPTURE(seed);
      ChainedCloser long_chains({.min_separation = 1, .max_alignments = 40});
      const Errors chains = errors("a tenth of the chains wrong", drives,
                                   *mapped(drives, std::move(long_chains), {.together = 0.1, .seed = seed}));
      CHECK(chains.wrong > 60);
      CHECK(chains.believed <= (seed == 0 ? 1 : 0));  // one that odometry and fixes support behind the step that failed
      CHECK(chains.ape < 1.15 * clean.ape);  // 1.11 with seed 0, whose one wrong closure is at the end of a drive
    }
  }
}

}  // namespace chainslam
