#include <array>
#include <numeric>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/adjacency_graph.hpp"
#include "chainslam/slam/breadth_first_search.hpp"
#include "chainslam/slam/connected_components.hpp"
#include "versus.hpp"

#ifdef CHAINSLAM_BENCH_BOOST
#include <boost/graph/adjacency_list.hpp>
#include <boost/graph/breadth_first_search.hpp>
#include <boost/graph/compressed_sparse_row_graph.hpp>
#include <boost/pending/disjoint_sets.hpp>
#endif

namespace chainslam {
namespace {

using bench::Peer;
using bench::versus;

constexpr Index nodes = 1'000'000;

struct Ends {
  Index a;
  Index b;
};
using Edges = std::vector<Ends>;
using Graph = AdjacencyGraph<Index>;  // an edge carries the position of its closure

/// What loop closing adds: every second keyframe meets a place seen before, and with it a run of eight keyframes.
Edges closures_of_keyframes() {
  Rng rng(1);
  Edges edges;
  for (Index i = 1; i < nodes; ++i) {
    if (rng.uniform() < 0.5) continue;
    const Index first = rng.uniform_index(i);
    for (Index j = first; j < std::min(first + 8, i); ++j) edges.push_back({i, j});
  }
  return edges;
}

Edges random_edges(std::size_t count) {
  Rng rng(2);
  Edges edges;
  for (std::size_t i = 0; i < count; ++i) {
    const Index a = rng.uniform_index(nodes);
    edges.push_back({a, rng.uniform_index(nodes)});
  }
  return edges;
}

/// Components of the same size whose nodes lie far apart, as keyframes of many sessions at one place do; four edges a
/// node.
Edges components_of(Index size) {
  Rng rng(3);
  const Index components = nodes / size;
  Edges edges;
  for (Index i = 1; i < size; ++i)
    for (Index component = 0; component < components; ++component)
      for (int k = 0; k < 4; ++k)
        edges.push_back({i * components + component, rng.uniform_index(i) * components + component});
  return edges;
}

template <class Made>
void add_all(Made& graph, const Edges& edges) {
  Index closure = 0;
  for (const Ends& edge : edges) graph.add_edge(edge.a, edge.b, closure++);
}

/// The plain way to grow: a vector for each node.
class VectorOfVectors {
 public:
  explicit VectorOfVectors(Index count) : arcs_(static_cast<std::size_t>(count)) {}
  void add_edge(Index a, Index b, Index edge) {
    arcs_[static_cast<std::size_t>(a)].push_back({b, edge});
    arcs_[static_cast<std::size_t>(b)].push_back({a, edge});
  }
  [[nodiscard]] Index degree(Index node) const {
    return static_cast<Index>(arcs_[static_cast<std::size_t>(node)].size());
  }

 private:
  std::vector<std::vector<Arc<Index>>> arcs_;
};

#ifdef CHAINSLAM_BENCH_BOOST
using BoostBase = boost::adjacency_list<boost::vecS, boost::vecS, boost::undirectedS, boost::no_property, Index>;
using BoostRows = boost::compressed_sparse_row_graph<boost::directedS, boost::no_property, boost::no_property,
                                                     boost::no_property, std::uint32_t, std::uint32_t>;

class BoostGraph : public BoostBase {
 public:
  explicit BoostGraph(Index count) : BoostBase(static_cast<std::size_t>(count)) {}
  void add_edge(Index a, Index b, Index edge) {
    boost::add_edge(static_cast<std::size_t>(a), static_cast<std::size_t>(b), edge, *this);
  }
  [[nodiscard]] Index degree(Index node) const {
    return static_cast<Index>(boost::out_degree(static_cast<std::size_t>(node), *this));
  }
};

BoostRows boost_rows(const Edges& edges) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> both;
  for (const Ends& edge : edges) {
    both.emplace_back(edge.a, edge.b);
    both.emplace_back(edge.b, edge.a);
  }
  return {boost::edges_are_unsorted_multi_pass, both.begin(), both.end(), nodes};
}

/// Boost's search at its best: a queue that is an array made once, and colours of which only those touched are taken
/// back.
template <class Searched>
class BoostSearch {
 public:
  using Vertex = typename boost::graph_traits<Searched>::vertex_descriptor;

  explicit BoostSearch(const Searched& graph) : graph_(graph), colors_(nodes, boost::white_color) {
    queue_.order.resize(nodes);
  }

  std::size_t run(Index start) {
    queue_.next = queue_.count = 0;
    const auto map = boost::make_iterator_property_map(colors_.begin(), boost::get(boost::vertex_index, graph_));
    boost::breadth_first_visit(graph_, static_cast<Vertex>(start), queue_, boost::default_bfs_visitor(), map);
    for (std::size_t i = 0; i < queue_.count; ++i) colors_[queue_.order[i]] = boost::white_color;
    return queue_.count + queue_.order[queue_.count / 2];
  }

 private:
  struct Queue {
    std::vector<Vertex> order;
    std::size_t next = 0;
    std::size_t count = 0;

    void push(Vertex v) { order[count++] = v; }
    void pop() { ++next; }
    [[nodiscard]] Vertex top() const { return order[next]; }
    [[nodiscard]] bool empty() const { return next == count; }
  };

  const Searched& graph_;
  std::vector<boost::default_color_type> colors_;
  Queue queue_;
};

/// Boost's union by rank and path halving, on the smallest arrays that do.
class BoostComponents {
 public:
  BoostComponents() : rank_(nodes, 0), parent_(nodes), sets_(Ranks(rank_.data()), Parents(parent_.data())) {
    std::iota(parent_.begin(), parent_.end(), 0U);
  }
  bool connect(Index a, Index b) {
    const std::uint32_t root_a = sets_.find_set(static_cast<std::uint32_t>(a));
    const std::uint32_t root_b = sets_.find_set(static_cast<std::uint32_t>(b));
    if (root_a == root_b) return false;
    sets_.link(root_a, root_b);
    return true;
  }
  bool same(Index a, Index b) {
    return sets_.find_set(static_cast<std::uint32_t>(a)) == sets_.find_set(static_cast<std::uint32_t>(b));
  }

 private:
  using Place = boost::typed_identity_property_map<std::uint32_t>;
  using Ranks = boost::iterator_property_map<std::uint8_t*, Place>;
  using Parents = boost::iterator_property_map<std::uint32_t*, Place>;

  std::vector<std::uint8_t> rank_;
  std::vector<std::uint32_t> parent_;
  boost::disjoint_sets<Ranks, Parents, boost::find_with_path_halving> sets_;
};
#endif

template <class Made>
std::size_t build(const Edges& edges) {
  Made graph(nodes);
  add_all(graph, edges);
  return static_cast<std::size_t>(graph.degree(edges.back().a) + graph.degree(edges.front().b));
}

template <class Components>
std::size_t connect_all(const Edges& edges) {
  Components components = [] {
    if constexpr (std::is_constructible_v<Components, Index>) {
      return Components(nodes);
    } else {
      return Components();
    }
  }();
  std::size_t joined = 0;
  for (const Ends& edge : edges) joined += components.connect(edge.a, edge.b) ? 1 : 0;
  return joined;
}

void require_same(std::size_t ours, std::size_t theirs) {
  bench::require_same_answers(std::array{static_cast<double>(ours)}, std::array{static_cast<double>(theirs)}, 0, 0);
}

/// Edges into a graph of a million nodes; the time of throwing the graph away is in it, for all alike.
void insert(benchmark::State& state, const Edges& edges) {
  const auto ours = [&] { return build<Graph>(edges); };
  const Peer vectors{"vector_of_vectors", [&] { return build<VectorOfVectors>(edges); }};
  require_same(ours(), vectors.run());
#ifdef CHAINSLAM_BENCH_BOOST
  const Peer boost{"boost", [&] { return build<BoostGraph>(edges); }};
  require_same(ours(), boost.run());
  versus(state, ours, vectors, boost);
#else
  versus(state, ours, vectors);
#endif
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(edges.size()));
  Graph graph(nodes);
  add_all(graph, edges);
  state.counters["bytes_per_edge"] = static_cast<double>(graph.memory()) / static_cast<double>(edges.size());
}
void insert_keyframes(benchmark::State& state) { insert(state, closures_of_keyframes()); }
void insert_random(benchmark::State& state) { insert(state, random_edges(4 * nodes)); }

/// Searches of whole components in a graph of a million nodes, from starts that are far apart.
void search(benchmark::State& state) {
  const auto size = static_cast<Index>(state.range(0));
  const Edges edges = components_of(size);
  Graph graph(nodes);
  add_all(graph, edges);
  const Index components = nodes / size;
  const Index searches = std::min(components, std::max(1, 100'000 / size));
  const auto search_all = [&](auto&& run) {
    std::size_t sum = 0;
    for (Index i = 0; i < searches; ++i) sum += run((i * 7919) % components);
    return sum;
  };
  struct Nothing {
    void finish(Index /*node*/) const {}
  };
  BfsWorkspace workspace;
  const auto ours = [&] {
    return search_all([&](Index start) {
      const Index count = breadth_first_search(graph, start, Nothing{}, {}, workspace).nodes;
      return static_cast<std::size_t>(count) + static_cast<std::size_t>(workspace[count / 2]);
    });
  };
#ifdef CHAINSLAM_BENCH_BOOST
  BoostGraph list(nodes);
  add_all(list, edges);
  BoostSearch<BoostBase> search_list(list);
  const Peer boost_list{"boost_list", [&] { return search_all([&](Index start) { return search_list.run(start); }); }};
  const BoostRows rows = boost_rows(edges);
  BoostSearch<BoostRows> search_rows(rows);
  const Peer boost_rows{"boost_rows", [&] { return search_all([&](Index start) { return search_rows.run(start); }); }};
  require_same(ours(), boost_list.run());
  versus(state, ours, boost_list, boost_rows);
#else
  versus(state, ours);
#endif
  state.SetItemsProcessed(state.iterations() * searches * size);
}

/// Edges, one after another, into components of a million nodes. Ours can also list members and knows the largest.
void connect(benchmark::State& state, const Edges& edges) {
  const auto ours = [&] { return connect_all<ConnectedComponents>(edges); };
#ifdef CHAINSLAM_BENCH_BOOST
  const Peer boost{"boost", [&] { return connect_all<BoostComponents>(edges); }};
  require_same(ours(), boost.run());
  versus(state, ours, boost);
#else
  versus(state, ours);
#endif
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(edges.size()));
}
void connect_keyframes(benchmark::State& state) { connect(state, closures_of_keyframes()); }
void connect_random(benchmark::State& state) { connect(state, random_edges(nodes)); }

BENCHMARK(insert_keyframes)
    ->Name("graph/adjacency_graph/insert_keyframes")
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(insert_random)->Name("graph/adjacency_graph/insert_random")->UseManualTime()->Unit(benchmark::kMillisecond);
BENCHMARK(search)
    ->Name("graph/breadth_first_search/component")
    ->ArgName("nodes")
    ->Arg(10)
    ->Arg(100)
    ->Arg(10'000)
    ->Arg(nodes)
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(connect_keyframes)
    ->Name("graph/connected_components/connect_keyframes")
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK(connect_random)
    ->Name("graph/connected_components/connect_random")
    ->UseManualTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace chainslam
