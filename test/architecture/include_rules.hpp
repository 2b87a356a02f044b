#pragma once

#include <algorithm>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

namespace chainslam::test {

/// One header, by its path below include/chainslam.
struct Header {
  std::string path;
  std::string text;
};

/// What headers must keep to.
struct IncludeRules {
  std::map<std::string, std::set<std::string>>
      arrows;                                 ///< module -> modules that it may include, and what those include
  std::map<std::string, std::string> opt_in;  ///< headers that need a package, and the target they belong to
  std::set<std::string> forbidden;            ///< system headers
  std::set<std::string> forbidden_words;      ///< such as "std::cout"
  std::string umbrella;
  std::size_t longest = 400;  ///< lines
};

inline std::vector<std::string> lines_of(const std::string& text) {
  std::istringstream stream(text);
  std::vector<std::string> lines;
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

/// The header's name if the line is an #include, between its quotes or angle brackets; else empty.
inline std::string included_name(std::string_view line, bool& quoted) {
  const auto start = line.find_first_not_of(" \t");
  if (start == std::string_view::npos || line[start] != '#') return "";
  const auto word = line.find_first_not_of(" \t", start + 1);
  if (word == std::string_view::npos || line.substr(word, 7) != "include") return "";
  const auto open = line.find_first_of("\"<", word + 7);
  if (open == std::string_view::npos) return "";
  quoted = line[open] == '"';
  const auto close = line.find(quoted ? '"' : '>', open + 1);
  return std::string(line.substr(open + 1, close == std::string_view::npos ? close : close - open - 1));
}

/// The module of a header below include/chainslam: its folder, or empty for the umbrella.
inline std::string module_of(const std::string& path) {
  const auto slash = path.find('/');
  return slash == std::string::npos ? "" : path.substr(0, slash);
}

inline bool is_private(const std::string& path) { return path.find("/detail/") != std::string::npos; }

/// Whether a private header has bodies of a class in a public one, which includes it at its end:
/// module/detail/name_update.hpp of module/name.hpp.
inline bool has_bodies_of(const std::string& path, const std::string& other) {
  const auto slash = other.rfind('/');
  if (slash == std::string::npos || !other.ends_with(".hpp")) return false;
  const std::string name = other.substr(slash + 1, other.size() - slash - 5);
  return path.starts_with(other.substr(0, slash) + "/detail/" + name + "_");
}

/// All modules that a module may include: itself, those its arrows reach, and what those reach.
inline std::set<std::string> reachable_modules(const IncludeRules& rules, const std::string& module) {
  std::set<std::string> reached = {module};
  std::vector<std::string> open = {module};
  while (!open.empty()) {
    const auto found = rules.arrows.find(open.back());
    open.pop_back();
    if (found == rules.arrows.end()) continue;
    for (const std::string& next : found->second)
      if (reached.insert(next).second) open.push_back(next);
  }
  return reached;
}

namespace detail {

struct IncludeLine {
  std::string name;  ///< below include/chainslam for our own
  bool own;
};

class IncludeChecker {
 public:
  IncludeChecker(const std::vector<Header>& headers, const IncludeRules& rules) : rules_(rules) {
    for (const Header& header : headers) names_.insert(header.path);
    for (const Header& header : headers) {
      check_text(header);
      for (const IncludeLine& line : includes_of(header)) check_include(header.path, line);
    }
    check_umbrella();
    check_cycles();
  }

  [[nodiscard]] std::vector<std::string> problems() const { return problems_; }

 private:
  void report(const std::string& path, const std::string& problem) { problems_.push_back(path + ": " + problem); }

  void check_text(const Header& header) {
    const auto lines = lines_of(header.text);
    if (lines.empty() || lines.front() != "#pragma once") report(header.path, "does not start with #pragma once");
    if (lines.size() > rules_.longest)
      report(header.path, "has " + std::to_string(lines.size()) + " lines: look for the second idea");
    for (const std::string& word : rules_.forbidden_words)
      if (header.text.find(word) != std::string::npos) report(header.path, "says " + word);
    if (is_private(header.path)) check_private(header.path, lines);
  }

  /// What a private header declares is in a namespace of its own: users see what public headers declare.
  void check_private(const std::string& path, const std::vector<std::string>& lines) {
    std::vector<std::string> open;
    for (const std::string& line : lines) {
      if (line.starts_with("namespace ") && line.ends_with("{"))
        open.push_back(line);
      else if (line.starts_with("}  // namespace") && !open.empty())
        open.pop_back();
      const auto is_detail = [](const std::string& name) { return name.find("detail") != std::string::npos; };
      if (open.empty() || std::any_of(open.begin(), open.end(), is_detail) || line.ends_with(";")) continue;
      for (const char* word : {"class ", "struct ", "enum class ", "concept "})
        if (line.starts_with(word) && line.find("::") == std::string::npos)
          report(path, "declares for users: " + line.substr(0, line.find(" {")));
    }
  }

  std::vector<IncludeLine> includes_of(const Header& header) {
    constexpr std::string_view prefix = "chainslam/";
    std::vector<IncludeLine> includes;
    for (const std::string& line : lines_of(header.text)) {
      bool quoted = false;
      const std::string name = included_name(line, quoted);
      if (name.empty()) continue;
      const bool own = name.starts_with(prefix);
      if (quoted && !own) report(header.path, "includes \"" + name + "\" without its whole name chainslam/...");
      if (own && !quoted) report(header.path, "includes <" + name + "> with angle brackets");
      includes.push_back({own ? name.substr(prefix.size()) : name, own});
      if (own && !has_bodies_of(header.path, includes.back().name)) graph_[header.path].push_back(includes.back().name);
    }
    return includes;
  }

  void check_include(const std::string& path, const IncludeLine& line) {
    if (!line.own) {
      if (rules_.forbidden.contains(line.name)) report(path, "includes <" + line.name + ">");
      return;
    }
    if (!names_.contains(line.name)) report(path, "includes " + line.name + ", which is not there");
    if (rules_.opt_in.contains(line.name) && target_of(line.name) != target_of(path))
      report(path, "includes the opt-in header " + line.name);
    if (path == rules_.umbrella) return;
    if (line.name == rules_.umbrella) report(path, "includes the umbrella " + rules_.umbrella);
    const std::string module = module_of(path), other = module_of(line.name);
    if (!rules_.arrows.contains(module)) {
      report(path, "is in no known module");
    } else if (!reachable_modules(rules_, module).contains(other)) {
      report(path, "includes " + line.name + ", but no arrow leads from " + module + " to " + other);
    } else if (module != other && is_private(line.name)) {
      report(path, "includes " + line.name + ", which is private to " + other);
    }
  }

  /// The opt-in target that a header belongs to; empty for all others.
  [[nodiscard]] std::string target_of(const std::string& path) const {
    const auto found = rules_.opt_in.find(path);
    return found == rules_.opt_in.end() ? "" : found->second;
  }

  void check_umbrella() {
    if (!names_.contains(rules_.umbrella)) {
      report(rules_.umbrella, "is not there");
      return;
    }
    const auto& included = graph_[rules_.umbrella];
    for (const std::string& name : names_) {
      if (name == rules_.umbrella || rules_.opt_in.contains(name) || is_private(name)) continue;
      if (std::find(included.begin(), included.end(), name) == included.end())
        report(rules_.umbrella, "does not include " + name);
    }
    for (const auto& [name, target] : rules_.opt_in)
      if (!names_.contains(name)) report(name, "is named opt-in, but is not there");
  }

  void check_cycles() {
    std::set<std::string> done;
    for (const std::string& name : names_) {
      std::vector<std::string> way;
      follow(name, way, done);
    }
  }

  void follow(const std::string& name, std::vector<std::string>& way, std::set<std::string>& done) {
    if (std::find(way.begin(), way.end(), name) != way.end()) {
      report(name, "includes itself by way of " + way.back());
      return;
    }
    if (done.contains(name)) return;
    way.push_back(name);
    for (const std::string& next : graph_[name]) follow(next, way, done);
    way.pop_back();
    done.insert(name);
  }

  const IncludeRules& rules_;
  std::set<std::string> names_;
  std::map<std::string, std::vector<std::string>> graph_;
  std::vector<std::string> problems_;
};

}  // namespace detail

/// What is wrong with the headers, one sentence each; nothing if they keep to the rules.
inline std::vector<std::string> include_problems(const std::vector<Header>& headers, const IncludeRules& rules) {
  return detail::IncludeChecker(headers, rules).problems();
}

/// The opt-in headers that CMakeLists.txt names, as `component:module/header.hpp` inside set(chainslam_opt_in ...),
/// each with its component.
inline std::map<std::string, std::string> opt_in_headers(const std::string& cmake) {
  std::map<std::string, std::string> headers;
  const auto begin = cmake.find("set(chainslam_opt_in");
  if (begin == std::string::npos) return headers;
  std::istringstream words(cmake.substr(begin, cmake.find(')', begin) - begin));
  for (std::string word; words >> word;)
    if (const auto colon = word.find(':'); colon != std::string::npos)
      headers.emplace(word.substr(colon + 1), word.substr(0, colon));
  return headers;
}

}  // namespace chainslam::test
