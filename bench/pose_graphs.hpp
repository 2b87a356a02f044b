#pragma once

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "../test/support/edge_noise.hpp"
#include "../test/support/street_walk.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/io/g2o.hpp"

namespace chainslam::bench {

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
    graph.add_between(keys.at(edge.from), keys.at(edge.to), edge.measurement, test::edge_noise<Pose>(edge.information));
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
  bench("streets_1x3000", test::StreetWalk({.sessions = 1, .keyframes = 3000}).graph());
  bench("streets_5x2000", test::StreetWalk({}).graph());
  for (const char* name : {"sphere2500", "torus3D", "parking-garage", "cubicle", "ms5x2000", "ms5x2000_late"}) {
    if (const auto file = real_pose_graph(name)) bench(name, graph_of(file->spatial));
  }
  for (const char* name : {"manhattan", "city10000", "intel"}) {
    if (const auto file = real_pose_graph(name)) bench(name, graph_of(file->planar));
  }
}

}  // namespace chainslam::bench
