#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "program/run_program.hpp"

// The presets of the paper and of its released program: every value of theirs, spelled out a second time.

namespace {

using namespace chainslam;
using namespace chainslam::test;

using Settings = std::map<std::string, std::string>;

/// A change to a preset that `test/presets_survivors.sh` makes, to see which test fails: "paper closures.radius=22".
/// @returns the setting for the program; empty without a change to this preset.
std::string change_to(const std::string& preset) {
  const char* change = std::getenv("CHAINSLAM_PRESET_CHANGE");
  const std::string text = change == nullptr ? "" : change;
  return text.starts_with(preset + " ") ? " --set " + text.substr(preset.size() + 1) : "";
}

/// What the program has for every key with these settings, by name, without the quotes of texts.
Settings printed(const std::string& settings) {
  const ScratchFolder scratch("presets");
  const ProgramResult result = run_program(scratch.path(), "config --print " + settings);
  CAPTURE(result.errors);
  REQUIRE(result.exit_code == 0);
  Settings values;
  std::string line, table;
  for (std::istringstream lines(result.output); std::getline(lines, line);) {
    if (line.starts_with("[")) table = line.substr(1, line.size() - 2) + ".";
    const std::size_t equals = line.find(" = ");
    if (line.starts_with("#") || line.starts_with("[") || equals == std::string::npos) continue;
    std::string value = line.substr(equals + 3);
    std::erase(value, '"');
    values[table + line.substr(0, equals)] = value;
  }
  return values;
}

/// Key and value: one for all, or paper on nclt, paper on mars, released on nclt, released on mars. An
/// angle of 11.4592 degrees stands for the default, 0.2 rad.
constexpr const char* values_of_presets = R"(
odometry.source                      fast_lio2
odometry.min_range                   4 1 4 1
odometry.max_range                   1000
odometry.every                       4
odometry.voxel_size                  0.5
odometry.map_radius                  500
odometry.max_iterations              4
odometry.clock                       lidar
imu.gyro_noise                       0.1 0.039547439866570375 0.1 0.039547439866570375
imu.accel_noise                      0.1 0.06319810123729984 0.1 0.06319810123729984
imu.gyro_random_walk                 0.01 0.00596992462263972 0.01 0.00596992462263972
imu.accel_random_walk                0.01 0.008022468448052631 0.01 0.008022468448052631
keyframes.distance                   3 10 3 10
keyframes.angle                      11.4592
keyframes.voxel_size                 0
closures.radius                      15
closures.start_distance              0
closures.min_interval                30 30 30 60
closures.min_keyframes               0
closures.max_candidates              1
closures.heading_weight              0
closures.min_travel                  16 25 0 0
closures.min_period                  0 0 3.3333333333333335 2.5
closures.max_places                  0
closures.max_alignments              0
closures.before_merge                true true false false
closures.submap_radius               20
closures.submap_length               0
closures.submap_fragment             1
closures.voxel_size                  0.4
closures.scan_voxel                  0.4
closures.method                      point_to_point
closures.max_distance                2 2 150 150
closures.max_iterations              100
closures.coarse_stride                       1
closures.min_overlap                 0
closures.degeneracy_threshold        0
closures.translation_tolerance       0.001
closures.rotation_tolerance          0.08102846845413955
closures.cost_tolerance              1e-6
closures.accept_iteration_limit        false false true true
closures.noise_from_hessian          false
closures.lambda                      1e-4
closures.min_variance              1e-12
closures.max_mean_squared_error      0.3
closures.max_misfit                  0
closures.min_inlier_ratio            0
closures.max_translation             1e9
closures.max_rotation                1e9
closures.outlier_threshold           0
closures.search_again                0
closures.at_once                     1
chain.enabled                        true true true false
chain.through_current_session        true true false false
chain.reach                          0
chain.guess_through_chain            false
chain.max_distance                   0
chain.min_separation                 0
chain.max_alignments                 0 0 200 200
chain.hysteresis                     0
chain.max_translation                0
chain.correlation                    0
merge.gnss_radius                    10
merge.gnss_with_height               false false true true
merge.gnss_max_height                1e9
merge.max_places                     0
merge.gnss_max_sigma                 1e9
merge.max_candidates                 1
merge.min_travel                     0
merge.min_period                     0 0 3.3333333333333335 2.5
merge.submap_radius                  20
merge.submap_length                  0
merge.method                         features
merge.voxel_size                     1
merge.normal_radius                  2 2 4 4
merge.normal_neighbors               30
merge.feature_radius                 5
merge.feature_neighbors              100
merge.edge_length_ratio              0.9
merge.max_distance                   1
merge.max_iterations                 10000
merge.confidence                     0.999
merge.min_consensus                  3
merge.min_fitness                    0.3 0.3 0 0
merge.min_source_fitness             0 0 0.5 0.5
merge.min_putative                   0
merge.min_translation                0 0 1 1
merge.min_rotation                   0 0 2.0258172320113044 2.0258172320113044
merge.measurement                    submaps submaps scan scan
merge.lambda                         1e-4
merge.confirmations                  1
merge.supporting_scans                      0
merge.max_fix_difference                    0
merge.misplaced                      1e9
merge.chained                        true
merge.recheck_travel                 16 25 0 0
merge.recheck_pause                  0 0 4 4
merge.recheck_chained                true true false false
graph.odometry_translation           0.01
graph.odometry_translation_per_metre 0
graph.odometry_rotation              0.05729577951308232
graph.odometry_rotation_per_metre    0
graph.odometry_rotation_per_radian   0
graph.odometry_stated_translation    0
graph.odometry_stated_rotation       0
graph.odometry_unknown_translation   0.01
graph.odometry_unknown_translation_per_metre 0
graph.odometry_unknown_rotation      0.05729577951308232
graph.odometry_unknown_rotation_per_metre 0
graph.odometry_outlier_threshold     0
graph.gnss                           false
graph.gravity                        false
graph.odometry_inflation                 false
graph.anchor                         1e-6
graph.anchor_joined_sessions         true
graph.remeasure_loaded               false false true true
)";

enum Column { paper_nclt, paper_mars, released_nclt, released_mars };

Settings expected(Column column) {
  Settings values;
  std::string line;
  for (std::istringstream lines(values_of_presets); std::getline(lines, line);) {
    std::istringstream words(line);
    std::string key, word;
    std::vector<std::string> row;
    if (!(words >> key)) continue;
    while (words >> word) row.push_back(word);
    REQUIRE((row.size() == 1 || row.size() == 4));
    values[key] = row[row.size() == 1 ? 0 : static_cast<std::size_t>(column)];
  }
  return values;
}

bool same_value(const std::string& a, const std::string& b) {
  const auto number = [](const std::string& text, double& value) {
    std::istringstream stream(text);
    return static_cast<bool>(stream >> value) && stream.peek() == std::istringstream::traits_type::eof();
  };
  double x = 0, y = 0;
  // Units, and seconds of a whole number of nanoseconds, round the last digit.
  return number(a, x) && number(b, y) ? std::abs(x - y) <= 1e-14 * std::abs(y) : a == b;
}

/// Every key that the preset sets has its value, and every other one the default.
void check_preset(Column column, const std::string& settings) {
  CAPTURE(settings);
  const std::string name = column == paper_nclt || column == paper_mars ? "paper" : "released";
  const Settings defaults = printed(""), found = printed(settings + change_to(name)), preset = expected(column);
  REQUIRE(found.size() == defaults.size());
  for (const auto& row : preset) CHECK_MESSAGE(found.contains(row.first), row.first);
  for (const auto& setting : found) {
    if (setting.first == "preset" || setting.first == "platform") continue;
    const auto row = preset.find(setting.first);
    const std::string& wanted = row == preset.end() ? defaults.at(setting.first) : row->second;
    CHECK_MESSAGE(same_value(setting.second, wanted), setting.first, " is ", setting.second, ", not ", wanted);
  }
}

/// What a run found, in the figures that tell presets apart.
struct Found {
  Index merges, merge_closures, direct, chained;
  double error, between;  ///< metres, root mean square: against the truth, and between sessions at one place
  bool rule_kept;         ///< v / f_lc > r_lc
};

/// Whether a preset is to be left alone since another one was changed.
bool spared(const std::string& preset) {
  return std::getenv("CHAINSLAM_PRESET_CHANGE") != nullptr && change_to(preset).empty();
}

/// Records three drives through the town by the front end that both presets have on this platform. Where the changes of
/// `test/presets_survivors.sh` do not concern it, it is recorded once for all of them.
std::string recorded_town(const ScratchFolder& scratch) {
  std::string change = change_to("paper") + change_to("released");
  const bool front_end = contains(change, "odometry.") || contains(change, "imu.") || contains(change, "keyframes.");
  if (contains(change, "graph.") || !front_end) change.clear();
  const char* kept = std::getenv("CHAINSLAM_PRESET_SETS");
  const fs::path folder = kept != nullptr && change.empty() ? fs::path(kept) : scratch.path();
  std::string sets;
  for (const char* session : {"1", "2", "3"}) {
    const fs::path set = folder / session;
    if (!fs::exists(set)) {
      const ProgramResult result =
          run_program(scratch.path(), "odometry simulate:town-sessions/small/" + std::string(session) +
                                          "/3 --set preset=paper" + change + " --out " + quoted(set));
      CAPTURE(result.errors);
      REQUIRE(result.exit_code == 0);
    }
    sets += quoted(set) + " ";
  }
  return sets;
}

/// Maps three drives through the town, recorded by the front end that both presets have.
Found mapped_by_preset(const ScratchFolder& scratch, const std::string& sets, const std::string& preset) {
  const fs::path out = scratch.path() / ("map_" + preset);
  const ProgramResult result = run_program(
      scratch.path(), "map " + sets + " --set preset=" + preset + change_to(preset) + " --out " + quoted(out));
  CAPTURE(result.output);
  CAPTURE(result.errors);
  REQUIRE(result.exit_code == 0);
  const nlohmann::json summary = summary_of(out);
  const nlohmann::json& closures = summary["closures"];
  const Found found{.merges = summary["merges"],
                    .merge_closures = closures["merge"],
                    .direct = closures["direct"],
                    .chained = closures["chained"],
                    .error = rmse(summary, "optimized"),
                    .between = rmse(summary, "inter_session", "rpe"),
                    .rule_kept = summary["closure_spacing"]["kept"]};
  std::printf(
      "FIGURE preset %s, three drives through the town: %d merges, closures %d merge, %d direct, %d chained; APE "
      "%.3f m, odometry alone %.3f m, between sessions %.3f m; rule v / f_lc > r_lc %s\n",
      preset.c_str(), found.merges, found.merge_closures, found.direct, found.chained, found.error,
      rmse(summary, "odometry"), found.between, summary["closure_spacing"].dump().c_str());
  return found;
}

}  // namespace

TEST_SUITE("program/presets") {
  TEST_CASE("the presets paper and released have the values of the paper and of its code, all of them and no others") {
    check_preset(paper_nclt, "--set preset=paper");
    check_preset(paper_mars, "--set platform=mars --set preset=paper");
    check_preset(released_nclt, "--set preset=released --set platform=nclt");
    check_preset(released_mars, "--set preset=released --set platform=mars");
  }

  TEST_CASE("paper and released map three drives through the town" * doctest::skip(quick())) {
    const ScratchFolder scratch("presets");
    const std::string sets = recorded_town(scratch);
    if (!spared("paper")) {
      // Exact for one recording. What the released code merges is not verified: with seed 1, it is wrong by 47 m if
      // odometry's sums are rounded otherwise.
      const Found paper = mapped_by_preset(scratch, sets, "paper");
      CHECK(paper.merges == 2);
      CHECK(paper.merge_closures == 2);
      CHECK(paper.direct == 49);
      CHECK(paper.chained == 3);
      CHECK(std::abs(paper.error - 0.257) < 0.005);  // odometry alone 0.275 m
      CHECK(std::abs(paper.between - 0.066) < 0.005);
      CHECK(paper.rule_kept);
    }
    if (!spared("released")) {
      const Found released = mapped_by_preset(scratch, sets, "released");
      CHECK(released.merges == 2);
      CHECK(released.merge_closures == 2);
      CHECK(released.direct == 34);
      CHECK(released.chained == 0);  // j itself seldom knows another session: `best` asks its neighbours, too
      CHECK(std::abs(released.error - 0.262) < 0.005);
      CHECK(std::abs(released.between - 0.073) < 0.005);
      CHECK(released.rule_kept);
    }
    if (spared("best")) return;
    // Best seeks closures each 4 m and more, 15 m around: the report says that the rule does not hold.
    const fs::path out = scratch.path() / "best";
    const std::string first = sets.substr(0, sets.find(' '));
    REQUIRE(run_program(scratch.path(), "map " + first + " --out " + quoted(out)).exit_code == 0);
    const nlohmann::json spacing = summary_of(out)["closure_spacing"];
    CHECK(spacing["kept"] == false);
    CHECK(spacing["mean_m"] > 4);
    CHECK(spacing["mean_m"] < 8);
    CHECK(contains(read_text(out / "report.html"), "not kept: "));
  }

  TEST_CASE("best is the default, whose keyframes, closures and clock go with the platform") {
    Settings defaults = printed("");
    CHECK(defaults.at("preset") == "best");
    CHECK(printed("--set preset=paper --set preset=best") == defaults);
    CHECK(printed("--set preset=best --set platform=nclt") == defaults);
    defaults["platform"] = "mars";
    defaults["keyframes.distance"] = "10";
    defaults["closures.min_interval"] = "60";
    defaults["closures.min_travel"] = "15";
    defaults["odometry.clock"] = "imu";
    const Settings mars = printed("--set platform=mars");
    REQUIRE(mars.size() == defaults.size());
    for (const auto& setting : mars)
      CHECK_MESSAGE(same_value(setting.second, defaults.at(setting.first)), setting.first);
  }

  TEST_CASE("single settings change a preset, wherever they stand, and a front end brings its own numbers") {
    const Settings changed = printed("--set closures.radius=7 --set odometry.source=lidar --set preset=paper");
    CHECK(changed.at("closures.radius") == "7.0");
    CHECK(changed.at("odometry.source") == "lidar");
    CHECK(changed.at("odometry.map_radius") == "150.0");
    CHECK(changed.at("odometry.every") == "4");
    const Settings published = printed("--set odometry.source=fast_lio2");
    CHECK(published.at("odometry.map_radius") == "500.0");
    CHECK(published.at("odometry.voxel_size") == "0.5");
    CHECK(published.at("odometry.max_iterations") == "5");
    CHECK(published.at("odometry.every") == "1");
    const Settings cut = printed("--set odometry.map_radius=90 --set odometry.source=fast_lio2");
    CHECK(cut.at("odometry.map_radius") == "90.0");
  }
}
