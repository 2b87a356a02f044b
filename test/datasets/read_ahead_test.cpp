#include <atomic>
#include <chrono>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "datasets/read_ahead.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::datasets;
using namespace chainslam::test;

/// Scans and IMU samples at random, each with its number as its time.
std::vector<Packet> numbered_packets(Rng& rng, Index count) {
  std::vector<Packet> packets;
  for (Index k = 0; k < count; ++k) {
    const auto time = Timestamp::from_nanoseconds(k);
    if (rng.uniform() < 0.2)
      packets.emplace_back(LidarScan{.time = time, .end = time});
    else
      packets.emplace_back(ImuSample{.time = time});
  }
  return packets;
}

/// Gives these packets, then nothing, or throws instead; counts the scans that were read.
struct Source {
  const std::vector<Packet>& packets;
  std::optional<std::string> failure{};
  std::size_t next = 0;
  std::atomic<int> scans = 0;

  std::optional<Packet> read() {
    if (next == packets.size() && failure) throw std::runtime_error(*failure);
    if (next == packets.size()) return std::nullopt;
    scans += std::holds_alternative<LidarScan>(packets[next]) ? 1 : 0;
    return packets[next++];
  }
};

}  // namespace

THREADS_TEST_CASE("datasets/read_ahead", "packets that are read ahead come in their order, each once") {
  for_all(40, [](Rng& rng, int size) {
    const std::vector<Packet> packets = numbered_packets(rng, 8 * size);
    Source source{packets};
    ReadAhead ahead([&] { return source.read(); });
    std::size_t k = 0;
    while (const std::optional<Packet> packet = ahead.next()) {
      REQUIRE(k < packets.size());
      CHECK(sensor_kind(*packet) == sensor_kind(packets[k]));
      CHECK(available_at(*packet) == available_at(packets[k]));
      ++k;
    }
    CHECK(k == packets.size());
    CHECK_FALSE(ahead.next());  // nor later
  });
}

THREADS_TEST_CASE("datasets/read_ahead", "many packets without a scan between them are read ahead as well") {
  const std::vector<Packet> packets(5000, ImuSample{});
  Source source{packets};
  ReadAhead ahead([&] { return source.read(); });
  std::size_t count = 0;
  while (ahead.next()) ++count;
  CHECK(count == packets.size());
}

THREADS_TEST_CASE("datasets/read_ahead", "what reading throws comes after all packets before it") {
  Rng rng(1);
  const std::vector<Packet> packets = numbered_packets(rng, 57);
  Source source{packets, "no more"};
  ReadAhead ahead([&] { return source.read(); });
  for (std::size_t k = 0; k < packets.size(); ++k) REQUIRE(ahead.next());
  CHECK_THROWS_WITH_AS(static_cast<void>(ahead.next()), "no more", std::runtime_error);
}

THREADS_TEST_CASE("datasets/read_ahead",
                  "no more scans are read than were asked for, and few ahead of who takes them") {
  const std::vector<Packet> packets(100, LidarScan{});
  Source all{packets};
  {
    ReadAhead ahead([&] { return all.read(); });
    REQUIRE(ahead.next());
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    CHECK(all.scans <= 5);
  }  // while the reading thread waits
  CHECK(all.scans <= 5);

  Source some{packets};
  ReadAhead ahead([&] { return some.read(); }, 7);
  int scans = 0;
  while (ahead.next()) ++scans;
  CHECK(scans == 7);
  CHECK(some.scans == 7);
}
