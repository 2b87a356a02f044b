#include <doctest/doctest.h>

#include <cctype>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <set>
#include <string>

#include "architecture/include_rules.hpp"

using namespace chainslam::test;

namespace {

std::string read_text(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  REQUIRE_MESSAGE(file.good(), path.string());
  return {std::istreambuf_iterator<char>(file), {}};
}

/// The modules and their arrows, as the README draws them.
IncludeRules library_rules() {
  IncludeRules rules;
  rules.arrows = {{"core", {}},
                  {"lie", {"core"}},
                  {"trajectory", {"search"}},  // keyframes near each other are searched
                  {"cloud", {"lie"}},          // clouds are moved by poses
                  {"sensor", {"cloud"}},
                  {"sparse", {"core"}},
                  {"search", {"cloud"}},
                  {"features", {"search"}},
                  {"registration", {"features"}},
                  {"factor_graph", {"lie", "sparse"}},
                  {"odometry", {"search", "sensor"}},
                  {"slam", {"registration", "factor_graph", "sensor", "trajectory"}},
                  {"io", {"slam"}}};
  rules.opt_in = opt_in_headers(read_text(CHAINSLAM_SOURCE_DIR "/CMakeLists.txt"));
  rules.forbidden = {"iostream", "regex", "functional", "Eigen/Dense", "Eigen/Eigen"};
  rules.forbidden_words = {"std::cout", "std::cerr", "printf(stdout", "printf(stderr", "std::printf", "std::puts"};
  rules.umbrella = "chainslam.hpp";
  return rules;
}

std::vector<Header> library_headers() {
  const std::filesystem::path root = CHAINSLAM_SOURCE_DIR "/include/chainslam";
  std::vector<Header> headers;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(root))
    if (entry.path().extension() == ".hpp")
      headers.push_back({entry.path().lexically_relative(root).generic_string(), read_text(entry.path())});
  std::sort(headers.begin(), headers.end(), [](const Header& a, const Header& b) { return a.path < b.path; });
  return headers;
}

/// A small library that keeps to its rules: top -> middle -> base, an opt-in header and an umbrella.
std::vector<Header> made_up() {
  return {{"base/a.hpp", "#pragma once\n#include <vector>\n#include \"chainslam/base/detail/b.hpp\"\n"},
          {"base/detail/b.hpp", "#pragma once\n"},
          {"middle/c.hpp", "#pragma once\n#include \"chainslam/base/a.hpp\"\n"},
          {"top/d.hpp", "#pragma once\n#include \"chainslam/base/a.hpp\"\n#include \"chainslam/middle/c.hpp\"\n"},
          {"top/heavy.hpp", "#pragma once\n#include <heavy/heavy.h>\n"},
          {"all.hpp",
           "#pragma once\n#include \"chainslam/base/a.hpp\"\n#include \"chainslam/middle/c.hpp\"\n"
           "#include \"chainslam/top/d.hpp\"\n"}};
}

IncludeRules made_up_rules() {
  IncludeRules rules;
  rules.arrows = {{"base", {}}, {"middle", {"base"}}, {"top", {"middle"}}};
  rules.opt_in = {{"top/heavy.hpp", "heavy"}};
  rules.forbidden = {"iostream"};
  rules.forbidden_words = {"std::cout"};
  rules.umbrella = "all.hpp";
  rules.longest = 5;
  return rules;
}

/// The problems after one made-up header was given more text.
std::vector<std::string> problems_with(const std::string& path, const std::string& more) {
  auto headers = made_up();
  for (Header& header : headers)
    if (header.path == path) header.text += more;
  return include_problems(headers, made_up_rules());
}

/// The explicit instantiations that stand in a text after `begin`, "extern template " or "template ", without blanks.
std::set<std::string> instantiations(const std::string& text, const std::string& begin) {
  std::set<std::string> found;
  for (std::size_t at = text.find('\n' + begin); at != std::string::npos; at = text.find('\n' + begin, at + 1)) {
    const std::size_t from = at + 1 + begin.size();
    if (text[from] == '<') continue;  // a template or a specialization
    std::string one;
    for (const char c : text.substr(from, text.find(';', from) - from))
      if (!std::isspace(static_cast<unsigned char>(c))) one += c;
    found.insert(one);
  }
  return found;
}

using Problems = std::vector<std::string>;

}  // namespace

TEST_SUITE("architecture") {
  TEST_CASE("every header keeps to the arrows between modules and to the rules of style") {
    const auto headers = library_headers();
    CHECK(headers.size() > 40);
    CHECK(std::ranges::count_if(headers, [](const Header& h) { return !is_private(h.path); }) <= 150);
    for (const std::string& problem : include_problems(headers, library_rules())) FAIL_CHECK(problem);
  }

  TEST_CASE("what headers declare as compiled is what the library holds, and nothing else") {
    std::set<std::string> declared, defined;
    for (const Header& header : library_headers()) declared.merge(instantiations(header.text, "extern template "));
    for (const auto& entry : std::filesystem::directory_iterator(CHAINSLAM_SOURCE_DIR "/include/chainslam/compiled"))
      defined.merge(instantiations(read_text(entry.path()), "template "));
    CHECK(declared.size() > 10);
    for (const std::string& one : declared) CHECK_MESSAGE(defined.contains(one), "declared, but not defined: ", one);
    for (const std::string& one : defined) CHECK_MESSAGE(declared.contains(one), "defined, but not declared: ", one);
    CHECK(instantiations("x\ntemplate <>\ntemplate class\n  A<B>;\n", "template ") ==
          std::set<std::string>{"classA<B>"});
  }

  TEST_CASE("the opt-in headers are those that CMake gives targets of their own") {
    CHECK(
        opt_in_headers("set(other a:b.hpp)\nset(chainslam_opt_in\n    tree:search/tree.hpp\n    solver:sparse/s.hpp)\n"
                       "set(more c:d.hpp)") ==
        std::map<std::string, std::string>{{"search/tree.hpp", "tree"}, {"sparse/s.hpp", "solver"}});
    CHECK(library_rules().opt_in.contains("sparse/cholmod.hpp"));
  }

  TEST_CASE("the checker is content with what keeps to the rules") {
    CHECK(include_problems(made_up(), made_up_rules()).empty());
  }

  TEST_CASE("the checker sees an include against the arrows") {
    CHECK(problems_with("middle/c.hpp", "#include \"chainslam/top/d.hpp\"\n") ==
          Problems{"middle/c.hpp: includes top/d.hpp, but no arrow leads from middle to top",
                   "middle/c.hpp: includes itself by way of top/d.hpp"});
    CHECK(problems_with("base/a.hpp", "  #  include \"chainslam/middle/c.hpp\"  // why\n").size() == 2);
    auto headers = made_up();
    headers.push_back({"attic/x.hpp", "#pragma once\n#include \"chainslam/base/a.hpp\"\n"});
    CHECK(include_problems(headers, made_up_rules()) ==
          Problems{"attic/x.hpp: is in no known module", "all.hpp: does not include attic/x.hpp"});
  }

  TEST_CASE("the checker sees another module's private header, and one that is not there") {
    CHECK(problems_with("middle/c.hpp", "#include \"chainslam/base/detail/b.hpp\"\n") ==
          Problems{"middle/c.hpp: includes base/detail/b.hpp, which is private to base"});
    CHECK(problems_with("middle/c.hpp", "#include \"chainslam/base/z.hpp\"\n") ==
          Problems{"middle/c.hpp: includes base/z.hpp, which is not there"});
  }

  TEST_CASE("the checker sees what a private header declares for users") {
    CHECK(problems_with("base/detail/b.hpp", "namespace a {\nclass B {\n") ==
          Problems{"base/detail/b.hpp: declares for users: class B"});
    CHECK(problems_with("base/detail/b.hpp", "namespace a::detail {\nclass B {\n").empty());
    CHECK(problems_with("base/detail/b.hpp", "namespace a {\nstruct B;\nstruct C<D>::E {\n").empty());
  }

  TEST_CASE("bodies of a class may include it, and nothing else may include what includes it") {
    CHECK(has_bodies_of("base/detail/a_update.hpp", "base/a.hpp"));
    CHECK_FALSE(has_bodies_of("base/detail/b_update.hpp", "base/a.hpp"));
    CHECK_FALSE(has_bodies_of("base/a_update.hpp", "base/a.hpp"));
    auto headers = made_up();
    headers[0].text += "#include \"chainslam/base/detail/a_update.hpp\"\n";
    headers.push_back({"base/detail/a_update.hpp", "#pragma once\n#include \"chainslam/base/a.hpp\"\n"});
    CHECK(include_problems(headers, made_up_rules()).empty());
    headers.back().path = "base/detail/b_update.hpp";
    headers[0].text += "#include \"chainslam/base/detail/b_update.hpp\"\n";
    CHECK(include_problems(headers, made_up_rules()).size() == 2);  // a cycle, and what is not there
  }

  TEST_CASE("the checker sees opt-in headers where they must not be") {
    CHECK(problems_with("top/d.hpp", "#include \"chainslam/top/heavy.hpp\"\n") ==
          Problems{"top/d.hpp: includes the opt-in header top/heavy.hpp"});
    CHECK(problems_with("all.hpp", "#include \"chainslam/top/heavy.hpp\"\n") ==
          Problems{"all.hpp: includes the opt-in header top/heavy.hpp"});
  }

  TEST_CASE("opt-in headers include those of their own target and of no other") {
    auto headers = made_up();
    headers.push_back({"top/heavier.hpp", "#pragma once\n#include \"chainslam/top/heavy.hpp\"\n"});
    IncludeRules rules = made_up_rules();
    rules.opt_in["top/heavier.hpp"] = "heavy";
    CHECK(include_problems(headers, rules).empty());
    rules.opt_in["top/heavier.hpp"] = "light";
    CHECK(include_problems(headers, rules) == Problems{"top/heavier.hpp: includes the opt-in header top/heavy.hpp"});
  }

  TEST_CASE("the checker sees what the umbrella lacks, and who includes the umbrella") {
    auto headers = made_up();
    headers.push_back({"top/new.hpp", "#pragma once\n"});
    CHECK(include_problems(headers, made_up_rules()) == Problems{"all.hpp: does not include top/new.hpp"});
    CHECK(problems_with("top/heavy.hpp", "#include \"chainslam/all.hpp\"\n").size() == 2);  // that, and no arrow
    headers = made_up();
    headers.pop_back();
    CHECK(include_problems(headers, made_up_rules()) == Problems{"all.hpp: is not there"});
  }

  TEST_CASE("the checker sees forbidden headers, words, lengths and beginnings") {
    CHECK(problems_with("base/a.hpp", "#include <iostream>\n") == Problems{"base/a.hpp: includes <iostream>"});
    CHECK(problems_with("base/a.hpp", "inline void f() { std::cout << 1; }\n") ==
          Problems{"base/a.hpp: says std::cout"});
    CHECK(problems_with("base/a.hpp", "\n\n\n") == Problems{"base/a.hpp: has 6 lines: look for the second idea"});
    auto headers = made_up();
    headers[0].text = "\n" + headers[0].text;
    CHECK(include_problems(headers, made_up_rules()) == Problems{"base/a.hpp: does not start with #pragma once"});
    CHECK(problems_with("top/d.hpp", "#include \"d.hpp\"\n") ==
          Problems{"top/d.hpp: includes \"d.hpp\" without its whole name chainslam/..."});
    CHECK(problems_with("top/d.hpp", "#include <chainslam/base/a.hpp>\n") ==
          Problems{"top/d.hpp: includes <chainslam/base/a.hpp> with angle brackets"});
  }

  TEST_CASE("every source that reads files from outside is fuzzed by a target that is named here") {
    // What opens nothing of its own, or opens the program's own or the system's files, has none.
    const std::map<std::string, std::string> targets{{"include/chainslam/io/detail/input_stream.hpp", ""},
                                                     {"include/chainslam/io/detail/map_file_reader.hpp", "map_chunks"},
                                                     {"include/chainslam/io/detail/open_to_read.hpp", ""},
                                                     {"include/chainslam/io/detail/partial_file.hpp", ""},
                                                     {"include/chainslam/io/detail/point_records.hpp", "pcd"},
                                                     {"include/chainslam/io/file_system.hpp", ""},
                                                     {"include/chainslam/io/g2o.hpp", "g2o"},
                                                     {"include/chainslam/io/input_file.hpp", "tum"},
                                                     {"include/chainslam/io/input_journal.hpp", "input_journal"},
                                                     {"include/chainslam/io/map_archive.hpp", "cslam"},
                                                     {"include/chainslam/io/pcd.hpp", "point_headers"},
                                                     {"include/chainslam/io/ply.hpp", "ply"},
                                                     {"include/chainslam/io/trajectory_file.hpp", "tum"},
                                                     {"examples/datasets/cloud_folder.cpp", "kitti"},
                                                     {"examples/datasets/db3.cpp", "db3"},
                                                     {"examples/datasets/extrinsic.cpp", "extrinsic"},
                                                     {"examples/datasets/files.cpp", "stamps"},
                                                     {"examples/datasets/imu_table.cpp", "imu_table"},
                                                     {"examples/datasets/inspect.cpp", ""},
                                                     {"examples/datasets/json_table.cpp", "nuscenes"},
                                                     {"examples/datasets/keyframe_set.cpp", "keyframes"},
                                                     {"examples/datasets/kitti_calibration.cpp", "kitti_calibration"},
                                                     {"examples/datasets/kitti_raw.cpp", "kitti_raw"},
                                                     {"examples/datasets/mcap.cpp", "mcap"},
                                                     {"examples/datasets/mulran.cpp", "mulran"},
                                                     {"examples/datasets/nclt.hpp", "nclt_hits"},
                                                     {"examples/datasets/number_rows.hpp", "nclt_tables"},
                                                     {"examples/datasets/png_image.cpp", "png"},
                                                     {"examples/datasets/pose_table.hpp", "newer_college"},
                                                     {"examples/datasets/range_image.cpp", "range_images"},
                                                     {"examples/datasets/recorded_set.cpp", "recorded_odometry"},
                                                     {"examples/datasets/ros1_bag.cpp", "bag"},
                                                     {"examples/mapper/drive_choice.cpp", "program_drive_choice"},
                                                     {"examples/mapper/inspect.cpp", ""},
                                                     {"examples/mapper/program.cpp", ""},
                                                     {"examples/mapper/map_file.cpp", "cslam"},
                                                     {"examples/mapper/recorded_imu.cpp", "program_recorded_drive"},
                                                     {"examples/mapper/recorded_input.cpp", "program_recorded_drive"},
                                                     {"examples/mapper/recorded_simulation.cpp", ""},
                                                     {"examples/mapper/summary_file.cpp", "program_summary"},
                                                     {"examples/mapper/trajectory_file.cpp", "program_trajectory"},
                                                     {"examples/support/configuration.cpp", "toml"},
                                                     {"examples/support/progress.cpp", ""},
                                                     {"examples/support/report.cpp", ""}};
    const std::filesystem::path root = CHAINSLAM_SOURCE_DIR;
    const auto opens = [](const std::string& source) {
      for (const char* word : {"InputFile file", "InputFile rows", "InputFile source", "InputFile(", "ifstream",
                               "MapFileReader file", "sqlite3_open", "::open(", "input_stream("})
        if (source.find(word) != std::string::npos) return true;
      return false;
    };
    std::set<std::string> readers;
    for (const char* folder :
         {"include/chainslam", "examples/datasets", "examples/mapper", "examples/support", "examples/simulator"})
      for (const auto& entry : std::filesystem::recursive_directory_iterator(root / folder))
        if (entry.is_regular_file() && entry.path().extension() != ".md" && opens(read_text(entry.path())))
          readers.insert(entry.path().lexically_relative(root).generic_string());
    CHECK(readers.size() > 30);
    for (const std::string& reader : readers)
      CHECK_MESSAGE(targets.contains(reader), reader << " reads files; name the target that fuzzes it");
    for (const auto& entry : targets) {
      CHECK_MESSAGE(std::filesystem::exists(root / entry.first), entry.first);
      const std::string fuzzer = entry.second.empty() ? "run.sh" : entry.second + ".cpp";
      CHECK_MESSAGE(std::filesystem::exists(root / "test/fuzz" / fuzzer), fuzzer);
    }
  }
}
