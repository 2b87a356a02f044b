#include "saved_settings.hpp"

#include <algorithm>

#include "chainslam/core/error.hpp"

namespace chainslam::mapper {

namespace {

/// The first of them, and how many more there are.
std::string some_of(const std::vector<std::string>& names) {
  constexpr std::size_t most = 20;
  std::string text;
  for (std::size_t i = 0; i < std::min(most, names.size()); ++i) text += (i == 0 ? "" : ", ") + names[i];
  return text + (names.size() > most ? " and " + std::to_string(names.size() - most) + " more" : "");
}

}  // namespace

SavedSettings saved_settings(const std::string& stated, const std::filesystem::path& file, const std::string& remedy,
                             const std::vector<std::string>& overrides) {
  SavedSettings settings{.options = {}, .text = stated, .notes = {}};
  support::Configuration configuration = make_configuration(settings.options);
  std::vector<std::string> left_out;
  try {
    left_out = configuration.load_foreign_text(stated, "parameters");
    configuration.apply();
  } catch (const support::ConfigError& error) {
    const std::string problem = error.what();
    throw_input_error(file.string(), "",
                      "a configuration that this version cannot use: " + problem.substr(0, problem.find('\n')), remedy);
  }
  const std::vector<std::string> defaults = configuration.unassigned();
  if (!overrides.empty()) {
    for (const std::string& assignment : overrides) configuration.set(assignment);
    configuration.apply();
    settings.text = configuration_text(settings.options);
  }
  if (left_out.empty() && defaults.empty()) return settings;
  settings.text = configuration_text(settings.options);
  settings.notes.emplace_back("another version of chainslam began this run: its own map may have differed");
  if (!left_out.empty())
    settings.notes.push_back("settings left out, which this version does not have: " + some_of(left_out));
  if (!defaults.empty())
    settings.notes.push_back("settings of this version that the run does not state, at their defaults: " +
                             some_of(defaults));
  return settings;
}

}  // namespace chainslam::mapper
