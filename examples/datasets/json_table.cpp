#include "datasets/json_table.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/detail/input_stream.hpp"

namespace chainslam::datasets {
namespace {

/// Turns the parser's events into rows: a row is an object that lies in no other object.
class RowMaker final : public nlohmann::json_sax<nlohmann::json> {
 public:
  RowMaker(const std::filesystem::path& path, const std::function<void(const JsonRow&)>& row)
      : path_(path), row_(row) {}

  bool null() override { return true; }
  bool boolean(bool) override { return true; }
  bool number_integer(number_integer_t value) override { return add(static_cast<double>(value)); }
  bool number_unsigned(number_unsigned_t value) override { return add(static_cast<double>(value)); }
  bool number_float(number_float_t value, const string_t&) override { return add(value); }
  bool string(string_t& value) override {
    if (objects_ == 1) made_.texts[key_] = std::move(value);
    return true;
  }
  bool binary(binary_t&) override { return true; }
  bool start_object(std::size_t) override {
    if (++objects_ == 1) made_ = {};
    return true;
  }
  bool key(string_t& name) override {
    if (objects_ == 1) key_ = std::move(name);
    return true;
  }
  bool end_object() override {
    if (--objects_ == 0) row_(made_);
    return true;
  }
  bool start_array(std::size_t) override { return true; }
  bool end_array() override { return true; }
  bool parse_error(std::size_t byte, const std::string& token, const nlohmann::detail::exception&) override {
    throw_input_error(path_.string(), "byte " + std::to_string(byte),
                      "no JSON" + (token.empty() ? "" : ", at \"" + token.substr(0, 40) + "\""),
                      "the file was cut short or damaged: copy it again");
  }

 private:
  bool add(double value) {
    if (objects_ == 1) made_.numbers[key_].push_back(value);
    return true;
  }

  const std::filesystem::path& path_;
  const std::function<void(const JsonRow&)>& row_;
  JsonRow made_;
  std::string key_;
  std::size_t objects_ = 0;  ///< that are open
};

}  // namespace

const std::string& JsonRow::text(const std::string& name) const {
  static const std::string none;
  const auto found = texts.find(name);
  return found == texts.end() ? none : found->second;
}

const std::vector<double>* JsonRow::find(const std::string& name, std::size_t count) const {
  const auto found = numbers.find(name);
  const bool good = found != numbers.end() && found->second.size() == count &&
                    std::ranges::all_of(found->second, [](double value) { return is_finite(value); });
  return good ? &found->second : nullptr;
}

void read_json_table(const std::filesystem::path& path, const std::function<void(const JsonRow&)>& row) {
  auto file = detail::input_stream(path);
  if (!file || std::filesystem::is_directory(path))
    throw_input_error(path.string(), "", "no file that can be read", "check the path and that you may read it");
  RowMaker maker(path, row);
  nlohmann::json::sax_parse(file, &maker);
}

}  // namespace chainslam::datasets
