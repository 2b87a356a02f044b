#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

#include "chainslam/core/finite.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/io/detail/text.hpp"
#include "chainslam/io/input_file.hpp"

namespace chainslam {

/// The fields of one line, read from left to right. Errors name the line and the field.
class LineFields {
 public:
  /// @param separator  ',' for CSV (blanks around fields are dropped), or ' ' for any run of blanks.
  LineFields(const InputFile& file, std::string_view line, char separator = ' ')
      : file_(&file),
        rest_(separator == ' ' ? detail::trimmed(line) : line),
        separator_(separator),
        left_(!rest_.empty()) {}

  [[nodiscard]] bool more() const { return left_; }  ///< whether the line has another field

  /// The next field's text. @throws IoError if the line has no more.
  std::string_view text(const char* name) {
    if (!left_) fail(name, "the end of the line", "check that the line holds all its fields");
    const std::size_t end = separator_ == ' ' ? rest_.find_first_of(detail::blanks) : rest_.find(separator_);
    const std::string_view field = detail::trimmed(rest_.substr(0, end));
    left_ = end != std::string_view::npos;
    if (left_) rest_ = separator_ == ' ' ? detail::trimmed(rest_.substr(end)) : rest_.substr(end + 1);
    return field;
  }

  /// Any number, NaN and infinity among them.
  double number_or_nan(const char* name) {
    const std::string_view field = text(name);
    const auto value = detail::parse_double(field);
    if (!value) fail_number(name, field, "a number");
    return *value;
  }

  /// A finite number. @throws IoError if the field is none.
  double number(const char* name) {
    const std::string_view field = text(name);
    const auto value = detail::parse_double(field);
    if (!value || !is_finite(*value)) fail_number(name, field, "a finite number");
    return *value;
  }

  /// A whole number. @throws IoError if the field is none.
  std::int64_t integer(const char* name) {
    const std::string_view field = text(name);
    const auto value = detail::parse_integer(field);
    if (!value) fail_number(name, field, "a whole number");
    return *value;
  }

  /// A time in decimal seconds, without loss. @throws IoError if the field is none.
  Timestamp time_in_seconds(const char* name) {
    const std::string_view field = text(name);
    const auto value = detail::parse_seconds(field);
    if (value) return Timestamp::from_nanoseconds(*value);
    fail(name, detail::shown(field), detail::time_remedy(field));
  }

  /// @throws IoError if fields are left.
  void end(const char* layout) {
    if (!left_) return;
    std::string remedy = std::string("each line holds ") + layout;
    if (separator_ == ',') remedy += ", and decimals are written with a point";
    fail("after the last", detail::shown(detail::trimmed(rest_)), std::move(remedy));
  }

  /// Throws an `IoError` about a field of this line.
  [[noreturn]] void fail(const char* name, std::string found, std::string remedy) const {
    file_->fail(file_->place_of_line() + ", field " + name, std::move(found), std::move(remedy));
  }

 private:
  [[noreturn]] void fail_number(const char* name, std::string_view field, const char* wanted) const {
    fail(name, detail::shown(field), detail::number_remedy(field, wanted));
  }

  const InputFile* file_;
  std::string_view rest_;
  char separator_;
  bool left_;
};

}  // namespace chainslam
