#include "summary_file.hpp"

#include <nlohmann/json.hpp>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/input_stream.hpp"

namespace chainslam::mapper {

namespace {

using Figures = std::vector<std::pair<std::string, std::string>>;

void add_figures(const nlohmann::ordered_json& json, const std::string& table, Figures& figures) {
  for (const auto& [key, value] : json.items()) {
    const std::string name = table.empty() ? key : table + '.' + key;
    if (value.is_object())
      add_figures(value, name, figures);
    else
      figures.emplace_back(name, value.is_string() ? value.get<std::string>() : value.dump());
  }
}

}  // namespace

Figures read_summary(const std::filesystem::path& path) {
  constexpr int deepest = 16;  // more levels than summaries have; what takes them one by one has a stack that ends
  auto file = detail::input_stream(path);
  const auto shallow = [&](int depth, auto /*event*/, auto& /*parsed*/) {
    if (depth > deepest)
      throw_input_error(path.string(), "", "more than " + std::to_string(deepest) + " levels",
                        "the file was changed: make the map again");
    return true;
  };
  const auto summary = nlohmann::ordered_json::parse(file, shallow, false);
  if (summary.is_discarded())
    throw_input_error(path.string(), "", "no JSON text", "the file was cut short or changed: make the map again");
  Figures figures;
  add_figures(summary, "", figures);
  return figures;
}

}  // namespace chainslam::mapper
