#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "exit_code.hpp"
#include "options.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

CLI::App* add_config(CLI::App& program, int& exit_code) {
  struct Arguments {
    std::filesystem::path file, check;
    std::vector<std::string> overrides;
    std::string explain;
    bool print = false;
  };
  const auto arguments = std::make_shared<Arguments>();
  CLI::App* verb = program.add_subcommand("config", "print, check and explain the configuration");
  verb->add_flag("--print", arguments->print, "print all keys with comments, as a TOML file to start from");
  verb->add_option("--config", arguments->file, "with --print: the values of this file")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "with --print: override a key, may be given again")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--check", arguments->check, "check a file; nothing is run")->option_text("FILE");
  verb->add_option("--explain", arguments->explain, "say what a key or a table of keys means")->option_text("KEY");
  verb->require_option(1, 0);
  verb->callback([arguments, &exit_code] {
    MapperOptions options;
    support::Configuration configuration = make_configuration(options);
    if (!arguments->explain.empty()) std::printf("%s\n", configuration.explain(arguments->explain).c_str());
    const std::filesystem::path& file = arguments->check.empty() ? arguments->file : arguments->check;
    if (!file.empty()) configuration.load(file);
    for (const std::string& assignment : arguments->overrides) configuration.set(assignment);
    configuration.apply();
    if (!arguments->check.empty()) std::printf("%s: good\n", arguments->check.c_str());
    if (arguments->print) std::printf("%s", configuration.print().c_str());
    exit_code = exit_good;
  });
  return verb;
}

}  // namespace chainslam::mapper
