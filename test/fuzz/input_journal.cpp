#include "chainslam/io/input_journal.hpp"
#include "fuzz/input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  return chainslam::test::fuzz(data, size, "input.cslam.partial",
                               [](const auto& path) { static_cast<void>(chainslam::read_input_journal(path)); });
}
