#include "chainslam/sparse/detail/arena.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// Arrays full of one number each, so that any overlap shows.
template <class T>
struct Arrays {
  struct Array {
    T* data;
    Offset size;
    T number;
  };
  detail::Arena<T> arena;
  std::vector<Array> live;
  Offset elements = 0;

  void take(Rng& rng) {
    const Offset size = rng.uniform_index(rng.uniform_index(10) == 0 ? 5000 : 100);
    const auto number = static_cast<T>(rng.uniform_index(1000000));
    live.push_back({arena.take(size), size, number});
    std::fill_n(live.back().data, size, number);
    elements += size;
  }
  void give_back(std::size_t k) {
    const Array array = live[k];
    CHECK(std::all_of(array.data, array.data + array.size, [&](T value) { return value == array.number; }));
    arena.give_back(array.data, array.size);
    elements -= array.size;
    live[k] = live.back();
    live.pop_back();
  }
};

}  // namespace

TEST_SUITE("sparse/arena") {
  TEST_CASE_TEMPLATE("arrays never overlap, and what is given back is used again", T, double, Index) {
    for_all(5, [](Rng& rng, int) {
      Arrays<T> arrays;
      for (int k = 0; k < 4000; ++k) {
        if (arrays.live.empty() || rng.uniform_index(100) < 55)
          arrays.take(rng);
        else
          arrays.give_back(static_cast<std::size_t>(rng.uniform_index(to_index(arrays.live.size()))));
      }
      const Offset capacity = arrays.arena.capacity();
      CHECK(static_cast<double>(capacity) < 2.0 * static_cast<double>(arrays.elements) + 65536.0);  // half a piece free
      for (int k = 0; k < 4000; ++k) {                                                              // as many in as out
        arrays.give_back(static_cast<std::size_t>(rng.uniform_index(to_index(arrays.live.size()))));
        arrays.take(rng);
      }
      CHECK(static_cast<double>(arrays.arena.capacity()) <
            1.6 * static_cast<double>(capacity) + 131072.0);  // one more piece
      while (!arrays.live.empty()) arrays.give_back(arrays.live.size() - 1);
    });
  }

  TEST_CASE("large arrays of many sizes take each other's place, whatever small ones stay between") {
    detail::Arena<double> arena;
    std::vector<std::pair<double*, Offset>> large;
    Offset elements = 0;
    Rng rng(1);
    for (int k = 0; k < 3000; ++k) {
      if (large.size() == 10) {
        const auto oldest = large.begin();
        arena.give_back(oldest->first, oldest->second);
        elements -= oldest->second;
        large.erase(oldest);
      }
      const Offset size = 20000 + rng.uniform_index(60000);
      large.push_back({arena.take(size), size});
      elements += size;
      static_cast<void>(arena.take(20));
      elements += 20;
    }
    CHECK(arena.capacity() < 4 * elements);
  }

  TEST_CASE("when all is given back, the largest pieces are whole again") {
    detail::Arena<double> arena;
    std::vector<double*> small;
    for (int k = 0; k < 1000; ++k) small.push_back(arena.take(30));
    const Offset capacity = arena.capacity();
    for (std::size_t k = 0; k < small.size(); k += 2) arena.give_back(small[k], 30);
    for (std::size_t k = 1; k < small.size(); k += 2) arena.give_back(small[k], 30);
    CHECK(arena.take(28000) != nullptr);
    CHECK(arena.capacity() == capacity);
  }

  TEST_CASE("movable arrays keep their numbers and owners, and little lies idle between them") {
    for_all(5, [](Rng& rng, int) {
      detail::Arena<double, true> arena;
      std::vector<std::vector<double>> expected(400);  // of each owner
      std::vector<double*> arrays(expected.size(), nullptr);
      Offset most = 0;
      for (int k = 0; k < 8000; ++k) {
        const Index owner = rng.uniform_index(to_index(arrays.size()));
        const auto i = static_cast<std::size_t>(owner);
        const auto count = static_cast<Offset>(expected[i].size());
        if (arrays[i] == nullptr) {
          // Larger ones later, for which no hole that was left before is large enough.
          const Offset size = 1 + rng.uniform_index(100 + k / 8);
          expected[i].resize(static_cast<std::size_t>(size));
          for (double& number : expected[i]) number = rng.uniform();
          arrays[i] = arena.take(size, owner);
          std::ranges::copy(expected[i], arrays[i]);
        } else {
          CHECK(std::equal(expected[i].begin(), expected[i].end(), arrays[i]));
          arena.give_back(arrays[i], count);
          arrays[i] = nullptr;
        }
        most = std::max(most, arena.used());
        if (k % 7 == 0) arena.compact([&](Index of, double* now) { arrays[static_cast<std::size_t>(of)] = now; });
      }
      CHECK(static_cast<double>(arena.capacity()) < 1.6 * static_cast<double>(most) + 65536.0);
      for (std::size_t i = 0; i < arrays.size(); ++i) {
        if (arrays[i] == nullptr) continue;
        CHECK(std::equal(expected[i].begin(), expected[i].end(), arrays[i]));
        arena.give_back(arrays[i], static_cast<Offset>(expected[i].size()));
      }
      CHECK(arena.used() == 0);
    });
  }
}
