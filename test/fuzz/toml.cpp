#include <span>
#include <string>
#include <string_view>
#include "support/configuration.hpp"

#include "fuzz/input.hpp"

// A file, and in its last line what `--set` would take.

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace chainslam::support;
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  double number = 1.0;
  int whole = 1;
  bool flag = false;
  std::string name, path = "a";
  Configuration configuration;
  configuration.add("odometry.voxel_size", number, {.min = 0.1, .max = 5});
  configuration.add("icp.max_iterations", whole, {.min = 1, .max = 100});
  configuration.add("icp.robust", flag, {});
  configuration.add("name", name, {});
  try {
    configuration.load_text(text, "site.toml");
    configuration.apply();
    static_cast<void>(configuration.print());
  } catch (const ConfigError&) {
  }
  try {
    configuration.set(text.substr(text.rfind('\n') == text.npos ? 0 : text.rfind('\n') + 1));
    configuration.apply();
  } catch (const ConfigError&) {
  }
  return 0;
}
