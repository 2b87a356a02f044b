#include "architecture/wording.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

using namespace chainslam::test;

namespace {

namespace fs = std::filesystem;

std::string content_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  REQUIRE_MESSAGE(file.good(), path.string());
  return {std::istreambuf_iterator<char>(file), {}};
}

/// Files of a folder of the checkout by their endings, sorted; names are relative to the checkout.
std::vector<std::string> files_in(const std::string& folder, const std::vector<std::string>& endings) {
  const fs::path root = CHAINSLAM_SOURCE_DIR;
  std::vector<std::string> names;
  for (const auto& entry : fs::recursive_directory_iterator(root / folder))
    if (entry.is_regular_file() && std::ranges::count(endings, entry.path().extension().string()) > 0)
      names.push_back(entry.path().lexically_relative(root).generic_string());
  std::ranges::sort(names);
  return names;
}

void check(const std::string& name, const std::string& text) {
  for (const std::string& one : avoided_in(name, text)) FAIL_CHECK(one);
}

}  // namespace

TEST_SUITE("architecture/wording") {
  TEST_CASE("pages use the field's terms") {
    std::vector<std::string> pages{"README.md", "CHANGELOG.md"};
    for (const char* folder : {"bench", "examples", "include", "test"})
      for (std::string& name : files_in(folder, {".md"})) pages.push_back(std::move(name));
    CHECK(pages.size() > 6);
    for (const std::string& name : pages)
      check(name, prose_of_markdown(content_of(fs::path(CHAINSLAM_SOURCE_DIR) / name)));
  }

  TEST_CASE("help, settings, messages and reports use the field's terms") {
    std::size_t count = 0;
    for (const char* folder : {"examples/datasets", "examples/mapper", "examples/mpi", "examples/simulator",
                               "examples/support", "examples/tasks"})
      for (const std::string& name : files_in(folder, {".cpp", ".hpp"})) {
        check(name, messages_of(content_of(fs::path(CHAINSLAM_SOURCE_DIR) / name)));
        ++count;
      }
    CHECK(count > 100);
  }

  TEST_CASE("public docstrings use the field's terms") {
    std::size_t count = 0;
    for (const std::string& name : files_in("include/chainslam", {".hpp"})) {
      if (name.find("/detail/") != std::string::npos) continue;
      check(name, docstrings_of(content_of(fs::path(CHAINSLAM_SOURCE_DIR) / name)));
      ++count;
    }
    CHECK(count > 100);
  }

  TEST_CASE("descriptions of settings are sentences") {
    std::size_t count = 0;
    for (const char* name : {"examples/mapper/options.cpp", "examples/mapper/back_end_options.cpp"}) {
      const std::string source = content_of(fs::path(CHAINSLAM_SOURCE_DIR) / name);
      for (std::size_t at = source.find(".help ="); at != std::string::npos; at = source.find(".help =", at + 1)) {
        const std::size_t end = source.find('}', at);
        const std::size_t first = source.find('"', at), last = source.rfind('"', end);
        REQUIRE(last > first);
        const std::string text = source.substr(first + 1, last - first - 1);
        CHECK_MESSAGE(std::isupper(static_cast<unsigned char>(text[0])) != 0, text);
        CHECK_MESSAGE(text.back() == '.', text);
        CHECK_MESSAGE(std::ranges::count(text, ' ') >= 2, text);
        ++count;
      }
    }
    CHECK(count > 100);
  }

  TEST_CASE("the checker finds words by themselves, in any case, and words that begin alike") {
    CHECK(find_word("A Room, a roomy room", "room") == 2);
    CHECK(find_word("A Room, a roomy room", "room", 3) == 16);
    CHECK(find_word("roomy mushroom room_size room/a.md", "room") == std::string::npos);
    CHECK(find_word("It is optimised.", "optimis*") == 6);
    CHECK(find_word("", "room") == std::string::npos);
  }

  TEST_CASE("the checker reads prose, docstrings and messages, and nothing else") {
    CHECK(prose_of_markdown("a `room`\n```\nroom\n```\n[b](room.md) c") == "a \n\n\n\n[b c");
    CHECK(docstrings_of("int room;  ///< a `room` b\n// room\n") == "< a  b\n\n");
    CHECK(messages_of("f(\"two words\", \"one\");  // \"not this\"\n#include \"a b\"\n// \"c d\"\n") ==
          "two words  not this  \n\n\n");
    CHECK(messages_of("f(\"say \\\"room\\\" and `room` here\");\n") == "say  and  here  \n");
    CHECK(avoided_in("a.md", "x\nthe rooms\n") == std::vector<std::string>{"a.md:2: 'rooms': write modules"});
  }
}
