#include "chainslam/sparse/cholesky.hpp"

#include <benchmark/benchmark.h>

#include <memory>
#include <string>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/factor_graph/detail/normal_equations.hpp"
#include "chainslam/sparse/cholmod.hpp"
#include "eigen_ldlt.hpp"
#include "pose_graphs.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

using bench::EigenLdlt;
using bench::Peer;

/// One linear system of a graph: its normal equations at the first guess.
template <class Group>
struct System {
  static constexpr int dof = Group::dof;

  explicit System(const FactorGraph<Group>& graph) : equations(graph) { equations.linearize(graph, graph.values()); }

  [[nodiscard]] std::vector<double> right() const {
    return {equations.gradient().data(), equations.gradient().data() + equations.gradient().size()};
  }

  detail::NormalEquations<FactorGraph<Group>> equations;
};

template <class Solver, class Group>
void prepare(Solver& solver, const System<Group>& system) {
  solver.analyze(system.equations.matrix().pattern());
  if (!solver.factorize(system.equations.matrix()).ok()) throw std::runtime_error("the system is not definite");
}

template <class Solver, class Group>
std::vector<double> solution(Solver& solver, const System<Group>& system) {
  std::vector<double> x = system.right();
  solver.solve(x);
  return x;
}

/// CHOLMOD by the faster of its two ways on this system: the supernodal one gains by a good BLAS and large fronts.
template <class Group>
typename Cholmod<Group::dof>::Method faster_method(const System<Group>& system) {
  using Solver = Cholmod<Group::dof>;
  const auto seconds = [&](typename Solver::Method method) {
    Solver solver(method);
    prepare(solver, system);
    const auto run = [&] { return solver.factorize(system.equations.matrix()).ok(); };
    return bench::detail::seconds<bench::ThreadTime>(run, 2);
  };
  const bool supernodal = seconds(Solver::Method::supernodal) < seconds(Solver::Method::simplicial);
  return supernodal ? Solver::Method::supernodal : Solver::Method::simplicial;
}

template <class Group>
struct Solvers {
  explicit Solvers(const System<Group>& system) : cholmod(faster_method(system)) {
    prepare(ours, system);
    prepare(eigen, system);
    prepare(cholmod, system);
    const std::vector<double> x = solution(ours, system);
    double largest = 0.0;
    for (const double value : x) largest = std::max(largest, std::abs(value));
    // The systems' condition numbers reach 1e9.
    bench::require_same_answers(x, solution(eigen, system), 1e-4, 1e-6 * largest);
    bench::require_same_answers(x, solution(cholmod, system), 1e-4, 1e-6 * largest);
  }

  BlockCholesky<Group::dof> ours;
  EigenLdlt<Group::dof> eigen;
  Cholmod<Group::dof> cholmod;
};

template <class Group, class Run>
void add(const std::string& name, std::shared_ptr<const System<Group>> system, Run run) {
  benchmark::RegisterBenchmark(
      name.c_str(),
      [system, run](benchmark::State& state) {
        Solvers<Group> solvers(*system);
        const auto of = [&](auto& solver) { return [&] { return run(solver, *system); }; };
        bench::versus(state, of(solvers.ours), Peer{"eigen", of(solvers.eigen)}, Peer{"cholmod", of(solvers.cholmod)});
        state.counters["poses"] = static_cast<double>(system->equations.size());
        state.counters["factor_coefficients"] = static_cast<double>(solvers.ours.stored_coefficients());
      })
      ->UseManualTime()
      ->Unit(benchmark::kMillisecond);
}

/// Of the wall: two threads and one.
template <class Group>
void add_two_threads(const std::string& name, std::shared_ptr<const System<Group>> system) {
  benchmark::RegisterBenchmark(name.c_str(),
                               [system](benchmark::State& state) {
                                 const ThreadPool pool(2);
                                 ParallelCholesky<Group::dof, ThreadPool> two(pool);
                                 BlockCholesky<Group::dof> one;
                                 prepare(two, *system);
                                 prepare(one, *system);
                                 if (solution(two, *system) != solution(one, *system))
                                   throw std::runtime_error("two threads give other bits");
                                 const auto run = [&](auto& solver) {
                                   return [&] { return solver.factorize(system->equations.matrix()).ok(); };
                                 };
                                 bench::versus<bench::WallTime>(state, run(two), Peer{"one_thread", run(one)});
                               })
      ->UseManualTime()
      ->Unit(benchmark::kMillisecond);
}

const bool registered = [] {
  bench::for_each_pose_graph([](const std::string& graph_name, const auto& graph) {
    using Group = typename std::remove_cvref_t<decltype(graph)>::Value;
    const auto system = std::make_shared<const System<Group>>(graph);
    add<Group>("sparse/analyze/" + graph_name, system, [](auto& solver, const System<Group>& s) {
      solver.analyze(s.equations.matrix().pattern());
      return true;
    });
    add<Group>("sparse/factorize/" + graph_name, system,
               [](auto& solver, const System<Group>& s) { return solver.factorize(s.equations.matrix()).ok(); });
    add_two_threads<Group>("sparse/factorize_two_threads/" + graph_name, system);
    add<Group>("sparse/solve/" + graph_name, system,
               [](auto& solver, const System<Group>& s) { return solution(solver, s); });
  });
  return true;
}();

}  // namespace
}  // namespace chainslam
