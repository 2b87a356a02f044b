#include <benchmark/benchmark.h>

#include <array>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>

#include "chainslam/factor_graph/batch_optimizer.hpp"
#include "chainslam/factor_graph/chordal_initialization.hpp"
#include "chainslam/sparse/cholmod.hpp"
#include "eigen_ldlt.hpp"
#include "pose_graphs.hpp"
#include "versus.hpp"
#ifdef CHAINSLAM_PEER_CERES
#include "factor_graph/peers/ceres.hpp"
#endif
#ifdef CHAINSLAM_PEER_GTSAM
#include "factor_graph/peers/gtsam_batch.hpp"
#endif

namespace chainslam {
namespace {

using bench::Peer;

/// Gauss-Newton from the graph's values to its end, with symbolic analysis, as a program would call it.
template <class Solver, class Group>
OptimizeReport optimized(const FactorGraph<Group>& graph) {
  FactorGraph<Group> copy = graph;
  Solver solver;
  return optimize(copy, GaussNewton{}, solver);
}

/// From the chordal start, all alike. A peer that ends more than 1e-4 above our end has done less.
template <class Group>
void batch(benchmark::State& state, FactorGraph<Group> graph) {
  constexpr int dof = Group::dof;
  graph.set_values(chordal_initialization(graph).value());
  const OptimizeReport report = optimized<BlockCholesky<dof>>(graph);
  const std::array<double, 1> ours{report.final_cost};
  if (report.status != OptimizeStatus::converged) throw std::runtime_error("no optimum from the chordal start");
  bench::require_same_answers(ours, std::array{optimized<bench::EigenLdlt<dof>>(graph).final_cost}, 1e-7);
  bench::require_same_answers(ours, std::array{optimized<Cholmod<dof>>(graph).final_cost}, 1e-7);
#ifdef CHAINSLAM_PEER_CERES
  bench::CeresBatch<Group> ceres(graph);
  state.counters["ceres_over_optimum"] = graph.cost(ceres.optimized()) / report.final_cost;
#endif
#ifdef CHAINSLAM_PEER_GTSAM
  using Gtsam = bench::GtsamBatch<Group>;
  const Gtsam gtsam(graph, Gtsam::Jacobians::as_it_comes), exact(graph, Gtsam::Jacobians::exact);
  state.counters["gtsam_over_optimum"] = graph.cost(gtsam.optimized()) / report.final_cost;
  state.counters["gtsam_exact_over_optimum"] = graph.cost(exact.optimized()) / report.final_cost;
#endif
  bench::versus(
      state, [&] { return optimized<BlockCholesky<dof>>(graph).final_cost; },
#ifdef CHAINSLAM_PEER_CERES
      Peer{"ceres", [&] { return ceres.optimized().size(); }},
#endif
#ifdef CHAINSLAM_PEER_GTSAM
      Peer{"gtsam", [&] { return gtsam.optimized().size(); }},
      Peer{"gtsam_exact", [&] { return exact.optimized().size(); }},
#endif
      Peer{"eigen", [&] { return optimized<bench::EigenLdlt<dof>>(graph).final_cost; }},
      Peer{"cholmod", [&] { return optimized<Cholmod<dof>>(graph).final_cost; }});
  state.counters["poses"] = static_cast<double>(graph.values().size());
  state.counters["iterations"] = static_cast<double>(report.iterations);
  state.counters["chi2"] = report.final_cost;
}

/// What a mapper pays when it optimizes again after one more closure, from the optimum before it.
void closure(benchmark::State& state, Index keyframes) {
  PoseGraph graph = test::StreetWalk({.sessions = 1, .keyframes = keyframes}).graph();
  if (!optimize(graph).ok()) throw std::runtime_error("the first optimization failed");
  const Key last = graph.values().size() - 1;
  Vector6d bend = Vector6d::Zero();
  bend.head<3>().setConstant(0.3);
  const SE3d measured = graph[last / 2].inverse() * graph[last] * SE3d::exp(bend);
  graph.add_between(last / 2, last, measured, PoseGraph::Noise::from_sigma(0.05));
  for (auto _ : state) {
    PoseGraph copy = graph;
    benchmark::DoNotOptimize(optimize(copy, GaussNewton{.relative_tolerance = 1e-6}).final_cost);
  }
}

const bool registered = [] {
  bench::for_each_pose_graph([](const std::string& name, const auto& graph) {
    using Graph = std::remove_cvref_t<decltype(graph)>;
    const auto kept = std::make_shared<const Graph>(graph);
    benchmark::RegisterBenchmark(("factor_graph/batch/" + name).c_str(),
                                 [kept](benchmark::State& state) { batch(state, *kept); })
        ->UseManualTime()
        ->Iterations(3)  // some peers take long
        ->Unit(benchmark::kMillisecond);
  });
  for (const Index keyframes : {1000, 3000}) {
    benchmark::RegisterBenchmark(("factor_graph/closure/streets_1x" + std::to_string(keyframes)).c_str(),
                                 [keyframes](benchmark::State& state) { closure(state, keyframes); })
        ->Unit(benchmark::kMillisecond);
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
