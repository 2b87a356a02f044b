#include "chainslam/sparse/concepts.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <span>
#include <string>
#include <vector>

#include "chainslam/sparse/cholmod.hpp"
#include "chainslam/sparse/detail/elimination_tree.hpp"
#include "chainslam/sparse/detail/quotient_graph.hpp"
#include "chainslam/sparse/detail/supernodes.hpp"
#include "sparse/patterns.hpp"
#include "support/property.hpp"
#include "support/real_data.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

struct NoOrder {
  int operator()(const BlockPattern&) const { return 0; }
};
static_assert(!Ordering<NoOrder>);

bool is_permutation(std::vector<Index> order, Index size) {
  std::ranges::sort(order);
  std::vector<Index> expected(static_cast<std::size_t>(size));
  std::iota(expected.begin(), expected.end(), 0);
  return order == expected;
}

/// Blocks of the factor when columns are eliminated in `order`.
Offset fill(const BlockPattern& pattern, const std::vector<Index>& order) {
  namespace sparse = chainslam::detail;
  const BlockPattern ordered = sparse::permuted(pattern, sparse::inverse_permutation(sparse::Table<Index>(order)));
  const std::vector<Index> counts = detail::factor_column_counts(ordered, detail::elimination_tree(ordered));
  return std::accumulate(counts.begin(), counts.end(), Offset{0});
}

BlockPattern lattice(Index side) {
  std::vector<BlockCoordinate> blocks;
  for (Index y = 0; y < side; ++y) {
    for (Index x = 0; x < side; ++x) {
      if (x > 0) blocks.push_back({y * side + x, y * side + x - 1});
      if (y > 0) blocks.push_back({y * side + x, (y - 1) * side + x});
    }
  }
  return BlockPattern(side * side, blocks);
}

}  // namespace

TEST_SUITE("sparse/ordering") {
  TEST_CASE_TEMPLATE("an order is a permutation, the same every time", Order, Natural, Amd, NestedDissection) {
    for_all(100, [](Rng& rng, int size) {
      const BlockPattern pattern = random_pattern(rng, size, rng.uniform(0.0, 3.0));
      const std::vector<Index> order = Order{}(pattern);
      CHECK(is_permutation(order, size));
      CHECK(order == Order{}(pattern));
    });
  }

  TEST_CASE("nodes of later groups are eliminated after those of earlier ones, whatever cliques there are") {
    for_all(100, [](Rng& rng, int size) {
      const BlockPattern pattern = random_pattern(rng, size, rng.uniform(0.0, 3.0));
      std::vector<std::vector<Index>> cliques(static_cast<std::size_t>(rng.uniform_index(4)));
      for (std::vector<Index>& clique : cliques) {
        for (Index node = 0; node < size; ++node) {
          if (rng.uniform_index(3) == 0) clique.push_back(node);
        }
      }
      const std::vector<std::span<const Index>> elements(cliques.begin(), cliques.end());
      std::vector<Index> late(static_cast<std::size_t>(rng.uniform_index(4)));
      for (Index& first : late) first = rng.uniform_index(size + 1);
      std::ranges::sort(late);  // some groups empty
      const detail::Table<Index> order = detail::QuotientGraph(pattern, elements, late).eliminate();
      const std::vector<Index> listed(order.begin(), order.end());
      CHECK(is_permutation(listed, size));
      CHECK(std::ranges::is_sorted(listed, {}, [&](Index node) { return detail::group_of(late, node); }));
    });
  }

  TEST_CASE("minimum degree leaves no fill on trees") {
    for_all(50, [](Rng& rng, int size) {
      std::vector<BlockCoordinate> blocks;
      for (Index k = 1; k < size; ++k) blocks.push_back({k, rng.uniform_index(k)});
      const BlockPattern tree(size, blocks);
      CHECK(fill(tree, Amd{}(tree)) == tree.blocks());
    });
  }

  TEST_CASE("minimum degree joins what cannot be told apart: a full matrix, a star, nothing at all") {
    std::vector<BlockCoordinate> all;
    std::vector<BlockCoordinate> star;
    for (Index i = 0; i < 300; ++i) {
      star.push_back({i, 150});
      for (Index j = 0; j < i; ++j) all.push_back({i, j});
    }
    CHECK(is_permutation(Amd{}(BlockPattern(300, all)), 300));
    const BlockPattern hub(300, star);  // the hub has more neighbours than 10 sqrt(n): it goes last
    CHECK(Amd{}(hub).back() == 150);
    CHECK(fill(hub, Amd{}(hub)) == hub.blocks());
    CHECK(is_permutation(Amd{}(BlockPattern(300, {})), 300));
    CHECK(Amd{}(BlockPattern()).empty());
  }

  TEST_CASE("fill on a lattice stays near n log n") {
    const BlockPattern pattern = lattice(100);
    const Offset ours = fill(pattern, Amd{}(pattern));
    const double n_log_n = 1e4 * std::log2(1e4);
    CHECK(static_cast<double>(ours) < 2.5 * n_log_n);
    CHECK(fill(pattern, Natural{}(pattern)) > 3 * ours);
  }

  TEST_CASE("nested dissection leaves less fill on large lattices, the more so in space") {
    const BlockPattern flat = lattice(300);
    const Offset by_degree = fill(flat, Amd{}(flat)), by_parts = fill(flat, NestedDissection{}(flat));
    MESSAGE("in the plane ", by_degree, " blocks, ", by_parts);
    CHECK(by_parts < by_degree);
    constexpr Index side = 20;
    std::vector<BlockCoordinate> blocks;
    for (Index i = 0; i < side * side * side; ++i)
      for (const Index stride : {1, side, side * side})
        if (i / stride % side > 0) blocks.push_back({i, i - stride});
    const BlockPattern cube(side * side * side, blocks);
    const Offset cube_by_degree = fill(cube, Amd{}(cube)), cube_by_parts = fill(cube, NestedDissection{}(cube));
    MESSAGE("in space ", cube_by_degree, " blocks, ", cube_by_parts);
    CHECK(5 * cube_by_parts < 4 * cube_by_degree);
  }

  TEST_CASE("fill on real pose graphs is at most 5 % above that of CHOLMOD's AMD") {
    for (const char* name : {"sphere2500", "torus3D", "parking-garage", "cubicle", "city10000", "ms5x2000"}) {
      const auto path = real_data(std::string("pose_graphs/") + name + ".g2o");
      if (!path) continue;
      const BlockPattern pattern = pose_graph_pattern(*path);
      Cholmod<1> peer(Cholmod<1>::Method::simplicial);
      peer.analyze(pattern);
      const Offset ours = fill(pattern, Amd{}(pattern));
      std::printf("fill on %s: %lld blocks, CHOLMOD's AMD %lld\n", name, static_cast<long long>(ours),
                  static_cast<long long>(peer.stored_coefficients()));
      CHECK(static_cast<double>(ours) <= 1.05 * static_cast<double>(peer.stored_coefficients()));
    }
  }
}
