#pragma once

#include <algorithm>
#include <cctype>
#include <cstddef>
#include <string>
#include <string_view>
#include <vector>

namespace chainslam::test {

/// A word or phrase that users' texts do not use. Case does not matter; a `*` at the end stands for any letters.
struct AvoidedWord {
  std::string_view word;
  std::string_view instead;
};

/// The field has its own words for these: users search for them, and understand them at once.
inline constexpr AvoidedWord avoided_words[] = {
    {"room", "module; of memory: capacity"},
    {"rooms", "modules"},
    {"inertial unit*", "IMU"},
    {"readings", "measurements"},
    {"straighten*", "undistort, deskew"},
    {"thins", "downsamples"},
    {"thinned", "downsampled"},
    {"thinning", "downsampling"},
    {"same bits", "bit-identical"},
    {"suspect", "candidate"},
    {"suspects", "candidates"},
    {"closures lie", "closures are outliers"},
    {"give up", "marginalize, discard, stop"},
    {"gives up", "marginalizes, discards, stops"},
    {"giving up", "marginalizing, discarding, stopping"},
    {"given up", "marginalized, discarded, stopped"},
    {"gave up", "marginalized, discarded, stopped"},
    {"takes a measurement", "measurement update"},
    {"moves on by", "propagates by"},
    {"spare", "skip"},
    {"spares", "skips"},
    {"spared", "skipped"},
    {"tell", "show, determine, state"},
    {"tells", "shows, determines, states"},
    {"telling", "showing, determining, stating"},
    {"told", "shown, determined, stated"},
    {"mounting*", "extrinsic calibration (T_body_lidar)"},
    {"anew", "again, re-"},
    {"a text", "a string"},
    {"bench", "benchmark"},
    {"benches", "benchmarks"},
    {"optimis*", "optimiz-: one spelling"},
    {"linearis*", "lineariz-: one spelling"},
    {"relinearis*", "relineariz-: one spelling"},
    {"factoris*", "factoriz-: one spelling"},
    {"refactoris*", "refactoriz-: one spelling"},
    {"marginalis*", "marginaliz-: one spelling"},
    {"initialis*", "initializ-: one spelling"},
    {"normalis*", "normaliz-: one spelling"},
    {"minimis*", "minimiz-: one spelling"},
    {"turn about", "rotation about; of benchmarks: interleaved"},
    {"whole of", "the intact part of"},
    {"looks odd", "warning"},
    {"oddity", "warning"},
    {"oddities", "warnings"},
    {"lie on each other", "are aligned"},
    {"lies on each other", "is aligned"},
    {"laid on each other", "aligned"},
    {"beside another program", "on a loaded machine"},
    {"beside other programs", "on a loaded machine"},
    {"believe*", "use, accept, estimate"},
    {"believing", "using, accepting"},
    {"doubt", "outlier, larger covariance"},
    {"doubts", "outliers, larger covariance"},
    {"doubted", "rejected, downweighted"},
    {"creep", "tilt slowly, drift"},
    {"creeps", "tilts slowly, drifts"},
    {"spring", "penalty"},
    {"springs", "penalties"},
    {"deaf", "no-op"},
    {"hears", "is called with"},
    {"held by the map", "registered to the map"},
    {"verb", "subcommand"},
    {"verbs", "subcommands"},
    {"spoil*", "disturb, invalidate"},
    {"carrier", "vehicle"},
    {"wanders off", "drifts"},
    {"so far a way", "distance travelled"},
    {"so large a turn", "rotation"},
};

/// Where a word or phrase stands in a text by itself, not as part of a path, from `from` on; `npos` if nowhere.
[[nodiscard]] inline std::size_t find_word(std::string_view text, std::string_view word, std::size_t from = 0) {
  const auto is_letter = [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_' || c == '/';
  };
  const auto lower = [](char c) { return static_cast<char>(std::tolower(static_cast<unsigned char>(c))); };
  const bool open = word.ends_with('*');
  if (open) word.remove_suffix(1);
  for (std::size_t at = from; at + word.size() <= text.size(); ++at) {
    if (at > 0 && is_letter(text[at - 1])) continue;
    std::size_t i = 0;
    while (i < word.size() && lower(text[at + i]) == word[i]) ++i;
    if (i < word.size()) continue;
    const std::size_t end = at + word.size();
    if (open || end == text.size() || !is_letter(text[end])) return at;
  }
  return std::string_view::npos;
}

/// The text without what stands between two marks, marks included; line feeds stay, so that lines keep their numbers.
[[nodiscard]] inline std::string without(const std::string& text, std::string_view begin, std::string_view end) {
  std::string result;
  std::size_t at = 0;
  for (;;) {
    const std::size_t first = text.find(begin, at);
    const std::size_t last = first == std::string::npos ? first : text.find(end, first + begin.size());
    if (last == std::string::npos) return result += text.substr(at);
    result += text.substr(at, first - at);
    for (std::size_t i = first; i < last + end.size(); ++i)
      if (text[i] == '\n') result += '\n';
    at = last + end.size();
  }
}

/// What is prose in a page of Markdown: neither code nor addresses of links.
[[nodiscard]] inline std::string prose_of_markdown(const std::string& text) {
  return without(without(without(text, "```", "```"), "`", "`"), "](", ")");
}

/// The docstrings of a header, line by line; other lines are empty.
[[nodiscard]] inline std::string docstrings_of(const std::string& source) {
  std::string result;
  for (std::size_t at = 0; at < source.size();) {
    const std::size_t end = std::min(source.find('\n', at), source.size());
    const std::string line = source.substr(at, end - at);
    const std::size_t docstring = line.find("///");
    if (docstring != std::string::npos) result += line.substr(docstring + 3);
    result += '\n';
    at = end + 1;
  }
  return without(result, "`", "`");
}

/// What a source prints or writes: its string literals of more than one word; other lines, and names in quotes within
/// them, are left out.
[[nodiscard]] inline std::string messages_of(const std::string& source) {
  std::string result;
  for (std::size_t at = 0; at < source.size();) {
    const std::size_t end = std::min(source.find('\n', at), source.size());
    const std::string line = source.substr(at, end - at);
    at = end + 1;
    const std::size_t first = line.find_first_not_of(' ');
    const bool code = first != std::string::npos && line[first] != '#' && line.compare(first, 2, "//") != 0;
    for (std::size_t i = code ? line.find('"') : std::string::npos; i != std::string::npos; i = line.find('"', i)) {
      std::string literal;
      for (++i; i < line.size() && line[i] != '"'; ++i) {
        if (line[i] == '\\' && i + 1 < line.size()) literal += line[i++];
        literal += line[i];
      }
      if (i < line.size()) ++i;
      literal = without(without(literal, "\\\"", "\\\""), "`", "`");
      if (literal.find(' ') != std::string::npos) result += literal + "  ";
    }
    result += '\n';
  }
  return result;
}

/// The avoided words in a text, as "PATH:LINE: 'word': write ...".
[[nodiscard]] inline std::vector<std::string> avoided_in(const std::string& path, const std::string& text) {
  std::vector<std::string> found;
  for (const AvoidedWord& avoided : avoided_words)
    for (std::size_t at = find_word(text, avoided.word); at != std::string_view::npos;
         at = find_word(text, avoided.word, at + 1)) {
      const auto line = std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(at), '\n') + 1;
      found.push_back(path + ':' + std::to_string(line) + ": '" + std::string(avoided.word) + "': write " +
                      std::string(avoided.instead));
    }
  return found;
}

}  // namespace chainslam::test
