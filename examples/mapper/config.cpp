#include <cstdio>
#include <filesystem>
#include <string>

#include "chainslam/core/error.hpp"
#include "exit_code.hpp"
#include "options.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

int run(const ConfigArguments& arguments) {
  MapperOptions options;
  support::Configuration configuration = make_configuration(options);
  if (!arguments.explain.empty()) std::printf("%s\n", configuration.explain(arguments.explain).c_str());
  const std::filesystem::path& file = arguments.check.empty() ? arguments.file : arguments.check;
  if (!file.empty()) configuration.load(file);
  for (const std::string& assignment : arguments.overrides) configuration.set(assignment);
  configuration.apply();
  if (!arguments.check.empty()) std::printf("%s: good\n", printable(arguments.check.native()).c_str());
  if (arguments.print) std::printf("%s", configuration.print().c_str());
  return exit_good;
}

}  // namespace chainslam::mapper
