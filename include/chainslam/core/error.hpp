#pragma once

#include <stdexcept>
#include <string>
#include <utility>

#include "chainslam/core/printable.hpp"

namespace chainslam {

/// A file or device that could not be read or written as asked.
///
/// `what()` is three lines: path and place; what was found; what to do. What is not fit to be printed is escaped there.
class IoError : public std::runtime_error {
 public:
  /// Whether something was read or written.
  enum class Kind { input, output };

  /// What the message is made of.
  struct Report {
    std::string path;    ///< file or directory as the caller named it
    std::string place;   ///< "line 12, field qx" or "byte 4096"; empty if the whole file is meant
    std::string found;   ///< what was found there
    std::string remedy;  ///< what the user can do
  };

  /// Made by `throw_input_error` and `throw_output_error`.
  IoError(Kind kind, Report report) : std::runtime_error(format(report)), kind_(kind), report_(std::move(report)) {}

  [[nodiscard]] Kind kind() const { return kind_; }               ///< whether something was read or written
  [[nodiscard]] const Report& report() const { return report_; }  ///< file, place, finding and remedy, one by one

 private:
  static std::string format(const Report& report) {
    return printable(report.path) + (report.place.empty() ? "" : ", " + printable(report.place)) +
           "\n  found: " + printable(report.found) + "\n  do: " + printable(report.remedy, true);
  }

  Kind kind_;
  Report report_;
};

/// Throws an `IoError` about something read.
[[noreturn]] inline void throw_input_error(std::string path, std::string place, std::string found, std::string remedy) {
  throw IoError(IoError::Kind::input, {std::move(path), std::move(place), std::move(found), std::move(remedy)});
}

/// Throws an `IoError` about something written.
[[noreturn]] inline void throw_output_error(std::string path, std::string place, std::string found,
                                            std::string remedy) {
  throw IoError(IoError::Kind::output, {std::move(path), std::move(place), std::move(found), std::move(remedy)});
}

}  // namespace chainslam
