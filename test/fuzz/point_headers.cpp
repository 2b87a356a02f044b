#include <array>
#include <cstring>
#include <string>

#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "fuzz/input.hpp"

// Headers of PCD and PLY whose words are right and whose numbers are the input's: mutated text seldom is a header at
// all.

namespace {

/// Takes numbers from the input's front.
class Numbers {
 public:
  Numbers(const std::uint8_t* data, std::size_t size) : rest_(reinterpret_cast<const char*>(data), size) {}

  std::uint64_t next(std::size_t bytes) {
    std::uint64_t value = 0;
    for (std::size_t i = 0; i < bytes && !rest_.empty(); ++i) {
      value = value << 8 | static_cast<std::uint8_t>(rest_[0]);
      rest_.remove_prefix(1);
    }
    return value;
  }
  /// One of the few that matter, or any: sizes are often near what the body holds, or near a limit.
  std::string count() {
    const std::uint64_t choice = next(1);
    if (choice < 64) return std::to_string(choice);
    if (choice < 96) return std::to_string((std::uint64_t{1} << (choice - 64)) - 1);
    if (choice < 128) return std::to_string(std::uint64_t{1} << (choice - 96));
    if (choice < 144) return "-" + std::to_string(choice - 128);
    return std::to_string(next(choice % 8 + 1));
  }
  [[nodiscard]] std::string body() const { return std::string(rest_); }

 private:
  std::string_view rest_;
};

std::string pcd_header(Numbers& numbers) {
  constexpr std::array<const char*, 8> names{" x", " y", " z", " intensity", " t", " normal_x", " a", " x"};
  constexpr std::array<const char*, 5> sizes{" 1", " 2", " 4", " 8", " 3"};
  constexpr std::array<const char*, 4> types{" F", " I", " U", " Q"};
  constexpr std::array<const char*, 3> encodings{"ascii", "binary", "binary_compressed"};
  std::string fields = "FIELDS", size = "\nSIZE", type = "\nTYPE", counts = "\nCOUNT";
  const std::uint64_t columns = numbers.next(1) % 10;
  for (std::uint64_t i = 0; i < columns; ++i) {
    fields += names[i < 3 ? i : numbers.next(1) % names.size()];
    size += sizes[numbers.next(1) % sizes.size()];
    type += types[numbers.next(1) % types.size()];
    counts += ' ' + numbers.count();
  }
  if (numbers.next(1) % 4 == 0) counts.clear();
  const std::string points = numbers.count(), height = numbers.next(1) % 4 == 0 ? numbers.count() : "1";
  return fields + size + type + counts + "\nWIDTH " + points + "\nHEIGHT " + height + "\nPOINTS " +
         (numbers.next(1) % 4 == 0 ? numbers.count() : points) + "\nDATA " + encodings[numbers.next(1) % 3] + '\n';
}

std::string ply_header(Numbers& numbers) {
  constexpr std::array<const char*, 8> names{"x", "y", "z", "intensity", "t", "nx", "a", "x"};
  constexpr std::array<const char*, 8> types{"char", "uchar", "short", "float", "double", "int", "long", "none"};
  constexpr std::array<const char*, 3> formats{"ascii", "binary_little_endian", "binary_big_endian"};
  std::string text = std::string("ply\nformat ") + formats[numbers.next(1) % 3] + " 1.0\n";
  const std::uint64_t elements = numbers.next(1) % 4;
  for (std::uint64_t e = 0; e < elements; ++e) {
    text += (e + 1 == elements ? "element vertex " : "element face ") + numbers.count() + '\n';
    const std::uint64_t columns = numbers.next(1) % 8;
    for (std::uint64_t i = 0; i < columns; ++i) {
      text += "property ";
      if (numbers.next(1) % 4 == 0) text += std::string("list ") + types[numbers.next(1) % 8] + ' ';
      text += std::string(types[numbers.next(1) % 8]) + ' ' + names[i < 3 ? i : numbers.next(1) % 8] + '\n';
    }
  }
  return text + "end_header\n";
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace chainslam;
  Numbers numbers(data, size);
  const bool pcd = numbers.next(1) % 2 == 0;
  const std::string header = pcd ? pcd_header(numbers) : ply_header(numbers);
  const std::string bytes = header + numbers.body();
  return test::fuzz(reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size(), pcd ? "input.pcd" : "input.ply",
                    [&](const auto& path) { static_cast<void>(pcd ? read_pcd_file(path) : read_ply_file(path)); });
}
