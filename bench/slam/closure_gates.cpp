// How well what the loop closer looks at tells right alignments from wrong ones, over real and simulated scans of
// several sensors, as Markdown and CSV: see bench/results.md.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "slam/closure_gates/closure_figures.hpp"
#include "slam/closure_gates/closure_pairs.hpp"
#include "slam/closure_gates/gate_roc.hpp"
#include "slam/closure_gates/places.hpp"
#include "table_file.hpp"

namespace chainslam::bench {
namespace {

struct Options {
  std::filesystem::path out, roc, pairs;
  std::uint64_t seed = 1;
  std::vector<std::string> presets{"mars-hard"};  ///< of the simulator; none: real scans alone
  std::string sensor;                             ///< only those whose name contains this
  bool real = true;
  std::size_t count = 300;     ///< revisits of each sensor
  std::size_t full_every = 4;  ///< of the pairs that have one, one of so many with the scan as it was recorded as well
};

/// Simulated spinning sensors: lines and firings a revolution, as many as packets allow.
constexpr std::tuple<const char*, Index> simulated_sensors[] = {
    {"VLP-16", 480}, {"HDL-32E", 480}, {"OS1-64", 480}, {"VLS-128", 480}};

bool chosen(const Options& options, const std::string& sensor) {
  return sensor.find(options.sensor) != std::string::npos;
}

std::vector<Meeting> meetings_of(const Options& options) {
  std::vector<Meeting> meetings;
  if (options.real) meetings = real_meetings({});
  for (const std::string& preset : options.presets)
    for (const auto& [lidar, firings] : simulated_sensors) {
      if (!chosen(options, lidar)) continue;
      for (Meeting& meeting : simulated_meetings(preset, lidar, firings, options.seed, {}))
        meetings.push_back(std::move(meeting));
    }
  for (const Meeting& meeting : meetings)
    std::fprintf(stderr, "%s: %zu keyframes in %s: %zu\n", meeting.query.name.c_str(), meeting.query.keyframes.size(),
                 meeting.map.name.c_str(), meeting.map.keyframes.size());
  return meetings;
}

/// Meetings of one sensor.
using SensorMeetings = std::vector<const Meeting*>;

/// Pairs of one sensor: as many revisits as stated, as many that are shifted, and three times as many elsewhere, half
/// of these in other real places, if the sensor is real.
void add_pairs(const Options& options, const SensorMeetings& own, const SensorMeetings& others, PairMaker& maker,
               std::vector<ClosurePair>& pairs) {
  const auto add = [&](std::size_t count, const auto& make) {
    std::size_t made = 0;
    for (std::size_t attempt = 0; made < count && attempt < 100 * count; ++attempt)
      if (const std::optional<ClosurePair> pair = make(attempt)) {
        pairs.push_back(*pair);
        ++made;
      }
  };
  const auto turn = [](const SensorMeetings& meetings, std::size_t i) { return meetings[i % meetings.size()]; };
  for (const PairKind kind : {PairKind::revisit, PairKind::shifted})
    add(options.count, [&](std::size_t i) {
      const Meeting* meeting = turn(own, i);
      return maker.same_place(meeting->map, meeting->query, kind);
    });
  add(3 * options.count, [&](std::size_t i) {
    const Meeting* query = turn(own, i / 2);
    const Meeting* map = i % 2 == 0 || others.empty() ? query : turn(others, i / 2 / own.size());
    return maker.elsewhere(map->map, query->query);
  });
}

/// All pairs, in the order of their submaps.
std::vector<ClosurePair> pairs_of(const Options& options, const std::vector<Meeting>& meetings) {
  std::vector<ClosurePair> pairs;
  std::vector<std::pair<std::string, bool>> sensors;  // each once, and whether it is real
  for (const Meeting& meeting : meetings) {
    const std::pair sensor(meeting.query.sensor, meeting.query.real);
    if (chosen(options, sensor.first) && std::ranges::find(sensors, sensor) == sensors.end()) sensors.push_back(sensor);
  }
  for (std::size_t k = 0; k < sensors.size(); ++k) {
    SensorMeetings own, others;
    for (const Meeting& meeting : meetings) {
      if (std::pair(meeting.query.sensor, meeting.query.real) == sensors[k]) own.push_back(&meeting);
      if (meeting.query.real && sensors[k].second) others.push_back(&meeting);
    }
    PairMaker maker(PairOptions{}, options.seed + 1000 * k);
    add_pairs(options, own, others, maker, pairs);
  }
  std::ranges::stable_sort(pairs, {}, [](const ClosurePair& pair) { return std::tuple(pair.map, pair.from); });
  return pairs;
}

std::vector<MeasuredPair> measure(const Options& options, const std::vector<ClosurePair>& pairs) {
  ClosureMeasurer measurer;
  std::vector<MeasuredPair> measured;
  std::size_t with_full = 0;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    measured.push_back({&pairs[i], false, measurer(pairs[i], false)});
    if (options.full_every > 0 && pairs[i].query->full[pairs[i].to] && with_full++ % options.full_every == 0)
      measured.push_back({&pairs[i], true, measurer(pairs[i], true)});
    if (i % 200 == 0) std::fprintf(stderr, "%zu of %zu pairs\n", i, pairs.size());
  }
  return measured;
}

/// By sensor and by whether scans are downsampled, in the order in which they come up.
std::vector<PairGroup> groups_of(const std::vector<MeasuredPair>& measured, bool real) {
  std::vector<PairGroup> groups;
  for (const bool full : {false, true})
    for (const MeasuredPair& pair : measured) {
      if (pair.full != full || pair.pair->query->real != real) continue;
      const std::string name =
          std::string(real ? "real " : "simulated ") + pair.pair->query->sensor + (full ? ", full" : "");
      auto group = std::ranges::find(groups, name, &PairGroup::name);
      if (group == groups.end()) group = groups.insert(groups.end(), {name, {}});
      group->pairs.push_back(&pair);
    }
  return groups;
}

std::string tables(const Options& options) {
  const std::vector<Meeting> meetings = meetings_of(options);
  const std::vector<ClosurePair> pairs = pairs_of(options, meetings);
  const std::vector<MeasuredPair> measured = measure(options, pairs);
  const std::vector<PairGroup> real = groups_of(measured, true), simulated = groups_of(measured, false);
  std::vector<PairGroup> all = real;
  all.insert(all.end(), simulated.begin(), simulated.end());
  if (!options.roc.empty() && write_table("bench_closure_gates", options.roc, [&] { return roc_csv(all); }) != 0)
    throw std::runtime_error("the ROC table was not written");
  if (!options.pairs.empty() &&
      write_table("bench_closure_gates", options.pairs, [&] { return pairs_csv(measured); }) != 0)
    throw std::runtime_error("the table of pairs was not written");
  return "Seed " + std::to_string(options.seed) +
         ". For each measure the share of right alignments kept by the threshold that lets by no more than 0.1 % of\n"
         "the wrong ones, and that threshold; then, at the threshold in use, right kept (Wilson's 95 % bounds) and\n"
         "wrong accepted (with 95 % fewer than).\n\n" +
         (real.empty() ? "" : tables_of(real)) + "\n" + (simulated.empty() ? "" : tables_of(simulated));
}

}  // namespace
}  // namespace chainslam::bench

int main(int count, char** words) {
  using namespace chainslam;
  bench::Options options;
  CLI::App app("ROC of the measures by which loop closures are accepted, as Markdown");
  app.add_option("--out", options.out, "where the tables go")->required();
  app.add_option("--roc", options.roc, "CSV: right kept and wrong accepted over thresholds");
  app.add_option("--pairs", options.pairs, "CSV: a line for each pair");
  app.add_option("--seed", options.seed, "of the pairs and of the simulated worlds (default 1)");
  app.add_option("--presets", options.presets, "of the simulator, separated by commas (default mars-hard)")
      ->delimiter(',');
  app.add_option("--sensor", options.sensor, "only those whose name contains this");
  app.add_flag("!--no-real", options.real, "simulated scans alone");
  app.add_flag_callback(
      "--no-simulated", [&] { options.presets.clear(); }, "real scans alone");
  app.add_option("--count", options.count, "revisits of each sensor (default 300)")->check(CLI::PositiveNumber);
  app.add_option("--full-every", options.full_every, "scans as recorded for one pair of so many (default 4); 0: none");
  CLI11_PARSE(app, count, words);
  return bench::write_table("bench_closure_gates", options.out, [&] { return bench::tables(options); });
}
