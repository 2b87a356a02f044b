#pragma once

#include <string>
#include <vector>

namespace chainslam::test {

/// The text of each call of `name(` in a source, up to its closing bracket.
inline std::vector<std::string> calls_of(const std::string& source, const std::string& name) {
  std::vector<std::string> calls;
  for (std::size_t at = source.find(name); at != source.npos; at = source.find(name, at + 1)) {
    std::size_t end = at + name.size();
    bool quoted = false;
    for (int depth = 1; depth > 0 && end < source.size(); ++end) {
      if (source[end] == '"' && source[end - 1] != '\\') quoted = !quoted;
      if (!quoted) depth += source[end] == '(' ? 1 : source[end] == ')' ? -1 : 0;
    }
    calls.push_back(source.substr(at, end - at));
  }
  return calls;
}

/// A call's string literals, line by line as they are written.
inline std::vector<std::string> literals_of(const std::string& call) {
  std::vector<std::string> literals;
  for (std::size_t at = call.find('"'); at != call.npos;) {
    const std::size_t end = call.find('"', at + 1);
    literals.push_back(call.substr(at + 1, end - at - 1));
    at = call.find('"', end + 1);
  }
  return literals;
}

/// Those of a source's calls of `name(` that say something, but nothing that `said` says: no test is known to reach
/// them.
inline std::vector<std::string> unsaid_calls(const std::string& source, const std::string& name,
                                             const std::string& said) {
  constexpr std::size_t least = 6;  // characters that tell one message from another
  std::vector<std::string> unsaid;
  for (const std::string& call : calls_of(source, name)) {
    bool speaks = false, found = false;
    for (const std::string& text : literals_of(call)) {
      speaks = speaks || text.size() >= least;
      found = found || (text.size() >= least && said.find(text) != said.npos);
    }
    if (speaks && !found) unsaid.push_back(call);
  }
  return unsaid;
}

}  // namespace chainslam::test
