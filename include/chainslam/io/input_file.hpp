#pragma once

#include <sys/stat.h>
#include <unistd.h>
#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/detail/open_to_read.hpp"
#include "chainslam/io/detail/text.hpp"

namespace chainslam {

/// A file read from its start to its end through a small buffer, which always knows where it stands.
///
/// Lines end with LF or CRLF; a UTF-8 byte order mark at the start is skipped by `read_line`.
class InputFile {
 public:
  /// @throws IoError if the file cannot be opened or is a folder.
  explicit InputFile(std::filesystem::path path) : path_(std::move(path)), buffer_(buffer_size) {
    file_ = detail::open_to_read(path_);
    if (file_ < 0) fail_to_open(errno);
    struct stat information {};
    if (::fstat(file_, &information) == 0) {
      if (S_ISDIR(information.st_mode)) {
        close();
        throw_input_error(path_.string(), "", "a folder", "name the file itself");
      }
      if (S_ISREG(information.st_mode)) size_ = static_cast<std::uint64_t>(information.st_size);
    }
  }
  /// Takes over the other's file.
  InputFile(InputFile&& other) noexcept
      : path_(std::move(other.path_)),
        buffer_(std::move(other.buffer_)),
        file_(std::exchange(other.file_, -1)),
        size_(other.size_),
        begin_(other.begin_),
        end_(other.end_),
        offset_(other.offset_),
        line_(other.line_),
        line_ended_(other.line_ended_),
        text_(std::move(other.text_)) {}
  InputFile& operator=(InputFile&&) = delete;
  ~InputFile() { close(); }

  [[nodiscard]] const std::filesystem::path& path() const { return path_; }  ///< its name
  [[nodiscard]] std::uint64_t offset() const { return offset_; }             ///< bytes read
  [[nodiscard]] std::int64_t line() const { return line_; }                  ///< number of the line read last, from 1
  /// Whether the line read last had its line end. A file's last line without one may have been cut short.
  [[nodiscard]] bool line_ended() const { return line_ended_; }
  /// Bytes in the whole file; nothing for pipes.
  [[nodiscard]] std::optional<std::uint64_t> size() const { return size_; }

  /// Reads up to `bytes.size()` bytes; fewer only at the end of the file.
  [[nodiscard]] std::size_t read_some(std::span<std::byte> bytes) {
    std::size_t done = 0;
    while (done < bytes.size() && (begin_ < end_ || fill())) {
      const std::size_t count = std::min(bytes.size() - done, end_ - begin_);
      std::memcpy(bytes.data() + done, buffer_.data() + begin_, count);
      done += count;
      begin_ += count;
      offset_ += count;
    }
    return done;
  }

  /// Reads exactly `bytes.size()` bytes of `what`. @throws IoError if the file ends before.
  void read(std::span<std::byte> bytes, const char* what) {
    const std::uint64_t start = offset_;
    const std::size_t done = read_some(bytes);
    if (done < bytes.size())
      fail("byte " + std::to_string(start),
           "the file ends after " + std::to_string(done) + " of " + std::to_string(bytes.size()) + " bytes of " + what,
           "the file was cut short: copy or record it again");
  }

  /// Passes over `count` bytes of `what`. @throws IoError if the file ends before.
  void skip(std::uint64_t count, const char* what) {
    require(count, what);
    while (count > 0) {
      if (begin_ == end_ && !fill())
        fail(place_of_byte(), "the end of the file", "the file was cut short: copy it again");
      const std::size_t step = static_cast<std::size_t>(std::min<std::uint64_t>(count, end_ - begin_));
      begin_ += step;
      offset_ += step;
      count -= step;
    }
  }

  /// Checks a size that a header claims against what the file still holds, before memory is taken for it.
  /// @throws IoError if `bytes` of `what` cannot be there, or if the file is a pipe.
  void require(std::uint64_t bytes, const char* what) const {
    const std::uint64_t left = bytes_left();
    if (bytes > left)
      fail(place_of_byte(),
           std::to_string(left) + " bytes, where the header promises " + std::to_string(bytes) + " of " + what,
           "the file was cut short or its header is wrong: copy or record it again");
  }

  /// The same for `count` records of `what` that take `least` bytes each or more. The product may be beyond 64 bits.
  void require(std::uint64_t count, std::uint64_t least, const char* what) const {
    const std::uint64_t left = bytes_left();
    if (count > 0 && least > left / count)
      fail(place_of_byte(),
           std::to_string(left) + " bytes, where the header promises " + std::to_string(count) + " " + what + " of " +
               std::to_string(least) + " bytes or more",
           "the file was cut short or its header is wrong: copy or record it again");
  }

  /// The next line without its end, or nothing at the end of the file. Valid until the next call.
  /// @throws IoError if a line is longer than 1 MiB.
  [[nodiscard]] std::optional<std::string_view> read_line() {
    text_.clear();
    const bool first = offset_ == 0;
    bool ended = false;
    while (!ended && (begin_ < end_ || fill())) {
      const std::byte* start = buffer_.data() + begin_;
      const void* newline = std::memchr(start, '\n', end_ - begin_);
      ended = newline != nullptr;
      const std::size_t count =
          ended ? static_cast<std::size_t>(static_cast<const std::byte*>(newline) - start) : end_ - begin_;
      text_.append(reinterpret_cast<const char*>(start), count);
      begin_ += count + (ended ? 1 : 0);
      offset_ += count + (ended ? 1 : 0);
      if (text_.size() > longest_line)
        fail("line " + std::to_string(line_ + 1), "a line of more than 1 MiB",
             "this is no text file of the kind asked for");
    }
    if (!ended && text_.empty()) return std::nullopt;
    line_ended_ = ended;
    ++line_;
    if (!text_.empty() && text_.back() == '\r') text_.pop_back();
    std::string_view text = text_;
    if (first && text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
    return text;
  }

  /// Where reading stands, as "byte N".
  [[nodiscard]] std::string place_of_byte() const { return "byte " + std::to_string(offset_); }
  /// Where reading stands, as "line N".
  [[nodiscard]] std::string place_of_line() const { return "line " + std::to_string(line_); }

  /// Throws an `IoError` about this file.
  [[noreturn]] void fail(std::string place, std::string found, std::string remedy) const {
    throw_input_error(path_.string(), std::move(place), std::move(found), std::move(remedy));
  }

 private:
  static constexpr std::size_t buffer_size = std::size_t{1} << 16;
  static constexpr std::size_t longest_line = std::size_t{1} << 20;

  /// @throws IoError if the file is a pipe.
  [[nodiscard]] std::uint64_t bytes_left() const {
    if (!size_) fail("", "a pipe or a device", "copy it to a plain file first");
    return *size_ > offset_ ? *size_ - offset_ : 0;
  }

  [[noreturn]] void fail_to_open(int error) const {
    const bool missing = error == ENOENT || error == ENOTDIR;
    fail("", missing ? "no such file" : std::generic_category().message(error),
         missing ? "check the path" : "check that you may read it");
  }

  bool fill() {
    ssize_t count = 0;
    do count = ::read(file_, buffer_.data(), buffer_.size());
    while (count < 0 && errno == EINTR);
    if (count < 0)
      fail(place_of_byte(), std::generic_category().message(errno), "check the disk; the file could not be read on");
    begin_ = 0;
    end_ = static_cast<std::size_t>(count);
    return count > 0;
  }

  void close() {
    if (file_ >= 0) ::close(std::exchange(file_, -1));
  }

  std::filesystem::path path_;
  std::vector<std::byte> buffer_;
  int file_ = -1;
  std::optional<std::uint64_t> size_;
  std::size_t begin_ = 0, end_ = 0;  ///< unread part of the buffer
  std::uint64_t offset_ = 0;
  std::int64_t line_ = 0;
  bool line_ended_ = false;
  std::string text_;
};

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
