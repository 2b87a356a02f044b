#include "chainslam/factor_graph/detail/waiting_list.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <vector>

#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// Those that wait, in order of arrival.
std::vector<Index> list(const detail::WaitingList& waiting) {
  std::vector<Index> result;
  for (const Index key : waiting.keys()) {
    if (key != -1) result.push_back(key);
  }
  return result;
}

/// Compares with what was counted by a plain list.
void check_equal(const detail::WaitingList& waiting, const std::vector<Index>& expected, Index size) {
  CHECK(list(waiting) == expected);
  CHECK(waiting.count() == to_index(expected.size()));
  for (Index key = 0; key < size; ++key)
    CHECK(waiting.waits(key) == (std::find(expected.begin(), expected.end(), key) != expected.end()));
}

}  // namespace

TEST_SUITE("factor_graph/waiting_list") {
  TEST_CASE("who waits is listed in order of arrival, and what changed since begin is undone") {
    for_all(20, [](Rng& rng, int) {
      detail::WaitingList waiting;
      std::vector<Index> expected, before;
      Index size = 0, size_before = 0;
      for (int k = 0; k < 2000; ++k) {
        const Index what = rng.uniform_index(100);
        const Index key = size == 0 ? 0 : rng.uniform_index(size);
        if (size == 0 || what < 10) {
          waiting.add_variable();
          ++size;
        } else if (what < 50) {
          if (waiting.waits(key)) continue;
          waiting.wait(key);
          expected.push_back(key);
        } else if (what < 90) {
          waiting.stop(key);
          std::erase(expected, key);
        } else if (what < 95) {
          waiting.begin();
          before = expected;
          size_before = size;
        } else {
          waiting.undo();
          for (; size > size_before; --size) waiting.drop_last_variable();
          expected = before;
        }
        if (k % 20 == 0) check_equal(waiting, expected, size);
      }
      check_equal(waiting, expected, size);
    });
  }

  TEST_CASE("a saved list is loaded without gaps") {
    detail::WaitingList waiting;
    for (Index key = 0; key < 5; ++key) waiting.add_variable();
    for (const Index key : {3, 1, 4}) waiting.wait(key);
    waiting.stop(1);
    ByteSink out;
    waiting.save(out);
    ByteSource in(out.bytes());
    detail::WaitingList loaded;
    loaded.load(in, 5);
    check_equal(loaded, {3, 4}, 5);
    CHECK(loaded.keys().size() == 2);
    loaded.stop(3);
    loaded.undo();
    check_equal(loaded, {3, 4}, 5);
  }
}
