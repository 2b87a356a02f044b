#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

namespace chainslam::datasets {

/// The members of a JSON object that are texts, numbers or arrays of numbers; others are left out.
struct JsonRow {
  std::map<std::string, std::string> texts;
  std::map<std::string, std::vector<double>> numbers;

  /// A member's text; empty if there is none.
  [[nodiscard]] const std::string& text(const std::string& name) const;
  /// A member's numbers if it has `count` of them and all are finite, else nullptr.
  [[nodiscard]] const std::vector<double>* find(const std::string& name, std::size_t count) const;
};

/// Reads a file that holds an array of objects, or one object, one row in memory at a time.
/// @throws IoError naming the byte of what is no JSON.
void read_json_table(const std::filesystem::path& path, const std::function<void(const JsonRow&)>& row);

}  // namespace chainslam::datasets
