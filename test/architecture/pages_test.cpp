#include <doctest/doctest.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <string>
#include <vector>

#include "architecture/wording.hpp"
#include "chainslam/core/version.hpp"

// What the README and the pages that it leads to promise, against the tree.

namespace {

namespace fs = std::filesystem;

const fs::path checkout = CHAINSLAM_SOURCE_DIR;

std::string page(const fs::path& path) {
  std::ifstream file(checkout / path, std::ios::binary);
  REQUIRE_MESSAGE(file.good(), path.string());
  return {std::istreambuf_iterator<char>(file), {}};
}

/// Where a page can be entered: its headings as GitHub writes them in addresses, and what has an id.
std::set<std::string> anchors_of(const std::string& text) {
  std::set<std::string> anchors;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::string line = text.substr(at, end - at);
    at = end + 1;
    if (line.starts_with('#')) {
      std::string name;
      for (const char c : line.substr(line.find_first_not_of("# ")))
        if (std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '-' || c == '_')
          name += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
        else if (c == ' ')
          name += '-';
      anchors.insert(name);
    }
    constexpr std::string_view mark = "id=\"";
    for (std::size_t id = line.find(mark); id != std::string::npos; id = line.find(mark, id + 1))
      anchors.insert(line.substr(id + mark.size(), line.find('"', id + mark.size()) - id - mark.size()));
  }
  return anchors;
}

/// Addresses of links and pictures within the checkout; lambdas in code are none.
std::vector<std::string> links_of(const std::string& page) {
  const std::string text = chainslam::test::without(page, "```", "```");
  std::vector<std::string> links;
  for (std::size_t at = text.find("]("); at != std::string::npos; at = text.find("](", at + 1)) {
    const std::string link = text.substr(at + 2, text.find(')', at) - at - 2);
    if (!link.starts_with("http")) links.push_back(link);
  }
  return links;
}

/// First cells of the rows of the table below a heading, without marks of code.
std::set<std::string> first_cells(const std::string& text, const std::string& heading) {
  const std::size_t begin = text.find("\n## " + heading + '\n'), end = text.find("\n## ", begin + 1);
  REQUIRE(begin != std::string::npos);
  std::set<std::string> cells;
  for (std::size_t at = text.find("\n| `", begin); at < end; at = text.find("\n| `", at + 1))
    cells.insert(text.substr(at + 4, text.find('`', at + 4) - at - 4));
  return cells;
}

}  // namespace

TEST_SUITE("architecture/pages") {
  TEST_CASE("links and pictures of all pages lead somewhere") {
    std::vector<fs::path> pages{"README.md", "CHANGELOG.md"};
    for (const char* folder : {"bench", "examples", "include", "test"})
      for (const auto& entry : fs::recursive_directory_iterator(checkout / folder))
        if (entry.path().extension() == ".md") pages.push_back(entry.path().lexically_relative(checkout));
    std::size_t count = 0;
    for (const fs::path& from : pages)
      for (const std::string& link : links_of(page(from))) {
        const std::size_t hash = std::min(link.find('#'), link.size());
        const fs::path to = hash == 0 ? from : (from.parent_path() / link.substr(0, hash)).lexically_normal();
        CHECK_MESSAGE(fs::exists(checkout / to), from.string(), ": ", link);
        if (hash < link.size() && fs::exists(checkout / to))
          CHECK_MESSAGE(anchors_of(page(to)).contains(link.substr(hash + 1)), from.string(), ": ", link);
        ++count;
      }
    CHECK(count > 20);
  }

  TEST_CASE("the README is short") {
    const std::string text = page("README.md");
    CHECK(std::ranges::count(text, '\n') <= 180);
  }

  TEST_CASE("the README lists the modules and the example programs that there are") {
    const std::string text = page("README.md");
    std::set<std::string> modules;
    for (const auto& entry : fs::directory_iterator(checkout / "include/chainslam"))
      if (entry.is_directory() && entry.path().filename() != "compiled")
        modules.insert(entry.path().filename().string());
    CHECK(first_cells(text, "Modules") == modules);
    for (const auto& entry : fs::directory_iterator(checkout / "examples"))
      if (entry.path().extension() == ".cpp")
        CHECK_MESSAGE(text.find("(examples/" + entry.path().filename().string() + ')') != std::string::npos,
                      entry.path().string());
  }

  TEST_CASE("the small programs are small") {
    for (const auto& entry : fs::directory_iterator(checkout / "examples"))
      if (entry.path().extension() == ".cpp")
        CHECK_MESSAGE(std::ranges::count(page(entry.path()), '\n') <= 60, entry.path().string());
  }

  TEST_CASE("README and badge state the version that the library has") {
    const std::string version = std::to_string(CHAINSLAM_VERSION_MAJOR) + '.' +
                                std::to_string(CHAINSLAM_VERSION_MINOR) + '.' + std::to_string(CHAINSLAM_VERSION_PATCH);
    CHECK(page("README.md").find("chainslam: version " + version) != std::string::npos);
    CHECK(page("examples/badges/version.svg").find(">" + version + "<") != std::string::npos);
  }

  TEST_CASE("the checker of links knows headings and ids") {
    CHECK(anchors_of("# A `b` c-d\n| <a id=\"row-x\"></a>y |\n") == std::set<std::string>{"a-b-c-d", "row-x"});
    CHECK(links_of("[a](b.md#c) ![d](e.png) [f](https://g)") == std::vector<std::string>{"b.md#c", "e.png"});
    CHECK(links_of("```cpp\n[](int i) {}\n```\n[a](b.md)") == std::vector<std::string>{"b.md"});
  }
}
