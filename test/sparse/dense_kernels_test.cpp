#include "chainslam/sparse/dense_kernels.hpp"

#include <doctest/doctest.h>

#include <cstddef>
#include <vector>

#include "chainslam/core/random.hpp"
#include "support/property.hpp"

using namespace chainslam;

namespace {

/// Element by element, in the order in which the kernel adds.
template <int Columns>
std::vector<double> product(detail::Accumulate how, Offset rows, const std::vector<double>& a,
                            const std::vector<double>& b, Offset stride, Offset depth, std::vector<double> c) {
  const auto at = [&](Offset row, Offset column) { return static_cast<std::size_t>(column * stride + row); };
  for (Offset j = 0; j < Columns; ++j)
    for (Offset i = 0; i < rows; ++i) {
      double sum = 0;
      for (Offset k = 0; k < depth; ++k) sum += a[at(i, k)] * b[at(j, k)];
      c[at(i, j)] += how == detail::Accumulate::add ? sum : -sum;
    }
  return c;
}

template <int Columns>
void check_product(Rng& rng) {
  const Offset rows = rng.uniform_index(50), depth = rng.uniform_index(20), stride = 64;
  const auto numbers = [&] {
    std::vector<double> drawn(static_cast<std::size_t>(stride * 24));
    for (double& number : drawn) number = rng.normal();
    return drawn;
  };
  const std::vector<double> a = numbers(), b = numbers(), c = numbers();
  for (const auto how : {detail::Accumulate::add, detail::Accumulate::subtract}) {
    CAPTURE(rows);
    CAPTURE(depth);
    const std::vector<double> expected = product<Columns>(how, rows, a, b, stride, depth, c);
    std::vector<double> found = c;
    detail::accumulate_product<Columns>(how, rows, a.data(), stride, b.data(), stride, depth, found.data(), stride);
#ifdef __FMA__  // products are not rounded
    for (std::size_t k = 0; k < found.size(); ++k) REQUIRE(found[k] == doctest::Approx(expected[k]).epsilon(1e-12));
#else
    REQUIRE(found == expected);
#endif
  }
}

}  // namespace

TEST_SUITE("sparse/dense_kernels") {
  TEST_CASE("products are bit-identical to plain sums, whatever registers the processor has, and touch nothing else") {
    test::for_all(200, [](Rng& rng, Index) {
      check_product<1>(rng);
      check_product<3>(rng);
      check_product<6>(rng);
      check_product<12>(rng);
    });
  }
}
