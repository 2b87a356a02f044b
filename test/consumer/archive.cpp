#include <chainslam/io/map_archive.hpp>
#include <filesystem>
#include <string>

int main(int, char** arguments) {
  const std::filesystem::path path = std::string(arguments[0]) + ".cslam";
  std::filesystem::remove(path);
  chainslam::save_map(path, chainslam::SlamMap{}, {.parameters = "none"});
  return chainslam::load_map(path).report.complete ? 0 : 1;
}
