#include "support/configuration.hpp"

#include <toml++/toml.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <iterator>
#include <optional>
#include <tuple>

#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/detail/input_stream.hpp"
#include "support/nearest_name.hpp"

namespace chainslam::support {
namespace {

constexpr std::uintmax_t largest_file = std::uintmax_t{1} << 20;  // bytes; real files have a few thousand

template <class... Cases>
struct Overloaded : Cases... {
  using Cases::operator()...;
};
template <class... Cases>
Overloaded(Cases...) -> Overloaded<Cases...>;

// ---- values as text ----

/// As TOML has it, with nothing in it that a terminal obeys; bytes that are no UTF-8 become U+FFFD.
std::string in_quotes(std::string_view text) {
  std::string result = "\"";
  while (!text.empty()) {
    const auto [character, bytes] = chainslam::detail::first_character(text);
    if (bytes == 0 || chainslam::detail::is_control(character)) {
      char escaped[8];
      std::snprintf(escaped, sizeof escaped, "\\u%04x", bytes == 0 ? 0xFFFDU : static_cast<unsigned>(character));
      result += escaped;
    } else {
      if (character == '"' || character == '\\') result += '\\';
      result += text.substr(0, bytes);
    }
    text.remove_prefix(std::max<std::size_t>(bytes, 1));
  }
  return result += '"';
}

std::string number_text(double value) {
  const double magnitude = std::abs(value);
  const bool plain = magnitude == 0.0 || (magnitude >= 1e-4 && magnitude < 1e15);
  char buffer[64];
  return {buffer, std::to_chars(buffer, std::end(buffer), value,
                                plain ? std::chars_format::fixed : std::chars_format::scientific)
                      .ptr};
}

/// A number to so many significant digits.
double with_digits(double value, int digits) {
  char buffer[64];
  const auto end = std::to_chars(buffer, std::end(buffer), value, std::chars_format::scientific, digits - 1).ptr;
  double result = 0.0;
  std::from_chars(buffer, end, result);
  return result;
}

/// The shortest text of a number for which `reads_back` holds.
template <class ReadsBack>
std::string shortest_text(double in_file, const ReadsBack& reads_back) {
  for (int digits = 1; digits < 17; ++digits)
    if (const double shorter = with_digits(in_file, digits); reads_back(shorter)) return number_text(shorter);
  return number_text(in_file);
}

/// The shortest text of value / factor that reads back as `value`.
template <class Number>
std::string exact_text(Number value, double factor) {
  return shortest_text(static_cast<double>(value) / factor,
                       [&](double number) { return static_cast<Number>(number * factor) == value; });
}

/// The same of a duration, which is whole nanoseconds: 30 s, not 30.000000000000004 s.
std::string exact_text(Duration value, double factor) {
  return shortest_text(to_seconds(value) / factor, [&](double number) { return seconds(number * factor) == value; });
}

constexpr int digits_of_defaults = 6;

/// TOML takes a number without point or exponent for an integer; as a default, `5.0` says that fractions are welcome.
std::string as_toml_float(std::string text) {
  return text.find_first_of(".en") == std::string::npos ? text + ".0" : text;
}

std::string join(const std::vector<std::string>& words, const std::string& separator) {
  std::string result;
  for (const std::string& word : words) result += (result.empty() ? "" : separator) + word;
  return result;
}

std::string shown(const Configuration::Value& value) {
  return std::visit(Overloaded{[](bool flag) { return std::string(flag ? "true" : "false"); },
                               [](std::int64_t number) { return std::to_string(number); },
                               [](double number) { return as_toml_float(exact_text(number, 1.0)); },
                               [](const std::string& text) { return in_quotes(text); },
                               [](const std::vector<double>& numbers) {
                                 std::vector<std::string> words;
                                 for (const double number : numbers) words.push_back(exact_text(number, 1.0));
                                 return "[" + join(words, ", ") + "]";
                               }},
                    value);
}

std::string kind_of(const Configuration::Value& value) {
  constexpr const char* kinds[] = {"true or false", "an integer", "a number", "a string", "an array of numbers"};
  return kinds[value.index()];
}

// ---- names ----

std::string_view last_part(std::string_view name) { return name.substr(name.rfind('.') + 1); }
std::string_view table_part(std::string_view name) {
  const std::size_t dot = name.rfind('.');
  return dot == std::string_view::npos ? std::string_view() : name.substr(0, dot);
}

std::string place_text(const std::string& file, const toml::source_position& position) {
  return file + ", line " + std::to_string(position.line) + ", column " + std::to_string(position.column);
}

constexpr std::size_t deepest_toml = 32;

/// Passes over a string of TOML, from its opening quotes on. @returns its characters.
std::size_t string_length(std::string_view text) {
  const std::string_view quotes = text.substr(0, text.starts_with(text.front() == '"' ? "\"\"\"" : "'''") ? 3 : 1);
  for (std::size_t i = quotes.size(); i < text.size(); ++i) {
    if (quotes.front() == '"' && text[i] == '\\')
      ++i;
    else if (text.substr(i).starts_with(quotes) || (quotes.size() == 1 && text[i] == '\n'))
      return i + quotes.size();
  }
  return text.size();
}

/// The first line of a TOML text that nests deeper than `deepest_toml`, by brackets or by the parts of a dotted key;
/// the parser, which is recursive, would overflow the stack. Nothing if there is none.
std::optional<std::size_t> too_deep_line(std::string_view text) {
  std::size_t line = 1, brackets = 0, dots = 0;
  for (std::size_t i = 0; i < text.size(); ++i) {
    switch (text[i]) {
      case '"':
      case '\'': {
        const std::size_t length = string_length(text.substr(i));
        line += static_cast<std::size_t>(std::ranges::count(text.substr(i, length), '\n'));
        i += length - 1;
        break;
      }
      case '#':
        i = std::min(text.find('\n', i), text.size()) - 1;
        break;
      case '\n':
        ++line;
        [[fallthrough]];
      case '=':
      case ',':
        dots = 0;
        break;
      case '[':
      case '{':
        ++brackets;
        dots = 0;
        break;
      case ']':
      case '}':
        if (brackets > 0) --brackets;
        break;
      case '.':
        ++dots;
        break;
      default:
        break;
    }
    if (brackets > deepest_toml || dots >= deepest_toml) return line;
  }
  return std::nullopt;
}

std::string read_file(const std::filesystem::path& path) {
  const std::string name = path.string();
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  if (error) throw ConfigError(name, "cannot be read", error.message(), "give the name of a TOML file");
  if (size > largest_file)
    throw ConfigError(name, "is too large for a configuration", std::to_string(size) + " bytes",
                      "give a TOML file of at most 1 MiB");
  auto stream = detail::input_stream(path);
  std::string text{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (!stream) throw ConfigError(name, "cannot be read", "a failure of the file", "check its access rights");
  return text;
}

/// @throws ConfigError if it is not TOML, or nested deeper than the parser bears.
toml::table parsed(std::string_view text, const std::string& name) {
  if (const auto line = too_deep_line(text))
    throw ConfigError(name + ", line " + std::to_string(*line), "nested too deeply",
                      "more than " + std::to_string(deepest_toml) + " levels",
                      "write table.key = value; `chainslam config --print` shows a whole file");
  try {
    return toml::parse(text);
  } catch (const toml::parse_error& error) {
    throw ConfigError(place_text(name, error.source().begin), "not TOML", std::string(error.description()),
                      "correct the line; `chainslam config --print` shows a whole file");
  }
}

/// A TOML value as one of ours, or nothing if it is none (a date, a mixed array).
std::optional<Configuration::Value> value_of(const toml::node& node) {
  if (const auto* flag = node.as_boolean()) return flag->get();
  if (const auto* integer = node.as_integer()) return integer->get();
  if (const auto* number = node.as_floating_point()) return number->get();
  if (const auto* text = node.as_string()) return text->get();
  const auto* array = node.as_array();
  if (array == nullptr) return std::nullopt;
  std::vector<double> numbers;
  for (const toml::node& element : *array) {
    if (!element.is_number()) return std::nullopt;
    numbers.push_back(*element.value<double>());
  }
  return numbers;
}

bool is_text_like(const Configuration::Target& target) {
  return std::holds_alternative<std::string*>(target) || std::holds_alternative<std::filesystem::path*>(target) ||
         std::holds_alternative<Configuration::Choice>(target);
}

bool is_integer(const Configuration::Target& target) {
  return std::holds_alternative<std::int32_t*>(target) || std::holds_alternative<std::int64_t*>(target) ||
         std::holds_alternative<std::uint64_t*>(target);
}

}  // namespace

/// Walks through a parsed file and notes what it assigns; the first error in the file, by position, is thrown at its
/// end.
class Configuration::TomlReader {
 public:
  TomlReader(const Configuration& configuration, std::string file)
      : configuration_(configuration), file_(std::move(file)) {}

  std::vector<Assignment> read(const toml::table& table) {
    read_table(table, "");
    if (first_error_) throw ConfigError(*first_error_);
    return std::move(assignments_);
  }

  /// Passes over what the configuration does not take; `left_out` gets it, as "key = value".
  std::vector<Assignment> read(const toml::table& table, std::vector<std::string>& left_out) {
    left_out_ = &left_out;
    return read(table);
  }

 private:
  void read_table(const toml::table& table, const std::string& prefix) {
    for (auto&& [key, node] : table) {
      const std::string name = prefix + std::string(key.str());
      const toml::source_position position = key.source().begin;
      if (errors_ > 50) return;  // a file of other things than ours: the nearest name to each would take its time
      try {
        read_node(name, node, position);
      } catch (const ConfigError& error) {
        if (left_out_ != nullptr)
          leave_out(name, node);
        else
          note(error, position);
      }
    }
  }

  void leave_out(const std::string& name, const toml::node& node) {
    const std::optional<Value> value = value_of(node);
    left_out_->push_back(name + " = " + (value ? shown(*value) : "(a value of another type)"));
  }

  void read_node(const std::string& name, const toml::node& node, const toml::source_position& position) {
    const Key* key = configuration_.find(name);
    if (key == nullptr && node.is_table() && (configuration_.is_table(name) || left_out_ != nullptr))
      return read_table(*node.as_table(), name + ".");
    if (key == nullptr && left_out_ != nullptr) return leave_out(name, node);
    if (key == nullptr && configuration_.is_table(name))
      throw ConfigError(place_text(file_, position), "'" + name + "' is a table, not a value", "a value",
                        "write [" + name + "] on a line of its own, its keys below");
    if (key == nullptr) throw configuration_.unknown_key(place_text(file_, position), name);
    const std::string place = place_text(file_, node.source().begin);
    const std::optional<Value> value = value_of(node);
    if (!value)
      throw ConfigError(place, "'" + name + "' has a value of the wrong type",
                        node.is_table()
                            ? "a table"
                            : (node.is_array() ? "an array with values that are not numbers" : "a date or a time"),
                        "write " + type_name(*key) + range_text(*key));
    check(*key, *value, place);
    assignments_.push_back({static_cast<std::size_t>(key - configuration_.keys_.data()), *value, place});
  }

  void note(const ConfigError& error, const toml::source_position& position) {
    ++errors_;
    if (first_error_ &&
        std::tie(first_position_.line, first_position_.column) <= std::tie(position.line, position.column))
      return;
    first_error_ = error;
    first_position_ = position;
  }

  const Configuration& configuration_;
  std::string file_;
  std::vector<Assignment> assignments_;
  std::optional<ConfigError> first_error_;
  toml::source_position first_position_{};
  std::size_t errors_ = 0;
  std::vector<std::string>* left_out_ = nullptr;  ///< nothing may be left out if there is none
};

// ---- registration ----

void Configuration::add(std::string name, Target target, KeyInfo info) {
  if (find(name) != nullptr) throw std::logic_error("configuration key '" + name + "' is registered twice");
  Key key{std::move(name), std::move(target), std::move(info), {}, {}};
  key.rounded = rounded_default(key);
  key.default_text = value_text(key);
  const auto in_range = [&](double value) { return value >= key.info.min && value <= key.info.max; };
  const bool default_fits = std::visit(
      Overloaded{[&](const Duration* value) { return in_range(to_seconds(*value) / key.info.factor); },
                 [&](std::span<double> values) {
                   return std::ranges::all_of(values, [&](double v) { return in_range(v / key.info.factor); });
                 },
                 [&](const Choice& choice) { return choice.get() < choice.names.size(); },
                 [](const Numbers& numbers) { return numbers.problem(numbers.get()).empty(); },
                 [&](const auto* value) {
                   if constexpr (std::is_arithmetic_v<std::remove_cvref_t<decltype(*value)>>)
                     return in_range(static_cast<double>(*value) / key.info.factor);
                   else
                     return true;
                 }},
      key.target);
  if (!default_fits) throw std::logic_error("configuration key '" + key.name + "': default out of range");
  keys_.push_back(std::move(key));
}

/// A default in another unit, such as 0.2 rad in degrees, has as many digits as a double: people see and write six.
std::optional<Configuration::RoundedDefault> Configuration::rounded_default(const Key& key) {
  const auto of = [&](auto member) -> std::optional<RoundedDefault> {
    const double in_file = static_cast<double>(member) / key.info.factor;
    const double shown = with_digits(in_file, digits_of_defaults);
    if (static_cast<decltype(member)>(shown * key.info.factor) == member) return std::nullopt;
    if (!is_finite(in_file) || shown < key.info.min || shown > key.info.max) return std::nullopt;
    return RoundedDefault{.shown = shown, .member = static_cast<double>(member)};
  };
  if (const auto* const* number = std::get_if<double*>(&key.target)) return of(**number);
  if (const auto* const* number = std::get_if<float*>(&key.target)) return of(**number);
  return std::nullopt;
}

void Configuration::add_rule(std::vector<std::string> keys, std::string demand, std::function<bool()> holds) {
  for (const std::string& key : keys)
    if (find(key) == nullptr) throw std::logic_error("configuration rule about the unknown key '" + key + "'");
  rules_.push_back({std::move(keys), std::move(demand), std::move(holds)});
}

// ---- reading ----

void Configuration::load(const std::filesystem::path& file) { load_text(read_file(file), file.string()); }

void Configuration::load_text(std::string_view text, const std::string& name) {
  append(TomlReader(*this, name).read(parsed(text, name)));
}

std::vector<std::string> Configuration::load_foreign_text(std::string_view text, const std::string& name) {
  std::vector<std::string> left_out;
  append(TomlReader(*this, name).read(parsed(text, name), left_out));
  return left_out;
}

void Configuration::append(std::vector<Assignment> read) {
  assignments_.insert(assignments_.end(), std::make_move_iterator(read.begin()), std::make_move_iterator(read.end()));
}

std::vector<std::string> Configuration::unassigned() const {
  std::vector<std::string> result;
  for (std::size_t i = 0; i < keys_.size(); ++i)
    if (std::ranges::find(assignments_, i, &Assignment::key) == assignments_.end()) result.push_back(keys_[i].name);
  return result;
}

void Configuration::set(std::string_view assignment) {
  const std::size_t equals = assignment.find('=');
  const std::string place = "--set " + std::string(assignment);
  if (equals == std::string_view::npos || equals == 0)
    throw ConfigError(place, "no assignment", in_quotes(assignment), "write --set table.key=value");
  const auto trimmed = [](std::string_view text) {
    const std::size_t first = text.find_first_not_of(" \t");
    if (first == std::string_view::npos) return std::string();
    return std::string(text.substr(first, text.find_last_not_of(" \t") - first + 1));
  };
  const std::string name = trimmed(assignment.substr(0, equals));
  const std::string text = trimmed(assignment.substr(equals + 1));
  const Key* key = find(name);
  if (key == nullptr) throw unknown_key(place, name);
  const Value value = value_in(*key, text);
  check(*key, value, place);
  assignments_.push_back({static_cast<std::size_t>(key - keys_.data()), value, place});
}

/// Text as the command line and presets write it: without the quotes that the file wants.
Configuration::Value Configuration::value_in(const Key& key, const std::string& text) {
  std::optional<Value> value;
  if (!too_deep_line(text)) try {
      const toml::table table = toml::parse("value = " + text);
      if (table.size() == 1) value = value_of(*table.get("value"));
    } catch (const toml::parse_error&) {
      value.reset();  // text without quotes is no TOML; it is what keys that hold text take
    }
  if (is_text_like(key.target) && !(value && std::holds_alternative<std::string>(*value))) value = text;
  return value.value_or(text);
}

void Configuration::apply_with_others() {
  for (std::size_t i = 0; i < keys_.size(); ++i) {
    if (!keys_[i].info.brings) continue;
    const auto last = std::find_if(assignments_.rbegin(), assignments_.rend(),
                                   [&](const Assignment& assignment) { return assignment.key == i; });
    if (last == assignments_.rend()) continue;
    assign(keys_[i], last->value);
    for (const auto& [name, text] : keys_[i].info.brings()) {
      const Key* other = find(name);
      if (other == nullptr)
        throw std::logic_error("'" + keys_[i].name + "' brings an unknown key: " + std::string(name));
      const Value value = value_in(*other, std::string(text));
      try {
        check(*other, value, keys_[i].name);
      } catch (const ConfigError& error) {
        throw std::logic_error(error.what());
      }
      assign(keys_[static_cast<std::size_t>(other - keys_.data())], value);
    }
  }
}

void Configuration::apply() {
  apply_with_others();
  for (const Assignment& assignment : assignments_) {
    Key& key = keys_[assignment.key];
    if (!key.info.brings) assign(key, assignment.value);
  }
  for (const Rule& rule : rules_) {
    if (rule.holds()) continue;
    std::vector<std::string> found;
    for (const std::string& key : rule.keys) found.push_back(key + " = " + value_text(*find(key)));
    throw ConfigError(place_of(rule.keys.front()), "'" + rule.keys.front() + "' " + rule.demand, join(found, ", "),
                      "change one of them; `chainslam config --explain " + rule.keys.front() + "` gives the default");
  }
}

void Configuration::check(const Key& key, const Value& value, const std::string& place) {
  const auto wrong_type = [&] {
    return ConfigError(place, "'" + key.name + "' has a value of the wrong type", shown(value) + ", " + kind_of(value),
                       "write " + type_name(key) + range_text(key));
  };
  const auto require_range = [&](double number) {
    if (is_finite(number) && number >= key.info.min && number <= key.info.max) return;
    throw ConfigError(place, "'" + key.name + "' is " + (is_finite(number) ? "out of range" : "not a finite number"),
                      shown(value), "write " + type_name(key) + range_text(key));
  };
  if (const Choice* choice = std::get_if<Choice>(&key.target)) {
    const std::string* text = std::get_if<std::string>(&value);
    if (text == nullptr) throw wrong_type();
    if (std::ranges::find(choice->names, *text) != choice->names.end()) return;
    const auto guess = nearest_name(*text, choice->names);
    throw ConfigError(place, "'" + key.name + "' has no such choice",
                      in_quotes(*text) + (guess ? "; did you mean " + in_quotes(*guess) + "?" : ""),
                      "write " + type_name(key));
  }
  if (const auto* numbers = std::get_if<Numbers>(&key.target)) {
    const auto* given = std::get_if<std::vector<double>>(&value);
    if (given == nullptr) throw wrong_type();
    if (const std::string problem = numbers->problem(*given); !problem.empty())
      throw ConfigError(place, "'" + key.name + "' is " + problem, shown(value), "write " + type_name(key));
  } else if (const auto* vector = std::get_if<std::span<double>>(&key.target)) {
    const auto* parts = std::get_if<std::vector<double>>(&value);
    if (parts == nullptr || parts->size() != vector->size()) throw wrong_type();
    for (const double number : *parts) require_range(number);
  } else if (is_text_like(key.target)) {
    if (!std::holds_alternative<std::string>(value)) throw wrong_type();
  } else if (std::holds_alternative<bool*>(key.target)) {
    if (!std::holds_alternative<bool>(value)) throw wrong_type();
  } else if (const auto* integer = std::get_if<std::int64_t>(&value)) {
    require_range(static_cast<double>(*integer));
    if (std::holds_alternative<std::int32_t*>(key.target) && !std::in_range<std::int32_t>(*integer))
      throw ConfigError(place, "'" + key.name + "' is out of range", shown(value), "write a number below 2^31");
    if (std::holds_alternative<std::uint64_t*>(key.target) && *integer < 0)
      throw ConfigError(place, "'" + key.name + "' is out of range", shown(value),
                        "write a number that is not negative");
  } else {
    const double* number = std::get_if<double>(&value);
    if (number == nullptr || is_integer(key.target)) throw wrong_type();
    require_range(*number);
  }
}

void Configuration::assign(Key& key, const Value& value) {
  const auto number = [&] {
    const auto* integer = std::get_if<std::int64_t>(&value);
    const double in_file = integer != nullptr ? static_cast<double>(*integer) : std::get<double>(value);
    return key.rounded && in_file == key.rounded->shown ? key.rounded->member : in_file * key.info.factor;
  };
  std::visit(
      Overloaded{[&](bool* target) { *target = std::get<bool>(value); },
                 [&](float* target) { *target = static_cast<float>(number()); },
                 [&](double* target) { *target = number(); }, [&](Duration* target) { *target = seconds(number()); },
                 [&](std::string* target) { *target = std::get<std::string>(value); },
                 [&](std::filesystem::path* target) { *target = std::get<std::string>(value); },
                 [&](std::span<double> target) {
                   std::ranges::transform(std::get<std::vector<double>>(value), target.begin(),
                                          [&](double part) { return part * key.info.factor; });
                 },
                 [&](Choice& choice) {
                   const auto name = std::ranges::find(choice.names, std::get<std::string>(value));
                   choice.set(static_cast<std::size_t>(name - choice.names.begin()));
                 },
                 [&](Numbers& numbers) { numbers.set(std::get<std::vector<double>>(value)); },
                 [&](auto* integer) {
                   const std::int64_t stated = std::get<std::int64_t>(value);
                   *integer = static_cast<std::remove_pointer_t<decltype(integer)>>(
                       key.info.factor == 1.0 ? stated : std::llround(static_cast<double>(stated) * key.info.factor));
                 }},
      key.target);
}

// ---- telling ----

std::string Configuration::type_name(const Key& key) {
  return std::visit(Overloaded{[](const bool*) { return std::string("true or false"); },
                               [](const float*) { return std::string("a number"); },
                               [](const double*) { return std::string("a number"); },
                               [](const Duration*) { return std::string("a number"); },
                               [](const std::string*) { return std::string("a string"); },
                               [](const std::filesystem::path*) { return std::string("a path"); },
                               [](std::span<double> v) { return std::to_string(v.size()) + " numbers in brackets"; },
                               [](const Choice& choice) {
                                 std::vector<std::string> names;
                                 for (const std::string& name : choice.names) names.push_back(in_quotes(name));
                                 return (names.size() > 1 ? "one of " : "") + join(names, ", ");
                               },
                               [](const Numbers& numbers) { return numbers.form; },
                               [](const auto*) { return std::string("an integer"); }},
                    key.target);
}

std::string Configuration::range_text(const Key& key) {
  const std::string unit = key.info.unit.empty() ? "" : " " + key.info.unit;
  const bool has_min = is_finite(key.info.min), has_max = is_finite(key.info.max);
  const std::string min = exact_text(key.info.min, 1.0), max = exact_text(key.info.max, 1.0);
  if (has_min && has_max) return ", " + min + " to " + max + unit;
  if (has_min) return ", at least " + min + unit;
  if (has_max) return ", at most " + max + unit;
  return unit.empty() ? "" : " in" + unit;
}

std::string Configuration::value_text(const Key& key) {
  const double factor = key.info.factor;
  const auto number = [&](auto value) {
    const bool rounds = key.rounded && static_cast<double>(value) == key.rounded->member;
    return rounds ? number_text(key.rounded->shown) : exact_text(value, factor);
  };
  return std::visit(
      Overloaded{[](const bool* value) { return std::string(*value ? "true" : "false"); },
                 [&](const float* value) { return as_toml_float(number(*value)); },
                 [&](const double* value) { return as_toml_float(number(*value)); },
                 [&](const Duration* value) { return as_toml_float(exact_text(*value, factor)); },
                 [](const std::string* value) { return in_quotes(*value); },
                 [](const std::filesystem::path* value) { return in_quotes(value->string()); },
                 [&](std::span<double> values) {
                   std::vector<std::string> words;
                   for (const double value : values) words.push_back(as_toml_float(exact_text(value, factor)));
                   return "[" + join(words, ", ") + "]";
                 },
                 [](const Numbers& numbers) { return shown(numbers.get()); },
                 [](const Choice& choice) {
                   const std::size_t i = choice.get();
                   return i < choice.names.size() ? in_quotes(choice.names[i]) : std::string("(none of its choices)");
                 },
                 [&](const auto* value) {
                   return factor == 1.0 ? std::to_string(*value)
                                        : std::to_string(std::llround(static_cast<double>(*value) / factor));
                 }},
      key.target);
}

std::string Configuration::print() const {
  std::string text;
  std::vector<std::string_view> tables;
  for (const Key& key : keys_)
    if (std::ranges::find(tables, table_part(key.name)) == tables.end()) tables.push_back(table_part(key.name));
  std::stable_partition(tables.begin(), tables.end(),
                        [](std::string_view table) { return table.empty(); });  // TOML wants these first
  for (const std::string_view table : tables) {
    if (!table.empty()) text += "\n[" + std::string(table) + "]\n";
    for (const Key& key : keys_) {
      if (table_part(key.name) != table) continue;
      const std::string value = value_text(key);
      text += "# " + key.info.help + (key.info.help.empty() ? "" : " ") + "Takes " + type_name(key) + range_text(key);
      text += value == key.default_text ? ".\n" : "; default " + key.default_text + ".\n";
      text += std::string(last_part(key.name)) + " = " + value + "\n";
    }
  }
  return text;
}

std::string Configuration::explain(std::string_view name) const {
  if (const Key* key = find(name))
    return key->name + " = " + value_text(*key) + "\n  " + (key->info.help.empty() ? "" : key->info.help + "\n  ") +
           "Takes " + type_name(*key) + range_text(*key) + "; default " + key->default_text + ".\n";
  if (!is_table(name)) throw unknown_key("--explain", std::string(name));
  std::string text;
  for (const Key& key : keys_)
    if (key.name.starts_with(std::string(name) + "."))
      text += key.name + " = " + value_text(key) + (key.info.unit.empty() ? "" : " " + key.info.unit) + "\n";
  return text;
}

std::vector<std::string> Configuration::names() const {
  std::vector<std::string> result;
  for (const Key& key : keys_) result.push_back(key.name);
  return result;
}

const Configuration::Key* Configuration::find(std::string_view name) const {
  const auto key = std::ranges::find(keys_, name, &Key::name);
  return key == keys_.end() ? nullptr : &*key;
}

bool Configuration::is_table(std::string_view name) const {
  return !name.empty() && std::ranges::any_of(keys_, [&](const Key& key) {
    return key.name.size() > name.size() && key.name.starts_with(name) && key.name[name.size()] == '.';
  });
}

ConfigError Configuration::unknown_key(const std::string& place, const std::string& name) const {
  std::vector<std::string> candidates = names();
  for (const Key& key : keys_)
    for (std::string_view table = table_part(key.name); !table.empty(); table = table_part(table))
      candidates.emplace_back(table);
  const auto guess = nearest_name(name, candidates);
  if (!guess)
    return ConfigError(place, "unknown key '" + name + "'", "no key with a similar name",
                       "remove it; `chainslam config --print` lists all keys");
  const Key* key = find(*guess);
  const std::string what = key != nullptr
                               ? " (" + type_name(*key) + range_text(*key) + ", default " + key->default_text + ")"
                               : " (a table)";
  return ConfigError(place, "unknown key '" + name + "'", "'" + name + "'; did you mean '" + *guess + "'" + what + "?",
                     "correct the name; `chainslam config --explain " + *guess + "` says more");
}

std::string Configuration::place_of(std::string_view key) const {
  std::string place = "defaults";
  for (const Assignment& assignment : assignments_)
    if (keys_[assignment.key].name == key) place = assignment.place;
  return place;
}

}  // namespace chainslam::support
