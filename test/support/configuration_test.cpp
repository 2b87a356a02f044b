#include "support/configuration.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <vector>

#include "support/property.hpp"

namespace chainslam::support {
namespace {

enum class Preset { best, paper };

struct Options {
  Preset preset = Preset::best;
  double voxel_size = 0.5;
  float blind_radius = 0.3F;
  double keyframe_angle = 10.0 * std::numbers::pi / 180.0;
  Index max_iterations = 20;
  std::uint64_t seed = 1;
  bool deskew = true;
  Duration window = seconds(0.25);
  double min_range = 1.0;
  double max_range = 100.0;
  std::string name = "town";
  std::filesystem::path dataset = "data set";
  std::array<double, 3> lever_arm{0.1, 0.0, -0.2};
  std::vector<double> pair{};
};

Configuration bound_to(Options& options) {
  Configuration configuration;
  configuration.add("odometry.voxel_size", options.voxel_size,
                    {.unit = "m", .min = 0.05, .max = 5, .help = "Edge of the voxels that a scan is reduced to."});
  configuration.add("odometry.blind_radius", options.blind_radius, {.unit = "m", .min = 0});
  configuration.add("odometry.deskew", options.deskew, {.help = "Undo the motion during a scan."});
  configuration.add("odometry.min_range", options.min_range, {.unit = "m", .min = 0});
  configuration.add("odometry.max_range", options.max_range, {.unit = "m", .min = 0});
  configuration.add("keyframes.angle_deg", options.keyframe_angle,
                    {.unit = "deg", .min = 0, .max = 180, .factor = std::numbers::pi / 180.0});
  configuration.add("keyframes.window", options.window, {.unit = "s", .min = 0});
  configuration.add("icp.max_iterations", options.max_iterations, {.min = 1, .max = 1000});
  configuration.add("random.seed", options.seed, {});
  configuration.add("sensor.lever_arm", std::span<double>(options.lever_arm), {.unit = "m", .min = -10, .max = 10});
  configuration.add("sensor.pair",
                    Configuration::Target(Configuration::Numbers{
                        .form = "two numbers in brackets, or []",
                        .get = [&options] { return options.pair; },
                        .problem = [](const std::vector<double>& v) { return v.size() % 2 == 0 ? "" : "no pair"; },
                        .set = [&options](const std::vector<double>& v) { options.pair = v; }}),
                    {});
  configuration.add("preset", options.preset, {{"best", Preset::best}, {"paper", Preset::paper}},
                    {.help = "Where all other keys start from.", .brings = [&options] {
                       std::vector<std::pair<std::string_view, std::string_view>> values;
                       if (options.preset == Preset::paper)
                         values = {{"odometry.voxel_size", "0.4"}, {"name", "paper's"}};
                       return values;
                     }});
  configuration.add("name", options.name, {});
  configuration.add("dataset", options.dataset, {});
  configuration.add_rule({"odometry.min_range", "odometry.max_range"}, "must be below odometry.max_range",
                         [&options] { return options.min_range < options.max_range; });
  return configuration;
}

/// What reading `text` as "site.toml" and applying it complains about, or "" if it does not.
std::string complaint(std::string_view text) {
  Options options;
  Configuration configuration = bound_to(options);
  try {
    configuration.load_text(text, "site.toml");
    configuration.apply();
  } catch (const ConfigError& error) {
    return error.what();
  }
  return "";
}

std::string complaint_of_override(std::string_view assignment) {
  Options options;
  Configuration configuration = bound_to(options);
  try {
    configuration.set(assignment);
    configuration.apply();
  } catch (const ConfigError& error) {
    return error.what();
  }
  return "";
}

/// A path that goes up as often as no TOML key has parts.
std::string repeated_folders() {
  std::string path;
  for (int i = 0; i < 100; ++i) path += "../";
  return path;
}

TEST_SUITE("support/configuration") {
  TEST_CASE("numbers that their member refuses are named with their line and what to write") {
    const std::string error = complaint("[sensor]\npair = [1, 2, 3]\n");
    CHECK(error.find("site.toml, line 2, column 8: 'sensor.pair' is no pair") == 0);
    CHECK(error.find("found: [1, 2, 3]") != std::string::npos);
    CHECK(error.find("do: write two numbers in brackets, or []") != std::string::npos);
    CHECK(complaint("[sensor]\npair = 1\n").find("wrong type") != std::string::npos);
    CHECK(complaint_of_override("sensor.pair=[1]").find("no pair") != std::string::npos);
    CHECK(complaint_of_override("sensor.pair=[]").empty());
  }

  TEST_CASE("values of every type reach their members") {
    Options options;
    Configuration configuration = bound_to(options);
    configuration.load_text(R"(
preset = "paper"
name = "caf\u00e9"
dataset = "/data/a b"
[odometry]
voxel_size = 1
blind_radius = 0.25
deskew = false
[keyframes]
angle_deg = 90
window = 1.5
[icp]
max_iterations = 7
[random]
seed = 9_000_000_000
[sensor]
lever_arm = [1, 2.5, -3]
pair = [4, 5]
)",
                            "site.toml");
    CHECK(options.voxel_size == 0.5);  // nothing changes before apply
    configuration.apply();
    CHECK(options.preset == Preset::paper);
    CHECK(options.name == "caf\xc3\xa9");
    CHECK(options.dataset == "/data/a b");
    CHECK(options.voxel_size == 1.0);
    CHECK(options.blind_radius == 0.25F);
    CHECK_FALSE(options.deskew);
    CHECK(options.keyframe_angle == doctest::Approx(std::numbers::pi / 2));
    CHECK(options.window == seconds(1.5));
    CHECK(options.max_iterations == 7);
    CHECK(options.seed == 9'000'000'000U);
    CHECK(options.lever_arm == std::array{1.0, 2.5, -3.0});
    CHECK(options.pair == std::vector{4.0, 5.0});
  }

  TEST_CASE("overrides win over the file, and a preset is set before all other keys, wherever it stands") {
    Options options;
    Configuration configuration = bound_to(options);
    configuration.load_text("[odometry]\nvoxel_size = 2\nmax_range = 50", "site.toml");
    configuration.set("preset=paper");
    configuration.set(" odometry.max_range = 60 ");
    configuration.set("dataset=/data/without quotes");
    configuration.set("name=\"with # quotes\"");
    configuration.apply();
    CHECK(options.voxel_size == 2.0);  // the preset's 0.4 gives way
    CHECK(options.max_range == 60.0);
    CHECK(options.dataset == "/data/without quotes");
    CHECK(options.name == "with # quotes");

    Options plain;
    Configuration preset_only = bound_to(plain);
    preset_only.set("preset=paper");
    preset_only.apply();
    CHECK(plain.voxel_size == 0.4);
    CHECK(plain.name == "paper's");

    Options back;
    Configuration two_presets = bound_to(back);
    two_presets.load_text("preset = \"paper\"", "site.toml");
    two_presets.set("preset=best");
    two_presets.apply();
    CHECK(back.voxel_size == Options().voxel_size);  // the last preset alone counts
  }

  TEST_CASE("a preset that brings what no key is or takes is the program's own mistake") {
    for (const std::string_view text : {"colour", "odometry.voxel_size"}) {
      bool preset = false;
      double voxel_size = 0.5;
      Configuration configuration;
      configuration.add("preset", preset, {.brings = [&] {
                          return std::vector<std::pair<std::string_view, std::string_view>>{{text, "9"}};
                        }});
      configuration.add("odometry.voxel_size", voxel_size, {.max = 5});
      configuration.set("preset=true");
      CHECK_THROWS_AS(configuration.apply(), std::logic_error);
    }
  }

  TEST_CASE("an unknown key is an error that names place, the nearest key and what it takes") {
    CHECK(complaint("[icp]\n  max_iteration = 7\n") ==
          "site.toml, line 2, column 3: unknown key 'icp.max_iteration'\n"
          "  found: 'icp.max_iteration'; did you mean 'icp.max_iterations' (an integer, 1 to 1000, default 20)?\n"
          "  do: correct the name; `chainslam config --explain icp.max_iterations` says more");
    CHECK(complaint("voxel_size = 0.4")
              .find("did you mean 'odometry.voxel_size' (a number, 0.05 to 5 m, default 0.5)?") != std::string::npos);
    CHECK(complaint("[odometri]\nvoxel_size = 0.4\n").find("did you mean 'odometry' (a table)?") != std::string::npos);
    CHECK(complaint("quux_frobnication = 1") ==
          "site.toml, line 1, column 1: unknown key 'quux_frobnication'\n"
          "  found: no key with a similar name\n"
          "  do: remove it; `chainslam config --print` lists all keys");
  }

  TEST_CASE("a value of the wrong type is an error that says what to write") {
    CHECK(complaint("[odometry]\nvoxel_size = \"0.4\"") ==
          "site.toml, line 2, column 14: 'odometry.voxel_size' has a value of the wrong type\n"
          "  found: \"0.4\", a string\n"
          "  do: write a number, 0.05 to 5 m");
    CHECK(complaint("[icp]\nmax_iterations = 7.0").find("found: 7.0, a number\n  do: write an integer, 1 to 1000") !=
          std::string::npos);
    CHECK(complaint("name = 3").find("found: 3, an integer\n  do: write a string") != std::string::npos);
    CHECK(complaint("dataset = false").find("do: write a path") != std::string::npos);
    CHECK(complaint("[odometry]\ndeskew = 1").find("do: write true or false") != std::string::npos);
    CHECK(complaint("name = 2020-01-01").find("found: a date or a time") != std::string::npos);
    CHECK(complaint("[name]\nx = 1").find("found: a table") != std::string::npos);
    CHECK(complaint("odometry = 4").find("write [odometry] on a line of its own") != std::string::npos);
    CHECK(complaint("[sensor]\nlever_arm = [1, 2]").find("do: write 3 numbers in brackets, -10 to 10 m") !=
          std::string::npos);
    CHECK(complaint("[sensor]\nlever_arm = [1, 2, \"3\"]").find("an array with values that are not numbers") !=
          std::string::npos);
    CHECK(complaint("[[odometry]]\nvoxel_size = 1").find("'odometry' is a table, not a value") != std::string::npos);
  }

  TEST_CASE("numbers out of range, NaN and infinities are errors") {
    CHECK(complaint("[odometry]\nvoxel_size = 0.01") ==
          "site.toml, line 2, column 14: 'odometry.voxel_size' is out of range\n"
          "  found: 0.01\n"
          "  do: write a number, 0.05 to 5 m");
    for (const char* value : {"nan", "inf", "-inf", "+nan"}) {
      CAPTURE(value);
      CHECK(complaint("[odometry]\nmax_range = " + std::string(value)).find("is not a finite number") !=
            std::string::npos);
    }
    CHECK(complaint("[icp]\nmax_iterations = 0").find("is out of range") != std::string::npos);
    CHECK(complaint("[random]\nseed = -1").find("is out of range") != std::string::npos);
    CHECK(complaint("[sensor]\nlever_arm = [1, 20, 3]").find("is out of range") != std::string::npos);
    CHECK(complaint("[keyframes]\nangle_deg = 181").find("write a number, 0 to 180 deg") != std::string::npos);
  }

  TEST_CASE("a choice takes its names alone, and says the nearest") {
    CHECK(complaint("preset = \"papr\"") ==
          "site.toml, line 1, column 10: 'preset' has no such choice\n"
          "  found: \"papr\"; did you mean \"paper\"?\n"
          "  do: write one of \"best\", \"paper\"");
  }

  TEST_CASE("syntax errors and keys that are there twice name their line") {
    CHECK(complaint("a = \n").starts_with("site.toml, line 1, column "));
    const std::string twice = complaint("[icp]\nmax_iterations = 1\nmax_iterations = 2");
    CHECK(twice.starts_with("site.toml, line 3, column "));
    CHECK(twice.find("cannot redefine existing integer 'max_iterations'") != std::string::npos);
    CHECK(complaint("[icp]\n[icp]\n").starts_with("site.toml, line 2"));
    CHECK(complaint("name = \"\xff\"").find("not TOML") != std::string::npos);
  }

  TEST_CASE("what nests too deeply for the parser is refused before it, in bounded time") {
    const auto repeated = [](const std::string& part, std::size_t bytes) {
      std::string text;
      while (text.size() + part.size() <= bytes) text += part;
      return text;
    };
    const std::string deep = "site.toml, line 2: nested too deeply\n  found: more than 32 levels\n  do: ";
    for (const char* part : {"a.", "[", "{a=", "[[", "'a'.", "\"a\".", "a . "})
      for (const std::size_t bytes : {std::size_t{400}, std::size_t{1'000'000}}) {
        CAPTURE(part);
        CHECK(complaint("\n" + repeated(part, bytes) + "a = 1").starts_with(deep));
        CHECK(complaint("\n[" + repeated(part, bytes) + "a]").starts_with(deep));
        CHECK(complaint("\na = " + repeated(part, bytes)).starts_with(deep));
      }
    CHECK(complaint_of_override("icp.max_iterations=" + std::string(100'000, '[')).find("wrong type") !=
          std::string::npos);
    const auto start = std::chrono::steady_clock::now();
    for (const char* part : {"k = 1\n", "\"\"\"", "''' ", "x = '[[[[....'\n", "[a]\n", "1.", "\\\""})
      CHECK(!complaint(repeated(part, 1'000'000)).empty());
    std::string keys;  // unknown ones, each of which would be compared with all that are known
    for (int i = 0; keys.size() < 1'000'000; ++i) keys += "k" + std::to_string(i) + std::string(200, 'x') + " = 1\n";
    CHECK(complaint(keys).find("unknown key") != std::string::npos);
    CHECK(std::chrono::steady_clock::now() - start < std::chrono::seconds(9));  // a second each
  }

  TEST_CASE("strings and remarks may hold as many brackets and points as they like") {
    const std::string many(1000, '['), points(1000, '.');
    CHECK(complaint("name = \"" + many + points + "\" # " + many + "\n[icp]\nmax_iterations = 3").empty());
    CHECK(complaint("name = '" + points + many + "'\n").empty());
    CHECK(complaint("name = \"\"\"\n" + many + "\"" + points + "\\\"\"\"\"\n").empty());
    CHECK(complaint("name = '''\n" + many + "'" + points + "'''\n").empty());
    CHECK(complaint_of_override("dataset=" + repeated_folders()).empty());
  }

  TEST_CASE("of several errors the first in the file is told") {
    CHECK(complaint("zzz_b = 1\naaa_a = 2\n").starts_with("site.toml, line 1, column 1"));
    CHECK(complaint("[odometry]\nvoxel_size = 9\n[icp]\nmax_iterations = 0").find("line 2") != std::string::npos);
  }

  TEST_CASE("a rule between keys is checked when all are set, and tells all their values") {
    CHECK(complaint("[odometry]\nmin_range = 200") ==
          "site.toml, line 2, column 13: 'odometry.min_range' must be below odometry.max_range\n"
          "  found: odometry.min_range = 200.0, odometry.max_range = 100.0\n"
          "  do: change one of them; `chainslam config --explain odometry.min_range` gives the default");
    CHECK(complaint("[odometry]\nmin_range = 200\nmax_range = 300").empty());
  }

  TEST_CASE("of another version's file, what no key takes is left out and named; the rest holds") {
    Options options;
    Configuration configuration = bound_to(options);
    const std::vector<std::string> left_out = configuration.load_foreign_text(
        "preset = \"worst\"\nname = \"x\"\ndate = 2020-01-01\nicp = 3\n[odometry]\nvoxel_size = 0.25\n"
        "max_range = -1\nmin_range = \"far\"\nvoxels = [1, 2]\n[old.part]\na = true\n[sensor]\npair = [1]\n",
        "parameters");
    CHECK(left_out == std::vector<std::string>{"date = (a value of another type)", "icp = 3", "odometry.max_range = -1",
                                               "odometry.min_range = \"far\"", "odometry.voxels = [1, 2]",
                                               "old.part.a = true", "preset = \"worst\"", "sensor.pair = [1]"});
    const std::vector<std::string> unassigned = configuration.unassigned();
    CHECK(unassigned.size() == configuration.names().size() - 2);
    for (const char* name : {"name", "odometry.voxel_size"})
      CHECK(std::ranges::find(unassigned, name) == unassigned.end());
    configuration.apply();
    CHECK(options.voxel_size == 0.25);
    CHECK(options.name == "x");
    CHECK(options.max_range == Options().max_range);
    CHECK(options.preset == Preset::best);
    for (const char* text : {"<settings/>", "a = 1\na = 2\n"})
      CHECK_THROWS_AS(static_cast<void>(configuration.load_foreign_text(text, "parameters")), ConfigError);

    std::string strange;  // of many keys that are unknown no nearest name is sought
    for (int i = 0; i < 30'000; ++i) strange += "odometry.voxel_sise" + std::to_string(i) + " = 1\n";
    const auto begin = std::chrono::steady_clock::now();
    CHECK(configuration.load_foreign_text(strange, "parameters").size() == 30'000);
    CHECK(std::chrono::steady_clock::now() - begin < std::chrono::seconds(2));
  }

  TEST_CASE("overrides complain as files do") {
    CHECK(complaint_of_override("odometry.voxel_size=fast") ==
          "--set odometry.voxel_size=fast: 'odometry.voxel_size' has a value of the wrong type\n"
          "  found: \"fast\", a string\n"
          "  do: write a number, 0.05 to 5 m");
    CHECK(complaint_of_override("odometry.voxel_size").find("write --set table.key=value") != std::string::npos);
    CHECK(complaint_of_override("=1").find("no assignment") != std::string::npos);
    CHECK(complaint_of_override("icp.max_iterations=").find("wrong type") != std::string::npos);
    CHECK(complaint_of_override("icp.max_iterations=1\nother=2").find("wrong type") != std::string::npos);
    CHECK(complaint_of_override("icp.maxiterations=1").find("did you mean 'icp.max_iterations'") != std::string::npos);
    CHECK(complaint_of_override("icp=1").find("unknown key 'icp'") != std::string::npos);
  }

  TEST_CASE("files that cannot be read are errors that name them") {
    Configuration configuration;
    CHECK_THROWS_WITH_AS(configuration.load("/nowhere/site.toml"),
                         "/nowhere/site.toml: cannot be read\n  found: No such file or directory\n"
                         "  do: give the name of a TOML file",
                         ConfigError);
    CHECK_THROWS_AS(configuration.load("/"), ConfigError);
    const auto large = std::filesystem::temp_directory_path() / "chainslam_large_configuration.toml";
    std::ofstream(large) << std::string(3'000'000, '#');
    CHECK_THROWS_AS(configuration.load(large), ConfigError);
    std::filesystem::remove(large);
  }

  TEST_CASE("carriage returns, a byte order mark and an empty file are fine") {
    CHECK(complaint("\xef\xbb\xbfname = \"x\"\r\n[icp]\r\nmax_iterations = 3\r\n").empty());
    CHECK(complaint("").empty());
  }

  TEST_CASE("what is printed reads back as the same values") {
    test::for_all(200, [](Rng& rng, int) {
      Options options;
      Configuration configuration = bound_to(options);
      const Options random{.preset = rng.uniform() < 0.5 ? Preset::best : Preset::paper,
                           .voxel_size = rng.uniform(0.05, 5.0),
                           .blind_radius = static_cast<float>(std::exp(rng.uniform(-30, 30))),
                           .keyframe_angle = rng.uniform(0, 180) * (std::numbers::pi / 180.0),
                           .max_iterations = 1 + rng.uniform_index(1000),
                           .seed = rng.bits() >> 1,
                           .deskew = rng.uniform() < 0.5,
                           .window = Duration(rng.uniform_index(2'000'000'000)),
                           .min_range = rng.uniform(),
                           .max_range = std::exp(rng.uniform(1, 300)),
                           .name = "quote \" backslash \\ tab \t end \x7f newline \n",
                           .dataset = "caf\xc3\xa9",
                           .lever_arm = {rng.normal(), -0.0, 1e-9 * rng.normal()}};
      options = random;
      const std::string text = configuration.print();
      options = Options{};
      configuration.load_text(text, "printed");
      configuration.apply();
      CHECK(options.preset == random.preset);
      CHECK(options.voxel_size == random.voxel_size);
      CHECK(options.blind_radius == random.blind_radius);
      CHECK(options.keyframe_angle == random.keyframe_angle);
      CHECK(options.max_iterations == random.max_iterations);
      CHECK(options.seed == random.seed);
      CHECK(options.deskew == random.deskew);
      CHECK(options.window == random.window);
      CHECK(options.max_range == random.max_range);
      CHECK(options.name == random.name);
      CHECK(options.dataset == random.dataset);
      CHECK(options.lever_arm == random.lever_arm);
      CHECK(configuration.print() == text);
    });
  }

  TEST_CASE("numbers are printed as people write them") {
    Options options;
    Configuration configuration = bound_to(options);
    for (const double value : {30.0, 0.1, 2.5, 1e-9, 86400.0, 3.3333333333333335}) {
      options.window = seconds(value);
      const std::string text = configuration.explain("keyframes.window");
      const std::string number = text.substr(text.find("= ") + 2, text.find('\n') - text.find("= ") - 2);
      CHECK(number.size() <= 11);
      CHECK(seconds(std::stod(number)) == options.window);
    }
    options.window = seconds(30.0);
    CHECK(configuration.print().find("window = 30.0\n") != std::string::npos);
  }

  TEST_CASE("a default in another unit is shown by six digits, which stand for it and for nothing else") {
    double angle = 0.2;  // rad: 11.459155902616464 degrees
    float slope = 0.2F;
    Configuration configuration;
    const KeyInfo degrees{.unit = "deg", .min = 0, .max = 180, .factor = std::numbers::pi / 180};
    configuration.add("a.angle", angle, degrees);
    configuration.add("a.slope", slope, degrees);
    const std::string defaults = configuration.print();
    CHECK(defaults.find("default 11.4592") == std::string::npos);  // it is the value
    CHECK(defaults.find("angle = 11.4592\n") != std::string::npos);
    CHECK(defaults.find("slope = 11.4592\n") != std::string::npos);
    angle = 1;
    slope = 1;
    configuration.load_text(defaults, "printed");
    configuration.apply();
    CHECK(angle == 0.2);
    CHECK(slope == 0.2F);

    configuration.set("a.angle=11.459155902616464");  // as programs before wrote it
    configuration.apply();
    CHECK(angle == 0.2);
    configuration.set("a.angle=11.46");
    configuration.apply();
    CHECK(angle == 11.46 * std::numbers::pi / 180);
    CHECK(configuration.print().find("; default 11.4592.\nangle = 11.46\n") != std::string::npos);

    angle = std::nextafter(0.2, 1.0);  // next to the default, and not it
    const std::string near = configuration.print();
    CHECK(near.find("angle = 11.4592\n") == std::string::npos);
    const double next = angle;
    angle = 0;
    configuration.load_text(near, "printed");
    configuration.apply();
    CHECK(angle == next);
  }

  TEST_CASE("rounding takes no default out of its range") {
    double angle = 0.2;
    Configuration configuration;
    configuration.add("a.angle", angle, {.unit = "deg", .max = 11.459155902616464, .factor = std::numbers::pi / 180});
    CHECK(configuration.print().find("angle = 11.459155902616464\n") != std::string::npos);
    CHECK_NOTHROW(configuration.load_text(configuration.print(), "printed"));
  }

  TEST_CASE("the printed file comments each key and groups them by table") {
    Options options;
    Configuration configuration = bound_to(options);
    options.voxel_size = 0.4;
    const std::string text = configuration.print();
    CHECK(
        text.starts_with("# Where all other keys start from. Takes one of \"best\", \"paper\".\npreset = \"best\"\n"));
    CHECK(
        text.find("\n[odometry]\n# Edge of the voxels that a scan is reduced to. Takes a number, 0.05 to 5 m; default "
                  "0.5.\nvoxel_size = 0.4\n") != std::string::npos);
    CHECK(text.find("angle_deg = 10.0\n") != std::string::npos);
  }

  TEST_CASE("explain says what a key means, lists a table, and knows the nearest name") {
    Options options;
    const Configuration configuration = bound_to(options);
    CHECK(configuration.explain("odometry.voxel_size") ==
          "odometry.voxel_size = 0.5\n  Edge of the voxels that a scan is reduced to.\n"
          "  Takes a number, 0.05 to 5 m; default 0.5.\n");
    CHECK(configuration.explain("keyframes") == "keyframes.angle_deg = 10.0 deg\nkeyframes.window = 0.25 s\n");
    CHECK_THROWS_WITH_AS(static_cast<void>(configuration.explain("keyframe.windw")),
                         "--explain: unknown key 'keyframe.windw'\n"
                         "  found: 'keyframe.windw'; did you mean 'keyframes.window' (a number, at least 0 s, default "
                         "0.25)?\n  do: correct the name; `chainslam config --explain keyframes.window` says more",
                         ConfigError);
  }

  TEST_CASE("a program's own mistakes are told when it registers its keys") {
    double value = 3.0;
    Configuration configuration;
    configuration.add("a.b", value, {.max = 5});
    CHECK_THROWS_AS(configuration.add("a.b", value, {}), std::logic_error);
    CHECK_THROWS_AS(configuration.add("a.c", value, {.max = 2}), std::logic_error);
    CHECK_THROWS_AS(configuration.add_rule({"a.d"}, "must be", [] { return true; }), std::logic_error);
  }

  TEST_CASE("a count is kept in its own unit and written in the file's; without a factor no digit is lost") {
    std::uint64_t bytes = std::uint64_t{512} << 20, seed = (std::uint64_t{1} << 62) + 1;
    Configuration configuration;
    configuration.add("cache.memory", bytes, {.unit = "MiB", .min = 1, .max = 1e6, .factor = 1 << 20});
    configuration.add("random.seed", seed, {});
    CHECK(configuration.print().find("memory = 512\n") != std::string::npos);
    CHECK(configuration.print().find("seed = 4611686018427387905\n") != std::string::npos);
    configuration.set("cache.memory=3");
    configuration.set("random.seed=4611686018427387903");
    configuration.apply();
    CHECK(bytes == std::uint64_t{3} << 20);
    CHECK(seed == (std::uint64_t{1} << 62) - 1);
    CHECK_THROWS_AS(configuration.set("cache.memory=0"), ConfigError);
    CHECK_THROWS_AS(configuration.set("cache.memory=2000000"), ConfigError);
  }
}

}  // namespace
}  // namespace chainslam::support
