#pragma once

#include <concepts>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::support {

/// A configuration that cannot be used. `what()` is three lines: file, line and column; what was found; what to do.
/// What comes from outside is made printable, so that it cannot pass for another line.
class ConfigError : public std::runtime_error {
 public:
  ConfigError(const std::string& place, const std::string& problem, const std::string& found, const std::string& remedy)
      : std::runtime_error((place.empty() ? "" : printable(place) + ": ") + printable(problem) +
                           "\n  found: " + printable(found) + "\n  do: " + printable(remedy, true)) {}
  /// @param message  all three lines.
  explicit ConfigError(const std::string& message) : std::runtime_error(message) {}
};

/// What a user is told about a key, and what its values must keep to.
struct KeyInfo {
  std::string unit{};                                     ///< as the file states it: "m", "s", "deg"; empty if none
  double min = -std::numeric_limits<double>::infinity();  ///< in the file's unit; for numbers and each part of a vector
  double max = std::numeric_limits<double>::infinity();
  double factor = 1.0;  ///< member = factor * file value: pi / 180 for "deg"
  std::string help{};   ///< a sentence or two
  /// Other keys' values that the member's value, once it is set, brings along, as the file writes them: a preset's.
  /// Keys with such are set before all others, in the order of registration.
  std::function<std::vector<std::pair<std::string_view, std::string_view>>()> brings{};
};

/// The keys of a program's TOML file, each bound to a member of one of its plain option structs.
///
/// Register all keys with `add`, read with `load` and `set`, then `apply`: members change there and not before. A
/// member's value at registration is the key's default. Members and the objects around them must outlive the
/// configuration.
///
///     Configuration configuration;
///     configuration.add("odometry.voxel_size", options.odometry.voxel_size,
///                       {.unit = "m", .min = 0.05, .max = 5, .help = "Edge of the voxels that a scan is reduced
///                       to."});
///     configuration.load("site.toml");
///     configuration.set("odometry.voxel_size=0.4");
///     configuration.apply();
class Configuration {
 public:
  /// A member that is one of several named values.
  struct Choice {
    std::vector<std::string> names;
    std::function<std::size_t()> get;
    std::function<void(std::size_t)> set;
  };
  /// A member that numbers make up, of which there may be none or several counts, such as a pose.
  struct Numbers {
    std::string form;  ///< what to write, in words
    std::function<std::vector<double>()> get;
    std::function<std::string(const std::vector<double>&)> problem;  ///< what they are instead; empty if they will do
    std::function<void(const std::vector<double>&)> set;
  };
  using Target = std::variant<bool*, std::int32_t*, std::int64_t*, std::uint64_t*, float*, double*, Duration*,
                              std::string*, std::filesystem::path*, std::span<double>, Choice, Numbers>;
  using Value = std::variant<bool, std::int64_t, double, std::string, std::vector<double>>;

  /// Binds a key to a number, text, path, `Duration` (seconds in the file) or, by a span, to the numbers of a vector.
  /// @param name  dotted: the last part is the key, what is before it the table.
  /// @throws std::logic_error if the key is there already, or its default is out of its own range.
  void add(std::string name, Target target, KeyInfo info);

  template <class Member>
    requires std::constructible_from<Target, Member*>
  void add(std::string name, Member& member, KeyInfo info) { add(std::move(name), Target(&member), std::move(info)); }

  /// Binds a key to an enumeration, whose values go by their names in the file.
  template <class Enum>
    requires std::is_enum_v<Enum>
  void add(std::string name, Enum& member, const std::vector<std::pair<std::string, Enum>>& choices, KeyInfo info) {
    Choice choice;
    std::vector<Enum> values;
    for (const auto& [choice_name, value] : choices) {
      choice.names.push_back(choice_name);
      values.push_back(value);
    }
    choice.get = [values, &member] {
      std::size_t i = 0;
      while (i < values.size() && values[i] != member) ++i;
      return i;
    };
    choice.set = [values, &member](std::size_t i) { member = values[i]; };
    add(std::move(name), Target(std::move(choice)), std::move(info));
  }

  /// A condition between several keys, checked by `apply`.
  /// @param keys   the keys that it is about, the one to name first in front.
  /// @param demand what must hold, in words: "must be below odometry.max_range".
  void add_rule(std::vector<std::string> keys, std::string demand, std::function<bool()> holds);

  /// Reads a TOML file; later values replace earlier ones.
  /// @throws ConfigError on a file that cannot be read, a syntax error, a key that is unknown or there twice, a value
  /// of the wrong type, out of range or not finite. Of several errors, the first in the file.
  void load(const std::filesystem::path& file);

  /// As `load`, for text at hand; errors call it `name`.
  void load_text(std::string_view text, const std::string& name);

  /// As `load_text`, for what another version of the program has printed.
  /// @returns what is left out since no key takes it, as "key = value"; sorted by key.
  /// @throws ConfigError if it is not TOML.
  [[nodiscard]] std::vector<std::string> load_foreign_text(std::string_view text, const std::string& name);

  /// Names of the keys that nothing that was read assigns, in the order of registration.
  [[nodiscard]] std::vector<std::string> unassigned() const;

  /// One override as the command line states it: `key=value`; text needs no quotes there.
  /// @throws ConfigError as `load`.
  void set(std::string_view assignment);

  /// Sets the members from all that was read: first keys that bring others' values along, then the others. Of several
  /// values for one key the last counts.
  /// @throws ConfigError if a rule is broken. @throws std::logic_error if a value that is brought along does not fit.
  void apply();

  /// All keys as a TOML file with comments, each with its member's value; reading it back gives the same values.
  /// Numbers are as short as that allows; defaults are rounded to six digits, and what is shown of one stands for it.
  [[nodiscard]] std::string print() const;

  /// What a key means, its unit, range, default and value; of a table, its keys with a line each.
  /// @throws ConfigError if there is no such key, with the nearest name.
  [[nodiscard]] std::string explain(std::string_view name) const;

  /// Names of all keys, in the order of registration.
  [[nodiscard]] std::vector<std::string> names() const;

 private:
  /// A default that is shown with fewer digits than it has: what is shown, in the file's unit, stands for the member.
  struct RoundedDefault {
    double shown;
    double member;
  };
  struct Key {
    std::string name;
    Target target;
    KeyInfo info;
    std::string default_text;  ///< as TOML
    std::optional<RoundedDefault> rounded;
  };
  struct Rule {
    std::vector<std::string> keys;
    std::string demand;
    std::function<bool()> holds;
  };
  struct Assignment {
    std::size_t key;
    Value value;
    std::string place;
  };
  class TomlReader;

  void append(std::vector<Assignment> read);
  [[nodiscard]] const Key* find(std::string_view name) const;
  [[nodiscard]] bool is_table(std::string_view name) const;
  [[nodiscard]] ConfigError unknown_key(const std::string& place, const std::string& name) const;
  [[nodiscard]] std::string place_of(std::string_view key) const;
  static std::optional<RoundedDefault> rounded_default(const Key& key);
  static Value value_in(const Key& key, const std::string& text);
  void apply_with_others();
  static void check(const Key& key, const Value& value, const std::string& place);
  static void assign(Key& key, const Value& value);
  static std::string type_name(const Key& key);
  static std::string range_text(const Key& key);
  static std::string value_text(const Key& key);

  std::vector<Key> keys_;
  std::vector<Rule> rules_;
  std::vector<Assignment> assignments_;
};

}  // namespace chainslam::support
