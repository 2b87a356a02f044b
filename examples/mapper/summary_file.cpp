#include "summary_file.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/input_stream.hpp"

namespace chainslam::mapper {

namespace {

using Figures = std::vector<std::pair<std::string, std::string>>;
using Json = nlohmann::ordered_json;

Json parsed(const std::filesystem::path& path) {
  constexpr int deepest = 16;  // more levels than summaries have; what takes them one by one has a stack that ends
  auto file = detail::input_stream(path);
  const auto shallow = [&](int depth, auto /*event*/, auto& /*parsed*/) {
    if (depth > deepest)
      throw_input_error(path.string(), "", "more than " + std::to_string(deepest) + " levels",
                        "the file was changed: make the map again");
    return true;
  };
  Json summary = Json::parse(file, shallow, false);
  if (summary.is_discarded())
    throw_input_error(path.string(), "", "no JSON text", "the file was cut short or changed: make the map again");
  return summary;
}

/// A number as people read it: six digits, whole numbers without a point.
std::string number_text(double value) {
  char text[64];
  std::snprintf(text, sizeof text, std::abs(value) < 1e15 && value == std::floor(value) ? "%.0f" : "%.6g", value);
  return text;
}

/// A value that is neither an object nor an array of objects.
std::string value_text(const Json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (value.is_number_float()) return number_text(value.get<double>());
  if (!value.is_array()) return value.dump();
  std::string text;
  for (const Json& element : value) {
    if (element.is_structured()) return std::to_string(value.size()) + (value.size() == 1 ? " entry" : " entries");
    text += (text.empty() ? "" : ", ") + value_text(element);
  }
  return text.empty() ? "none" : text;
}

bool is_list_of_objects(const Json& value) {
  return value.is_array() && !value.empty() &&
         std::ranges::all_of(value, [](const Json& element) { return element.is_object(); });
}

/// The figures of an object, without tables of what it lists.
void add_figures(const Json& object, const std::string& table, Figures& figures) {
  for (const auto& [key, value] : object.items()) {
    const std::string name = table.empty() ? key : table + '.' + key;
    if (value.is_object())
      add_figures(value, name, figures);
    else
      figures.emplace_back(name, value_text(value));
  }
}

constexpr std::size_t most_columns = 40, most_lines = 200, widest_cell = 48;

/// A text that fits a cell of a table.
std::string cell_text(std::string text) {
  if (text.empty()) return "-";
  if (text.size() > widest_cell) text = text.substr(0, widest_cell - 3) + "...";
  return text;
}

/// The lines of a table put together from its columns, each as wide as its widest cell.
std::vector<std::string> joined(std::vector<std::vector<std::string>> columns, std::size_t lines) {
  std::vector<std::string> texts(lines);
  for (std::size_t c = 0; c < columns.size(); ++c) {
    columns[c].resize(lines);
    std::size_t width = 0;
    for (std::string& cell : columns[c]) {
      cell = cell_text(std::move(cell));
      width = std::max(width, cell.size());
    }
    for (std::size_t i = 0; i < lines; ++i) {
      texts[i] += columns[c][i];
      if (c + 1 < columns.size()) texts[i] += std::string(width - columns[c][i].size() + 2, ' ');
    }
  }
  return texts;
}

/// A list of objects as a table: a line for each of their figures, a column for each object. What is too large for one
/// is counted.
void add_table(const Json& list, const std::string& name, Figures& figures) {
  std::vector<std::string> lines;
  std::map<std::string, std::size_t> places;
  std::vector<std::vector<std::string>> columns;
  for (const Json& element : list) {
    Figures of_element;
    add_figures(element, "", of_element);
    std::vector<std::string>& column = columns.emplace_back();
    for (auto& [line, text] : of_element) {
      const auto [place, is_new] = places.try_emplace(line, lines.size());
      if (is_new) lines.push_back(line);
      column.resize(std::max(column.size(), place->second + 1));
      column[place->second] = std::move(text);
    }
    if (columns.size() > most_columns || lines.size() > most_lines) {
      figures.emplace_back(name, std::to_string(list.size()) + " entries");
      return;
    }
  }
  std::vector<std::string> texts = joined(std::move(columns), lines.size());
  for (std::size_t i = 0; i < lines.size(); ++i) figures.emplace_back(name + '.' + lines[i], std::move(texts[i]));
}

void add_with_tables(const Json& object, const std::string& table, Figures& figures) {
  for (const auto& [key, value] : object.items()) {
    const std::string name = table.empty() ? key : table + '.' + key;
    if (value.is_object())
      add_with_tables(value, name, figures);
    else if (is_list_of_objects(value))
      add_table(value, name, figures);
    else
      figures.emplace_back(name, value_text(value));
  }
}

}  // namespace

Figures read_summary(const std::filesystem::path& path) {
  Figures figures;
  if (const Json summary = parsed(path); summary.is_object()) add_with_tables(summary, "", figures);
  return figures;
}

std::string read_summary_text(const std::filesystem::path& path) { return parsed(path).dump(2); }

}  // namespace chainslam::mapper
