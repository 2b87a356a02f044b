#include "chainslam/slam/frame_records.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <ranges>
#include <span>
#include <thread>
#include <vector>

#include "chainslam/core/random.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

static_assert(std::ranges::input_range<const FrameRecords>);

constexpr std::size_t block = FrameRecords::block_records;

/// Sessions one after the other, times increasing in each; `points` numbers the records.
std::vector<FrameRecord> random_frames(Rng& rng, std::size_t count) {
  std::vector<FrameRecord> frames;
  FrameRecord frame;
  frame.session = SessionId{rng.uniform_index(3)};
  for (std::size_t i = 0; i < count; ++i) {
    if (rng.uniform_index(700) == 0) {
      frame.session.value += 1 + rng.uniform_index(2);
      frame.time = Timestamp();
    }
    frame.time = frame.time + Duration(1 + rng.uniform_index(3));
    frame.health.points = static_cast<Index>(i);
    frame.health.residual_rms = static_cast<double>(static_cast<float>(rng.uniform(0.0, 1.0)));
    frames.push_back(frame);
  }
  return frames;
}

bool same(const FrameRecord& a, const FrameRecord& b) {
  return a.session == b.session && a.time == b.time && a.health.points == b.health.points &&
         a.health.residual_rms == b.health.residual_rms;
}
bool same(const auto& a, const auto& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const auto& x, const auto& y) { return same(x, y); });
}

FrameRecords records_of(std::span<const FrameRecord> frames) {
  FrameRecords records;
  for (const FrameRecord& frame : frames) records.push_back(frame);
  return records;
}

/// Has records in memory, and counts how many were asked for.
struct CountingSource final : FrameSource {
  explicit CountingSource(std::vector<FrameRecord> all) : frames(std::move(all)) {}
  [[nodiscard]] Records load(std::size_t first, std::size_t count) const override {
    loaded += count;
    const auto begin = frames.begin() + static_cast<std::ptrdiff_t>(first);
    return std::make_shared<const std::vector<FrameRecord>>(begin, begin + static_cast<std::ptrdiff_t>(count));
  }
  std::vector<FrameRecord> frames;
  mutable std::atomic<std::size_t> loaded = 0;
};

}  // namespace

TEST_SUITE("slam/frame_records") {
  TEST_CASE("records are those of a vector, wherever they are kept") {
    for_all(60, [](Rng& rng, int size) {
      const auto count = static_cast<std::size_t>(rng.uniform_index(100 * size + 1));
      const std::vector<FrameRecord> frames = random_frames(rng, count);
      const FrameRecords records = records_of(frames);
      if (rng.uniform_index(2) == 0) records.keep_in(std::make_shared<CountingSource>(frames), 0, count);
      REQUIRE(records.size() == count);
      CHECK(records.empty() == frames.empty());
      CHECK(same(records, frames));
      if (count == 0) return;
      CHECK(same(records.back(), frames.back()));
      for (int k = 0; k < 20; ++k) {
        const auto draw = [&](std::size_t end) { return static_cast<std::size_t>(rng.uniform_index(to_index(end))); };
        const std::size_t i = draw(count), first = draw(i + 1);
        CHECK(same(records[i], frames[i]));
        CHECK(same(records.copy(first, i), std::span(frames).subspan(first, i - first)));
        SessionId session = frames[i].session;
        if (k % 5 == 0) ++session.value;  // maybe none
        const auto is_in = [&](const FrameRecord& one) { return one.session == session; };
        std::vector<FrameRecord> expected;
        std::ranges::copy_if(frames, std::back_inserter(expected), is_in);
        CHECK(same(records.of(session), expected));
        const Timestamp from = frames[i].time + Duration(rng.uniform_index(9) - 4),
                        to = from + Duration(draw(3 * block));
        std::erase_if(expected, [&](const FrameRecord& one) { return one.time < from || one.time > to; });
        CHECK(same(records.between(session, from, to), expected));
      }
    });
  }

  TEST_CASE("whole blocks leave memory, of all copies, and the newest stay") {
    Rng rng(1);
    const std::vector<FrameRecord> frames = random_frames(rng, 5 * block + 100);
    FrameRecords records = records_of(std::span(frames).first(3 * block + 10));
    const FrameRecords copy = records;
    const auto source = std::make_shared<CountingSource>(frames);
    CHECK(records.keep_in(source, 0, 2 * block - 1) == block);
    for (std::size_t i = 3 * block + 10; i < frames.size(); ++i) records.push_back(frames[i]);
    CHECK(same(copy, std::span(frames).first(3 * block + 10)));
    CHECK(source->loaded == block);
    CHECK(records.keep_in(source, block, frames.size()) == 4 * block);  // behind them are the newest
    CHECK(same(records, frames));
    CHECK(source->loaded == 5 * block);
    CHECK(same(copy, std::span(frames).first(3 * block + 10)));
    CHECK(source->loaded == 7 * block);  // the copy's two blocks
    for (std::size_t i = 4 * block; i < frames.size(); ++i) CHECK(same(records[i], frames[i]));
    CHECK(same(records.between(frames.back().session, frames[frames.size() - 50].time, frames.back().time),
               std::span(frames).last(50)));
    CHECK(source->loaded == 7 * block);
  }

  TEST_CASE("another source takes the place of the one before") {
    Rng rng(2);
    const std::vector<FrameRecord> frames = random_frames(rng, 4 * block);
    const FrameRecords records = records_of(frames);
    const auto first = std::make_shared<CountingSource>(frames), second = std::make_shared<CountingSource>(frames);
    records.keep_in(first, 0, frames.size());
    records.keep_in(second, 0, frames.size());
    CHECK(same(records, frames));
    CHECK(first->loaded == 0);
    CHECK(first.use_count() == 1);
    CHECK(second->loaded == 3 * block);
  }

  TEST_CASE("residuals are rounded to float, as files keep them") {
    FrameRecords records;
    FrameRecord frame;
    frame.health.residual_rms = 0.1;
    records.push_back(frame);
    CHECK(records[0].health.residual_rms == static_cast<double>(0.1F));
  }

  THREADS_TEST_CASE("slam/frame_records", "threads read copies while blocks leave memory") {
    Rng rng(3);
    const std::vector<FrameRecord> frames = random_frames(rng, 20 * block);
    const FrameRecords records = records_of(frames);
    const auto source = std::make_shared<CountingSource>(frames);
    std::atomic<int> wrong = 0;
    {
      std::vector<std::jthread> readers;
      for (int k = 0; k < 3; ++k)
        readers.emplace_back([&, copy = records] {
          for (int pass = 0; pass < 5; ++pass) wrong += same(copy, frames) ? 0 : 1;
        });
      for (std::size_t kept = 0; kept < 19 * block; kept += block) records.keep_in(source, kept, kept + block);
    }
    CHECK(wrong == 0);
  }
}

}  // namespace chainslam::test
