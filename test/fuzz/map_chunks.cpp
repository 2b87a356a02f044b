#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "fuzz/input.hpp"
#include "fuzz/sealed.hpp"

// Map files and journals of inputs whose checksums are right, whatever their headers and records say: all of that is
// behind a checksum that mutated bytes hardly ever have.

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace chainslam;
  const std::string bytes = test::sealed({reinterpret_cast<const char*>(data), size});
  return test::fuzz(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size(), "input.cslam",
                    [](const auto& path) {
                      try {
                        static_cast<void>(load_map(path, {.max_memory = 500'000'000}));
                      } catch (const IoError&) {
                      }
                      try {
                        static_cast<void>(read_input_journal(path));
                      } catch (const IoError&) {
                      }
                      static_cast<void>(load_map(path, {.recover = true, .max_memory = 500'000'000}));
                    });
}
