#include "datasets/inspect.hpp"
#include "fuzz/input.hpp"
#include "mapper/summary_file.hpp"

// What `inspect` reads of a folder of results, and makes a table of.

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace chainslam;
  return test::fuzz(data, size, "summary.json", [](const auto& path) {
    static_cast<void>(datasets::to_text({.kind = "map", .facts = mapper::read_summary(path), .warnings = {}}));
  });
}
