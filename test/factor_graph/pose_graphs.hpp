#pragma once

#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/factor_graph/factor_graph.hpp"
#include "chainslam/io/g2o.hpp"
#include "chainslam/lie/se2.hpp"
#include "support/edge_noise.hpp"

namespace chainslam::test {

/// The variables of a g2o file in the order of their ids; where the file has none, its odometry (i to i + 1) composed.
template <class Graph, class Pose>
std::map<std::int64_t, Key> add_variables(Graph& graph, const G2oRecords<Pose>& records) {
  std::map<std::int64_t, Pose> poses;
  for (const auto& vertex : records.vertices) poses[vertex.id] = vertex.pose;
  if (poses.empty()) {
    std::map<std::int64_t, Pose> steps;
    for (const auto& edge : records.edges) {
      if (edge.to == edge.from + 1) steps.emplace(edge.from, edge.measurement);
    }
    Pose pose;
    poses[steps.begin()->first] = pose;
    for (const auto& [from, step] : steps) poses[from + 1] = pose = pose * step;
  }
  std::map<std::int64_t, Key> keys;
  for (const auto& [id, pose] : poses) keys[id] = graph.add_value(pose);
  return keys;
}

/// The graph of a g2o file, its first variable fixed.
template <class Pose>
FactorGraph<Pose> make_graph(const G2oRecords<Pose>& records) {
  FactorGraph<Pose> graph;
  const std::map<std::int64_t, Key> keys = add_variables(graph, records);
  for (const auto& edge : records.edges) {
    graph.add_between(keys.at(edge.from), keys.at(edge.to), edge.measurement, edge_noise<Pose>(edge.information));
  }
  graph.set_fixed(0);
  return graph;
}

/// A between factor in the plane with the residual (R_z^T (dt - t_z), dtheta - theta_z), which published optima of
/// planar graphs mean; a user's own factor, as far as the graph is concerned.
struct PlanarBetween {
  using Value = SE2d;
  static constexpr std::size_t arity = 2;
  static constexpr int rows = 3;

  Key from, to;
  SE2d measurement;
  SqrtInformation<3> sqrt_information;

  std::array<Key, arity> keys() const { return {from, to}; }
  Eigen::Vector3d residual(const Values<SE2d>& values) const {
    const SE2d error = measurement.inverse() * (values[from].inverse() * values[to]);
    return sqrt_information * Eigen::Vector3d(error.translation()[0], error.translation()[1], error.rotation().angle());
  }
  LinearizedFactor<3, 3, 2> linearize(const Values<SE2d>& values) const {
    const SE2d T_from_to = values[from].inverse() * values[to];
    Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
    rotation.topLeftCorner<2, 2>() = (measurement.inverse() * T_from_to).rotation().matrix();
    LinearizedFactor<3, 3, 2> result;
    result.residual = residual(values);
    result.jacobians[1] = sqrt_information * rotation;
    result.jacobians[0] = -result.jacobians[1] * T_from_to.inverse().adjoint();
    return result;
  }
};

/// The same for a planar file and these residuals.
inline FactorGraph<SE2d, PlanarBetween> make_planar_graph(const G2oRecords<SE2d>& records) {
  FactorGraph<SE2d, PlanarBetween> graph;
  const std::map<std::int64_t, Key> keys = add_variables(graph, records);
  for (const auto& edge : records.edges) {
    graph.add(PlanarBetween{keys.at(edge.from), keys.at(edge.to), edge.measurement,
                            NoiseModel<3>::from_information(edge.information).sqrt_information()});
  }
  graph.set_fixed(0);
  return graph;
}

template <class Group>
typename Group::Tangent random_tangent(Rng& rng, double translation, double rotation) {
  typename Group::Tangent tangent;
  for (int i = 0; i < Group::dof; ++i) tangent[i] = rng.normal() * (i < (Group::dof + 1) / 2 ? translation : rotation);
  return tangent;
}

template <class Group>
Group random_pose(Rng& rng) {
  return Group::exp(random_tangent<Group>(rng, 5.0, 0.8));
}

/// A random square root of an information matrix, well conditioned.
template <int Dof>
NoiseModel<Dof> random_noise(Rng& rng) {
  using Matrix = typename NoiseModel<Dof>::Matrix;
  const Matrix noise = Matrix::NullaryExpr([&](Eigen::Index, Eigen::Index) { return rng.normal(); });
  return NoiseModel<Dof>::from_sqrt_information(3.0 * Matrix::Identity() + 0.5 * noise);
}

/// A walk of `size` random steps with closures between random poses, the measurements noisy by `sigma`; poses start
/// from the composed odometry. Nothing holds it in place.
template <class Group>
FactorGraph<Group> random_graph(Rng& rng, Index size, double sigma) {
  FactorGraph<Group> graph;
  std::vector<Group> truth;
  const auto noise = NoiseModel<Group::dof>::from_sigma(sigma);
  const auto measure = [&](Key from, Key to) {
    const auto at = [&](Key key) -> const Group& { return truth[static_cast<std::size_t>(key)]; };
    return at(from).inverse() * at(to) * Group::exp(random_tangent<Group>(rng, sigma, sigma));
  };
  for (Key key = 0; key < size; ++key) {
    if (key == 0) {
      truth.push_back(random_pose<Group>(rng));
      graph.add_value(truth.back());
      continue;
    }
    truth.push_back(truth.back() * Group::exp(random_tangent<Group>(rng, 1.0, 0.3)));
    const Group step = measure(key - 1, key);
    graph.add_value(graph[key - 1] * step);
    graph.add_between(key - 1, key, step, noise);
  }
  for (Key key = 2; key < size; key += 2) {
    const Key other = rng.uniform_index(key - 1);
    graph.add_between(other, key, measure(other, key), noise);
  }
  return graph;
}

}  // namespace chainslam::test
