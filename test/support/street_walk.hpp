#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"

namespace chainslam::test {

struct StreetWalkOptions {
  Index sessions = 5;
  Index keyframes = 2000;    ///< of each session
  int blocks = 8;            ///< along the town's side
  int block = 50;            ///< length of one, in metres
  Index most_closures = 16;  ///< of a keyframe: the direct one and those chained to it, one a session
  double outliers = 0.0;     ///< share of closures that lie
  std::uint64_t seed = 1;

  /// A town in which so many poses cross each other as often, whatever their number.
  [[nodiscard]] static StreetWalkOptions of_size(Index poses, std::uint64_t seed) {
    const double side = 8.0 * std::sqrt(poses / 10000.0);
    return {.sessions = std::max(1, poses / 2000),
            .keyframes = std::min(poses, 2000),
            .blocks = std::max(2, static_cast<int>(std::lround(side))),
            .seed = seed};
  }
};

/// Sessions of a walk through streets, with the closures that a LiDAR mapper finds: long chains, few cycles. The same
/// seed gives the same walk.
///
/// A keyframe each metre, odometry noise 1 cm and 1 mrad a step, closures of 5 cm and 3 mrad: every 5th keyframe closes
/// on the nearest keyframe within 8 m of each earlier session and of its own, 100 keyframes back. Outliers are off by
/// metres. A session's start is known to 10 cm and 10 mrad, as from GNSS, so that one without closure is held.
class StreetWalk {
 public:
  struct Closure {
    Key from;
    SE3d T_from_to;
    bool lies;
  };
  /// What comes with a keyframe.
  struct Step {
    bool starts = false;  ///< a session; `motion` is then the pose
    SE3d motion;          ///< from the keyframe before
    std::vector<Closure> closures;
  };

  explicit StreetWalk(const StreetWalkOptions& options) : options_(options), rng_(options.seed) {}

  [[nodiscard]] bool done() const { return session_ == options_.sessions; }
  [[nodiscard]] Step next() {
    Step step;
    step.starts = step_ == 0;
    if (step.starts) {
      x_ = session_ == 0 ? 0 : options_.block * rng_.uniform_index(options_.blocks + 1);
      y_ = session_ == 0 ? 0 : options_.block * rng_.uniform_index(options_.blocks + 1);
      heading_ = 0;
    }
    if (x_ % options_.block == 0 && y_ % options_.block == 0) heading_ = turn();
    const SE3d pose = here();
    step.motion = step.starts ? noisy(pose, 0.1, 0.01) : noisy(truth_.back().inverse() * pose, 1e-2, 1e-3);
    const auto key = static_cast<Key>(truth_.size());
    truth_.push_back(pose);
    sessions_.push_back(session_);
    if (step_ % 5 == 0) close_loops(key, step);
    cells_[{x_ / reach, y_ / reach}].push_back(key);
    x_ += direction(heading_).first;
    y_ += direction(heading_).second;
    if (++step_ == options_.keyframes) {
      step_ = 0;
      ++session_;
    }
    return step;
  }

  /// All that is left, as one graph with its first pose fixed; poses start from odometry.
  [[nodiscard]] PoseGraph graph() {
    PoseGraph graph;
    while (!done()) {
      const Step step = next();
      const Key key = graph.add_value(step.starts ? step.motion : graph[graph.values().size() - 1] * step.motion);
      if (step.starts) graph.add_prior(key, step.motion, start_noise());
      if (!step.starts) graph.add_between(key - 1, key, step.motion, odometry_noise());
      for (const Closure& closure : step.closures)
        graph.add_between(closure.from, key, closure.T_from_to, closure_noise());
    }
    graph.set_fixed(0);
    return graph;
  }

  [[nodiscard]] const std::vector<SE3d>& truth() const { return truth_; }

  [[nodiscard]] static PoseGraph::Noise start_noise() { return noise(0.1, 0.01); }
  [[nodiscard]] static PoseGraph::Noise odometry_noise() { return noise(1e-2, 1e-3); }
  [[nodiscard]] static PoseGraph::Noise closure_noise() { return noise(5e-2, 3e-3); }

 private:
  static constexpr int reach = 8;
  using Cell = std::pair<int, int>;

  [[nodiscard]] static std::pair<int, int> direction(int heading) {
    constexpr std::array<int, 4> dx{1, 0, -1, 0};
    constexpr std::array<int, 4> dy{0, 1, 0, -1};
    return {dx[static_cast<std::size_t>(heading)], dy[static_cast<std::size_t>(heading)]};
  }

  /// Straight on, left or right, so as to stay in town.
  [[nodiscard]] int turn() {
    int heading = heading_;
    for (;;) {
      const int next = (heading + rng_.uniform_index(3) + 3) % 4;
      const auto [dx, dy] = direction(next);
      const int to_x = x_ + dx * options_.block, to_y = y_ + dy * options_.block;
      if (std::min(to_x, to_y) >= 0 && std::max(to_x, to_y) <= options_.block * options_.blocks) return next;
      heading = (heading + 1) % 4;
    }
  }

  /// Over hills of 3 m.
  [[nodiscard]] SE3d here() const {
    const Eigen::Vector3d position(x_, y_, 3.0 * std::sin(x_ / 60.0) * std::cos(y_ / 80.0));
    return SE3d(SO3d::exp(Eigen::Vector3d(0, 0, heading_ * std::numbers::pi / 2)), position);
  }

  [[nodiscard]] SE3d noisy(const SE3d& measured, double translation, double rotation) {
    Vector6d noise;
    for (int i = 0; i < 6; ++i) noise[i] = rng_.normal() * (i < 3 ? translation : rotation);
    return measured * SE3d::exp(noise);
  }

  [[nodiscard]] static PoseGraph::Noise noise(double translation, double rotation) {
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(translation), Eigen::Vector3d::Constant(rotation);
    return PoseGraph::Noise::from_sigmas(sigmas);
  }

  void close_loops(Key key, Step& step) {
    const SE3d& pose = truth_[static_cast<std::size_t>(key)];
    std::map<Index, std::pair<double, Key>> nearest;  // of each session
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        const auto cell = cells_.find({x_ / reach + dx, y_ / reach + dy});
        if (cell == cells_.end()) continue;
        for (const Key other : cell->second) consider(key, other, nearest);
      }
    }
    for (const auto& [session, found] : nearest) {
      if (to_index(step.closures.size()) == options_.most_closures) return;
      SE3d measured = noisy(truth_[static_cast<std::size_t>(found.second)].inverse() * pose, 5e-2, 3e-3);
      const bool lies = options_.outliers > 0.0 && rng_.uniform() < options_.outliers;
      if (lies) measured = noisy(measured, 5.0, 0.3);
      step.closures.push_back({found.second, measured, lies});
    }
  }

  void consider(Key key, Key other, std::map<Index, std::pair<double, Key>>& nearest) const {
    const Index session = sessions_[static_cast<std::size_t>(other)];
    if (session == session_ && key - other < 100) return;
    const double distance =
        (truth_[static_cast<std::size_t>(key)].translation() - truth_[static_cast<std::size_t>(other)].translation())
            .norm();
    if (distance > reach) return;
    const auto [place, added] = nearest.try_emplace(session, distance, other);
    if (!added && distance < place->second.first) place->second = {distance, other};
  }

  StreetWalkOptions options_;
  Rng rng_;
  Index session_ = 0, step_ = 0;  ///< of the next keyframe
  int x_ = 0, y_ = 0, heading_ = 0;
  std::vector<SE3d> truth_;
  std::vector<Index> sessions_;  ///< of each keyframe
  std::map<Cell, std::vector<Key>> cells_;
};

}  // namespace chainslam::test
