#include "datasets/files.hpp"

#include <algorithm>
#include <cctype>
#include <chrono>
#include <string>
#include <system_error>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/text.hpp"
#include "chainslam/io/input_file.hpp"

namespace chainslam::datasets {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }

bool all_digits(std::string_view text) { return !text.empty() && std::ranges::all_of(text, is_digit); }

/// Orders texts so that runs of digits compare as numbers.
bool natural_less(std::string_view a, std::string_view b) {
  std::size_t i = 0, k = 0;
  while (i < a.size() && k < b.size()) {
    if (!is_digit(a[i]) || !is_digit(b[k])) {
      if (a[i] != b[k]) return a[i] < b[k];
      ++i, ++k;
      continue;
    }
    const auto run = [](std::string_view text, std::size_t& at) {
      while (at < text.size() && text[at] == '0') ++at;
      const std::size_t start = at;
      while (at < text.size() && is_digit(text[at])) ++at;
      return text.substr(start, at - start);
    };
    const std::string_view m = run(a, i), n = run(b, k);
    if (m.size() != n.size()) return m.size() < n.size();
    if (m != n) return m < n;
  }
  return std::pair(a.size() - i, a) < std::pair(b.size() - k, b);
}

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

}  // namespace

std::vector<std::filesystem::path> files_in(const std::filesystem::path& folder,
                                            const std::vector<std::string_view>& extensions) {
  std::vector<std::filesystem::path> files;
  std::error_code missing;
  for (const auto& entry : std::filesystem::directory_iterator(folder, missing)) {
    const std::string extension = lower(entry.path().extension().string());
    std::error_code ignored;
    if (std::ranges::find(extensions, extension) != extensions.end() && entry.is_regular_file(ignored))
      files.push_back(entry.path());
  }
  std::ranges::sort(
      files, [](const auto& a, const auto& b) { return natural_less(a.filename().string(), b.filename().string()); });
  return files;
}

std::optional<Timestamp> parse_date_time(std::string_view text) {
  if (text.size() < 19 || text[4] != '-' || text[7] != '-' || (text[10] != ' ' && text[10] != 'T') || text[13] != ':' ||
      text[16] != ':')
    return std::nullopt;
  const auto number = [&](std::size_t start, std::size_t count) {
    const std::string_view part = text.substr(start, count);
    return all_digits(part) ? static_cast<int>(detail::parse_integer(part).value_or(-1)) : -1;
  };
  const std::chrono::year_month_day day{std::chrono::year(number(0, 4)),
                                        std::chrono::month(static_cast<unsigned>(number(5, 2))),
                                        std::chrono::day(static_cast<unsigned>(number(8, 2)))};
  const int hour = number(11, 2), minute = number(14, 2);
  const auto second = detail::parse_seconds(text.substr(17));
  if (!day.ok() || number(0, 4) < 1900 || number(0, 4) > 2114 || hour < 0 || hour > 23 || minute < 0 || minute > 59 ||
      !second || *second < 0 || *second >= 61'000'000'000)
    return std::nullopt;
  return Timestamp(std::chrono::sys_days(day).time_since_epoch() + std::chrono::hours(hour) +
                   std::chrono::minutes(minute) + Duration(*second));
}

std::vector<Timestamp> read_stamps(const std::filesystem::path& path, bool in_order) {
  InputFile file(path);
  std::vector<Timestamp> stamps;
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty() || text.starts_with('#')) continue;
    std::optional<Timestamp> stamp = parse_date_time(text);
    if (!stamp)
      if (const auto value = detail::parse_seconds(text)) stamp = Timestamp::from_nanoseconds(*value);
    if (!stamp)
      file.fail(file.place_of_line(), detail::shown(text),
                "write one time a line: seconds, or YYYY-MM-DD hh:mm:ss.nnn");
    if (in_order && !stamps.empty() && *stamp < stamps.back())
      file.fail(file.place_of_line(), "a time that is earlier than the one before it",
                "scans come in the order of time");
    stamps.push_back(*stamp);
  }
  return stamps;
}

std::optional<Timestamp> time_of_whole(std::int64_t value) {
  constexpr std::int64_t least_microseconds = 100'000'000'000'000, least_nanoseconds = 1000 * least_microseconds;
  if (value >= least_nanoseconds && value <= latest_nanoseconds) return Timestamp::from_nanoseconds(value);
  if (value >= least_microseconds && value <= latest_nanoseconds / 1000) return Timestamp::from_microseconds(value);
  return std::nullopt;
}

std::optional<Timestamp> time_of_name(const std::string& stem) {
  if (all_digits(stem)) {
    const auto value = detail::parse_integer(stem);
    return value ? time_of_whole(*value) : std::nullopt;
  }
  if (const std::size_t point = stem.find('.'); point != stem.npos && point >= 9) {
    const auto value = detail::parse_seconds(stem);
    return value ? std::optional(Timestamp::from_nanoseconds(*value)) : std::nullopt;
  }
  const std::size_t last = stem.rfind('_');
  if (last == stem.npos || last == 0) return std::nullopt;
  const std::size_t first = stem.rfind('_', last - 1);
  const std::size_t start = first == stem.npos ? 0 : first + 1;
  const std::string_view whole = std::string_view(stem).substr(start, last - start);
  const std::string_view nanoseconds = std::string_view(stem).substr(last + 1);
  if (!all_digits(whole) || !all_digits(nanoseconds) || whole.size() < 9 || whole.size() > 10 || nanoseconds.size() > 9)
    return std::nullopt;
  const Timestamp time =
      Timestamp::from_nanoseconds(*detail::parse_integer(whole) * 1'000'000'000 + *detail::parse_integer(nanoseconds));
  return is_recorded_time(time) ? std::optional(time) : std::nullopt;
}

std::string contents_of(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  std::error_code missing;
  for (const auto& entry : std::filesystem::directory_iterator(folder, missing)) {
    std::error_code ignored;
    names.push_back(entry.path().filename().string() + (entry.is_directory(ignored) ? "/" : ""));
  }
  if (names.empty()) return "nothing";
  std::ranges::sort(names, natural_less);
  std::string text;
  constexpr std::size_t most = 12;
  for (std::size_t i = 0; i < std::min(names.size(), most); ++i) text += (i > 0 ? ", " : "") + names[i];
  return names.size() > most ? text + ", ... (" + std::to_string(names.size() - most) + " more)" : text;
}

std::string folder_name(const std::filesystem::path& path) {
  std::filesystem::path absolute = std::filesystem::absolute(path).lexically_normal();
  return absolute.has_filename() ? absolute.filename().string() : absolute.parent_path().filename().string();
}

}  // namespace chainslam::datasets
