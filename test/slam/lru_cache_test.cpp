#include "chainslam/slam/detail/lru_cache.hpp"

#include <doctest/doctest.h>

#include <string>

using namespace chainslam;

TEST_SUITE("slam/lru_cache") {
  TEST_CASE("the least recently used go when the bytes are spent") {
    detail::LruCache<int, std::string> cache(100);
    cache.insert(1, "one", 40);
    cache.insert(2, "two", 40);
    REQUIRE(cache.find(1) != nullptr);
    CHECK(*cache.find(1) == "one");
    cache.insert(3, "three", 40);  // 2 was used longest ago
    CHECK(cache.find(2) == nullptr);
    CHECK(cache.find(1) != nullptr);
    CHECK(cache.find(3) != nullptr);
    CHECK(cache.size() == 2);
    CHECK(cache.bytes() == 80);
  }

  TEST_CASE("the newest stays even if it alone is too large") {
    detail::LruCache<int, int> cache(100);
    cache.insert(1, 10, 60);
    CHECK(cache.insert(2, 20, 500) == 20);
    CHECK(cache.size() == 1);
    CHECK(cache.bytes() == 500);
    cache.insert(3, 30, 60);
    CHECK(cache.find(2) == nullptr);
    CHECK(cache.bytes() == 60);
  }

  TEST_CASE("values are erased, and found by what they hold without being used") {
    detail::LruCache<int, int> cache(100);
    cache.insert(1, 10, 40);
    cache.insert(2, 20, 40);
    REQUIRE(cache.find_if([](int value) { return value == 10; }) != nullptr);
    CHECK(cache.find_if([](int value) { return value == 30; }) == nullptr);
    cache.insert(3, 30, 40);
    CHECK(cache.find(1) == nullptr);
    cache.erase(2);
    cache.erase(7);
    CHECK(cache.find(2) == nullptr);
    CHECK(cache.bytes() == 40);
  }
}
