#include "chainslam/sparse/dense_kernels.hpp"

#include <benchmark/benchmark.h>

#include <vector>

#include "chainslam/core/random.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

/// What a front of so many rows takes off for as many columns, by the registers that the processor has; and by pairs of
/// doubles, all that a program for any x86-64 may count on.
void product(benchmark::State& state) {
  constexpr int block = 6;
  const auto rows = static_cast<Offset>(state.range(0));
  Rng rng(1);
  const auto numbers = [&](Offset columns) {
    std::vector<double> drawn(static_cast<std::size_t>(rows * columns));
    for (double& number : drawn) number = rng.normal();
    return drawn;
  };
  const std::vector<double> a = numbers(rows);
  std::vector<double> c = numbers(block);
  const auto ours = [&] {
    detail::accumulate_product<block>(detail::Accumulate::subtract, rows, a.data(), rows, a.data(), rows, rows,
                                      c.data(), rows);
    return c[0];
  };
  const auto by_pairs = [&] {
    detail::product_tiles<block, 2>(detail::Accumulate::subtract, rows, a.data(), rows, a.data(), rows, rows, c.data(),
                                    rows);
    return c[0];
  };
  bench::versus(state, "sse2", ours, by_pairs);
}
BENCHMARK(product)->Name("sparse/dense_kernels/product")->ArgName("rows")->Arg(60)->Arg(240)->Arg(720)->UseManualTime();

}  // namespace
}  // namespace chainslam
