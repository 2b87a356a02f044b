#include "support/summary.hpp"

#include <doctest/doctest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include "chainslam/core/error.hpp"
#include "support/statistics.hpp"

namespace chainslam::support {
namespace {

bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

TEST_SUITE("support/statistics") {
  TEST_CASE("percentiles are nearest ranks") {
    const std::vector<double> samples{5, 1, 4, 2, 3};
    CHECK(percentile(samples, 0.2) == 1);
    CHECK(percentile(samples, 0.5) == 3);
    CHECK(percentile(samples, 0.99) == 5);
    CHECK(percentile(samples, 1.0) == 5);
    CHECK(percentile({7}, 0.01) == 7);
    CHECK(percentile({}, 0.5) == 0);
  }

  TEST_CASE("a spread is the middle and the end, and zero of nothing") {
    const Spread spread = spread_of({5, 1, 4, 2, 3});
    CHECK(spread.p50 == 3);
    CHECK(spread.p99 == 5);
    CHECK(spread.max == 5);
    CHECK(spread_of({}).max == 0);
  }

  TEST_CASE("each stage has a row, in the order of its first step") {
    StageTimes times;
    for (int i = 100; i >= 1; --i) times.add("odometry", i);
    times.add("closures", 2.5);
    const auto rows = times.rows();
    REQUIRE(rows.size() == 2);
    CHECK(rows[0].stage == "odometry");
    CHECK(rows[0].count == 100);
    CHECK(rows[0].total == 5050);
    CHECK(rows[0].p50 == 50);
    CHECK(rows[0].p99 == 99);
    CHECK(rows[0].max == 100);
    CHECK(rows[1].stage == "closures");
    CHECK(rows[1].p99 == 2.5);
  }

  TEST_CASE("a measurement takes as long as its scope, and threads may measure at the same time") {
    StageTimes times;
    {
      std::vector<std::jthread> threads;
      for (int i = 0; i < 4; ++i)
        threads.emplace_back([&] {
          const auto measurement = times.measure("sleep");
          std::this_thread::sleep_for(std::chrono::milliseconds(5));
        });
    }
    REQUIRE(times.rows().size() == 1);
    CHECK(times.rows()[0].count == 4);
    CHECK(times.rows()[0].p50 >= 0.005);
  }
}

TEST_SUITE("support/summary") {
  TEST_CASE("figures stand under their names") {
    RunSummary summary{.dataset = "town",
                       .scans = 100,
                       .keyframes = 20,
                       .merges = 1,
                       .direct_closures = 3,
                       .chained_closures = 9,
                       .merge_closures = 2,
                       .peak_memory = 1 << 20};
    summary.refusals["high_residual"] = 4;
    summary.stages.push_back({.stage = "odometry", .count = 100, .total = 2, .p50 = 0.25, .p99 = 0.5, .max = 1});
    summary.errors = {{"ape.translation.rmse", 0.5}, {"ape.translation.max", 1.5}, {"rpe.translation.rmse", 0.125}};
    const std::string text = summary_json(summary);
    CHECK(has(text, "\"scans\": 100"));
    CHECK(has(text, "\"closures\": {\n    \"direct\": 3,\n    \"chained\": 9,\n    \"merge\": 2\n  }"));
    CHECK(has(text, "\"refusals\": {\n    \"high_residual\": 4\n  }"));
    CHECK(has(text, "\"odometry\": {\n      \"count\": 100,\n      \"total_s\": 2.0,\n      \"p50_ms\": 250.0"));
    CHECK(has(text, "\"ape\": {\n      \"translation\": {\n        \"max\": 1.5,\n        \"rmse\": 0.5"));
    CHECK(has(text, "\"peak_memory_bytes\": 1048576"));
  }

  TEST_CASE("each session has its own figures, and one that was loaded has no scans") {
    RunSummary summary;
    summary.sessions = {{.name = "old", .loaded = true, .keyframes = 7},
                        {.name = "new", .frame = 1, .scans = 12, .keyframes = 4, .errors = {{"odometry.ape", 0.5}}}};
    const std::string text = summary_json(summary);
    CHECK(has(text, "\"name\": \"old\",\n      \"loaded\": true,\n      \"frame\": 0,\n      \"keyframes\": 7"));
    CHECK(has(text, "\"scans\": 12,"));
    CHECK(has(text, "\"errors\": {\n        \"odometry\": {\n          \"ape\": 0.5"));
    CHECK(text.find("\"scans\"", text.find("\"old\"")) > text.find("\"new\""));
  }

  TEST_CASE("refusals stand by kind and reason, components by size, the back end in milliseconds") {
    RunSummary summary;
    summary.refusals_by_kind["chained"]["high residual"] = 3;
    summary.components = {.count = 3, .keyframes = 9, .largest = 5, .histogram = {{2, 2}, {5, 1}}};
    summary.back_end = {.alignments = 40, .keyframes = 10, .seconds = {.p50 = 0.25, .p99 = 0.5, .max = 2}};
    summary.back_end.closure_alignments = {.p50 = 4, .p99 = 9, .max = 11};
    const std::string text = summary_json(summary);
    CHECK(has(text, "\"refusals_by_kind\": {\n    \"chained\": {\n      \"high residual\": 3\n    }\n  }"));
    CHECK(has(text, "\"count\": 3,\n    \"keyframes\": 9,\n    \"largest\": 5,"));
    CHECK(has(text, "\"keyframes\": 2,\n        \"components\": 2"));
    CHECK(has(text, "\"p50_ms\": 250.0,\n      \"p99_ms\": 500.0,\n      \"max_ms\": 2000.0"));
    CHECK(has(text, "\"alignments_per_direct_closure\": {\n      \"p50\": 4.0"));
  }

  TEST_CASE("the paper's rule for closures is judged by the mean way between searches, and told with the components") {
    RunSummary summary;
    CHECK(spacing_sentence(summary).empty());
    CHECK(has(summary_json(summary), "\"intervals\": 0"));
    CHECK_FALSE(has(summary_json(summary), "\"kept\""));
    summary.components = {.count = 1, .keyframes = 9, .largest = 9, .widest = 12.34, .histogram = {{9, 1}}};
    summary.spacing = search_spacing({15, 20.5, 11}, 15);
    CHECK(spacing_sentence(summary) ==
          "kept: 15.5 m between two searches on average (11.0 m at least), radius 15 m; 1 component of the adjacency "
          "graph, of 9 keyframes and 12.3 m from the middle at most");
    CHECK(has(summary_json(summary), "\"widest_m\": 12.34"));
    CHECK(has(summary_json(summary), "\"within_radius\": 2"));
    CHECK(has(summary_json(summary), "\"kept\": true"));
    summary.spacing = search_spacing({15, 15}, 15);  // beyond the radius, not at it
    summary.components.count = 3;
    CHECK(spacing_sentence(summary).starts_with("not kept: 15.0 m between two searches on average (15.0 m at least)"));
    CHECK(has(spacing_sentence(summary), "; 3 components of"));
    CHECK(has(summary_json(summary), "\"kept\": false"));
  }

  TEST_CASE("nothing found is an empty object, a figure that is none is null, and a bad name does not throw") {
    RunSummary summary{.dataset = "bad \xff name"};
    CHECK(has(summary_json(summary), "\"refusals\": {},"));
    summary.dataset = "\x1b[2J\x7f\xc2\x9b\xe2\x80\xae";  // what a terminal obeys that shows the file
    for (const char c : summary_json(summary)) CHECK((c == '\n' || (c >= ' ' && c <= '~')));
    summary.errors["ape"] = std::numeric_limits<double>::quiet_NaN();
    CHECK(has(summary_json(summary), "\"ape\": null"));
  }

  TEST_CASE("the file is whole or not there") {
    const auto folder = std::filesystem::temp_directory_path() / "chainslam_summary_test";
    std::filesystem::create_directories(folder);
    const auto path = folder / "summary.json";
    const RunSummary summary{.scans = 5};
    write_summary(path, summary);
    write_summary(path, summary);
    std::ifstream stream(path);
    CHECK(std::string{std::istreambuf_iterator<char>(stream), {}} == summary_json(summary));
    CHECK(std::distance(std::filesystem::directory_iterator(folder), {}) == 1);
    CHECK_THROWS_AS(write_summary(folder / "missing" / "summary.json", summary), IoError);
    std::filesystem::remove_all(folder);
  }
}

}  // namespace
}  // namespace chainslam::support
