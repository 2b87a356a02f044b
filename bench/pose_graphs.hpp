#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/io/g2o.hpp"

namespace chainslam::bench {

/// Sessions of a walk through streets, with the closures that a LiDAR mapper finds: long chains, few cycles.
///
/// Blocks of 50 m, a keyframe each metre, odometry noise 1 cm and 1 mrad a step, closures of 5 cm and 3 mrad: every 5th
/// keyframe closes on the nearest keyframe within 8 m of each earlier session and of its own, 100 keyframes back.
class StreetWalk {
 public:
  StreetWalk(Index sessions, Index keyframes, std::uint64_t seed) : rng_(seed) {
    for (Index session = 0; session < sessions; ++session) walk(session, keyframes);
    graph_.set_fixed(0);
  }

  [[nodiscard]] const PoseGraph& graph() const { return graph_; }

 private:
  static constexpr int block = 50, blocks = 8, reach = 8;
  using Cell = std::pair<int, int>;

  void walk(Index session, Index keyframes) {
    int x = session == 0 ? 0 : block * rng_.uniform_index(blocks + 1);
    int y = session == 0 ? 0 : block * rng_.uniform_index(blocks + 1);
    int heading = 0;
    for (Index step = 0; step < keyframes; ++step) {
      if (x % block == 0 && y % block == 0) heading = turn(x, y, heading);
      const Key key = add_keyframe(pose(x, y, heading), step == 0);
      session_.push_back(session);
      if (step % 5 == 0) close_loops(key);
      cells_[{x / reach, y / reach}].push_back(key);
      x += direction(heading).first;
      y += direction(heading).second;
    }
  }

  [[nodiscard]] static std::pair<int, int> direction(int heading) {
    constexpr std::array<int, 4> dx{1, 0, -1, 0};
    constexpr std::array<int, 4> dy{0, 1, 0, -1};
    return {dx[static_cast<std::size_t>(heading)], dy[static_cast<std::size_t>(heading)]};
  }

  /// Straight on, left or right, so as to stay in town.
  int turn(int x, int y, int heading) {
    for (;;) {
      const int next = (heading + rng_.uniform_index(3) + 3) % 4;
      const auto [dx, dy] = direction(next);
      const int to_x = x + dx * block, to_y = y + dy * block;
      if (std::min(to_x, to_y) >= 0 && std::max(to_x, to_y) <= block * blocks) return next;
      heading = (heading + 1) % 4;
    }
  }

  [[nodiscard]] static SE3d pose(int x, int y, int heading) {
    const Eigen::Vector3d position(x, y, 3.0 * std::sin(x / 60.0) * std::cos(y / 80.0));
    return SE3d(SO3d::exp(Eigen::Vector3d(0, 0, heading * std::numbers::pi / 2)), position);
  }

  [[nodiscard]] SE3d noisy(const SE3d& measured, double translation, double rotation) {
    Vector6d noise;
    for (int i = 0; i < 6; ++i) noise[i] = rng_.normal() * (i < 3 ? translation : rotation);
    return measured * SE3d::exp(noise);
  }

  Key add_keyframe(const SE3d& pose, bool starts) {
    truth_.push_back(pose);
    const auto key = static_cast<Key>(truth_.size() - 1);
    if (starts) {
      graph_.add_value(noisy(pose, 0.1, 0.01));
      graph_.add_prior(key, graph_[key], noise(0.1, 0.01));  // as from GNSS, so that a session without closure is held
      return key;
    }
    const SE3d step = noisy(truth_[truth_.size() - 2].inverse() * pose, 1e-2, 1e-3);
    graph_.add_value(graph_[key - 1] * step);
    graph_.add_between(key - 1, key, step, noise(1e-2, 1e-3));
    return key;
  }

  [[nodiscard]] static PoseGraph::Noise noise(double translation, double rotation) {
    Vector6d sigmas;
    sigmas << Eigen::Vector3d::Constant(translation), Eigen::Vector3d::Constant(rotation);
    return PoseGraph::Noise::from_sigmas(sigmas);
  }

  void close_loops(Key key) {
    const SE3d& pose = truth_[static_cast<std::size_t>(key)];
    const int cell_x = static_cast<int>(pose.translation()[0]) / reach;
    const int cell_y = static_cast<int>(pose.translation()[1]) / reach;
    std::map<Index, std::pair<double, Key>> nearest;  // of each session
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        const auto cell = cells_.find({cell_x + dx, cell_y + dy});
        if (cell == cells_.end()) continue;
        for (const Key other : cell->second) consider(key, other, nearest);
      }
    }
    for (const auto& [session, found] : nearest) {
      const Key other = found.second;
      const SE3d measured = noisy(truth_[static_cast<std::size_t>(other)].inverse() * pose, 5e-2, 3e-3);
      graph_.add_between(other, key, measured, noise(5e-2, 3e-3));
    }
  }

  void consider(Key key, Key other, std::map<Index, std::pair<double, Key>>& nearest) const {
    const Index session = session_[static_cast<std::size_t>(other)];
    if (session == session_[static_cast<std::size_t>(key)] && key - other < 100) return;
    const double distance =
        (truth_[static_cast<std::size_t>(key)].translation() - truth_[static_cast<std::size_t>(other)].translation())
            .norm();
    if (distance > reach) return;
    const auto [place, added] = nearest.try_emplace(session, distance, other);
    if (!added && distance < place->second.first) place->second = {distance, other};
  }

  Rng rng_;
  PoseGraph graph_;
  std::vector<SE3d> truth_;
  std::vector<Index> session_;
  std::map<Cell, std::vector<Key>> cells_;
};

/// Poses, edges and a first guess of a g2o file; its first pose fixed. Without vertices, the odometry is composed.
template <class Pose>
FactorGraph<Pose> graph_of(const G2oRecords<Pose>& records) {
  std::map<std::int64_t, Pose> poses;
  for (const auto& vertex : records.vertices) poses[vertex.id] = vertex.pose;
  if (poses.empty()) {
    Pose pose;
    poses[0] = pose;
    for (const auto& edge : records.edges) {
      if (edge.to == edge.from + 1 && poses.contains(edge.from))
        poses.emplace(edge.to, poses.at(edge.from) * edge.measurement);
    }
  }
  FactorGraph<Pose> graph;
  std::map<std::int64_t, Key> keys;
  for (const auto& [id, pose] : poses) keys[id] = graph.add_value(pose);
  for (const auto& edge : records.edges) {
    graph.add_between(keys.at(edge.from), keys.at(edge.to), edge.measurement,
                      NoiseModel<Pose::dof>::from_information(edge.information));
  }
  graph.set_fixed(0);
  return graph;
}

/// A real pose graph, if the data is at hand.
inline std::optional<G2oFile> real_pose_graph(const std::string& name) {
  const char* root = std::getenv("CHAINSLAM_UNPACKED_DATA");
  if (root == nullptr) return std::nullopt;
  const std::filesystem::path path = std::filesystem::path(root) / "pose_graphs" / (name + ".g2o");
  if (!std::filesystem::exists(path)) return std::nullopt;
  return read_g2o(path);
}

/// Calls bench(name, graph) for each graph: generated ones always, real ones where the data is at hand.
template <class Bench>
void for_each_pose_graph(Bench&& bench) {
  bench("streets_1x3000", StreetWalk(1, 3000, 1).graph());
  bench("streets_5x2000", StreetWalk(5, 2000, 1).graph());
  for (const char* name : {"sphere2500", "torus3D", "parking-garage", "ms5x2000", "ms5x2000_late"}) {
    if (const auto file = real_pose_graph(name)) bench(name, graph_of(file->spatial));
  }
  for (const char* name : {"manhattan", "city10000", "intel"}) {
    if (const auto file = real_pose_graph(name)) bench(name, graph_of(file->planar));
  }
}

}  // namespace chainslam::bench
