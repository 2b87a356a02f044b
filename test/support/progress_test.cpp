#include "support/progress.hpp"

#include <doctest/doctest.h>

#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include "support/count_text.hpp"

namespace chainslam::support {
namespace {

using test::count;
using namespace std::chrono_literals;

/// A stream to a temporary file, and what was written to it.
class Capture {
 public:
  Capture() : file_(std::tmpfile()) { REQUIRE(file_ != nullptr); }
  ~Capture() { std::fclose(file_); }
  Capture(const Capture&) = delete;
  Capture& operator=(const Capture&) = delete;

  [[nodiscard]] std::FILE* stream() const { return file_; }
  [[nodiscard]] std::string text() const {
    std::string result;
    std::rewind(file_);
    for (int c = std::fgetc(file_); c != EOF; c = std::fgetc(file_)) result += static_cast<char>(c);
    return result;
  }

 private:
  std::FILE* file_;
};

const Progress::Clock::time_point start{1h};

TEST_SUITE("support/progress") {
  TEST_CASE("the line tells stage, speed, time left, keyframes, closures and memory") {
    const ProgressState state{.stage = "mapping",
                              .done = 250,
                              .total = 1000,
                              .data_seconds = 25.0,
                              .keyframes = 40,
                              .direct_closures = 3,
                              .chained_closures = 17};
    CHECK(progress_line(state, 10.0, 300 << 20) ==
          "mapping 250/1000 | 2.5x real time | 30 s left | 40 keyframes | closures 3 direct + 17 chained | 300 MiB");
    CHECK(
        progress_line(state, 1250.0, 3ULL << 30) ==
        "mapping 250/1000 | 0.0x real time | 1 h 2 min left | 40 keyframes | closures 3 direct + 17 chained | 3.0 GiB");
    CHECK(progress_line(state, 40.0, 0).find("| 2 min 0 s left |") != std::string::npos);
  }

  TEST_CASE("the line leaves out what is not known") {
    CHECK(progress_line({.stage = "reading", .done = 7}, 3.0, 0) == "reading 7");
    CHECK(progress_line({.stage = "saving", .done = 4, .total = 4}, 3.0, 0) == "saving 4/4");
    CHECK(progress_line({.stage = "writing"}, 3.0, 0) == "writing");
    CHECK(progress_line({.stage = "mapping", .total = 4}, 0.0, 0) == "mapping 0/4");
  }

  TEST_CASE("without a terminal there is a line for every tenth, and one for the end") {
    const Capture capture;
    {
      Progress progress(capture.stream(), false);
      for (Index i = 0; i <= 995; ++i) progress.update({.stage = "mapping", .done = i, .total = 1000}, start + i * 1ms);
    }
    const std::string text = capture.text();
    CHECK(count(text, "\n") == 11);
    for (const std::string line : {"mapping 0/1000", "mapping 100/1000", "mapping 900/1000", "mapping 995/1000"}) {
      CAPTURE(line);
      CHECK(count(text, line) == 1);
    }
    CHECK(text.find('\r') == std::string::npos);
  }

  TEST_CASE("on a terminal one line renews itself ten times a second, and each stage leaves its last") {
    const Capture capture;
    {
      Progress progress(capture.stream(), true);
      for (Index i = 1; i <= 1000; ++i)
        progress.update({.stage = "mapping", .done = i, .total = 1000}, start + i * 1ms);
      progress.update({.stage = "saving", .done = 1, .total = 1}, start + 2s);
    }
    const std::string text = capture.text();
    CHECK(count(text, "\n") == 2);
    CHECK(count(text, "mapping ") == 11);
    CHECK(text.find("mapping 1000/1000") != std::string::npos);
    CHECK(text.rfind("\nsaving 1/1") != std::string::npos);
  }

  TEST_CASE("a warning stands on a line of its own") {
    const Capture capture;
    Progress progress(capture.stream(), true);
    progress.update({.stage = "mapping", .done = 1, .total = 10}, start);
    progress.warning("gap of 2 s in the scans");
    CHECK(capture.text().find("\r\x1b[Kwarning: gap of 2 s in the scans\n") != std::string::npos);
  }

  TEST_CASE("names that hold control characters do not reach the terminal as they are") {
    const Capture capture;
    Progress progress(capture.stream(), false);
    progress.update({.stage = "mapping \x1b]0;title\x07", .done = 1, .total = 1}, start);
    progress.warning("topic /\x1b[2J\xc2\x9b is late\nverdict      good");
    progress.finish(start + 1s);
    const std::string text = capture.text();
    CHECK(text.find('\x1b') == std::string::npos);
    CHECK(text.find("\xc2\x9b") == std::string::npos);
    CHECK(text.find("warning: topic /\\x1B[2J\\xC2\\x9B is late\\x0Averdict      good\n") != std::string::npos);
  }

  TEST_CASE("nothing to tell prints nothing") {
    const Capture capture;
    { Progress progress(capture.stream(), true); }
    CHECK(capture.text().empty());
  }

  TEST_CASE("memory grows with what is used, and its peak stays") {
    constexpr std::size_t size = std::size_t{64} << 20;
    const std::uint64_t before = current_memory();
    REQUIRE(before > 0);
    {
      const std::vector<char> block(size, 'x');
      CHECK(current_memory() > before + size / 2);
    }
    CHECK(peak_memory() > before + size / 2);
  }
}

}  // namespace
}  // namespace chainslam::support
