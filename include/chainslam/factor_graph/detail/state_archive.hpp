#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/error.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

// A saved smoother, format 3. Numbers are little-endian, f is IEEE 754.
//
//    0  89 43 53 49 53 4D 0D 0A   mark ("\x89CSISM\r\n")
//    8  u32 3          version: another cannot be read
//   12  u32            degrees of freedom of a variable
//   16  u64            types of factors: FNV-1a of each one's variables, rows and bytes
//   24  u64            bytes of all
//   32  u64            check number: FNV-1a of bytes 0 to 31 and 40 to the end
//   40  options, variables, factors type by type, the linear system

inline constexpr std::uint64_t state_mark = 0x0A0D'4D53'4953'4389U;
inline constexpr std::uint32_t state_version = 3;
inline constexpr std::size_t state_check_at = 32;
inline constexpr std::size_t state_body_at = 40;

/// Writes what factors and variables are made of: numbers, fixed and dynamic matrices, lists, and structures of doubles
/// alone (groups, kernels).
class StateWriter {
 public:
  explicit StateWriter(ByteSink& out) : out_(out) {}

  template <class... T>
  void operator()(const T&... values) {
    (put(values), ...);
  }

 private:
  template <class T>
  void put(const T& value) {
    if constexpr (std::is_empty_v<T>) {
    } else if constexpr (std::is_arithmetic_v<T>) {
      out_.put(value);
    } else if constexpr (requires(T & list) { list.emplace_back(); }) {
      out_.put(static_cast<std::uint64_t>(value.size()));
      for (const auto& element : value) put(element);
    } else if constexpr (std::is_base_of_v<Eigen::MatrixBase<T>, T>) {
      out_.put(static_cast<std::int64_t>(value.rows()));
      out_.put(static_cast<std::int64_t>(value.cols()));
      for (Eigen::Index k = 0; k < value.size(); ++k) out_.put(value.data()[k]);
    } else {
      static_assert(std::is_standard_layout_v<T> && alignof(T) == alignof(double) && sizeof(T) % sizeof(double) == 0,
                    "IncrementalSmoother::save: a factor's members are numbers, matrices, and structures of doubles");
      const auto* const bytes = reinterpret_cast<const std::byte*>(&value);
      for (std::size_t k = 0; k < sizeof(T); k += sizeof(double)) {
        double number;
        std::memcpy(&number, bytes + k, sizeof number);
        out_.put(number);
      }
    }
  }

  ByteSink& out_;
};

/// Reads what `StateWriter` wrote.
class StateReader {
 public:
  explicit StateReader(ByteSource& in) : in_(in) {}

  template <class... T>
  void operator()(T&... values) {
    (take(values), ...);
  }

 private:
  template <class T>
  void take(T& value) {
    if constexpr (std::is_empty_v<T>) {
    } else if constexpr (std::is_arithmetic_v<T>) {
      value = in_.take<T>();
    } else if constexpr (requires { value.emplace_back(); }) {
      value.resize(in_.take<std::uint64_t>());
      for (auto& element : value) take(element);
    } else if constexpr (std::is_base_of_v<Eigen::MatrixBase<T>, T>) {
      const auto rows = in_.take<std::int64_t>();
      value.resize(rows, in_.take<std::int64_t>());
      for (Eigen::Index k = 0; k < value.size(); ++k) value.data()[k] = in_.take<typename T::Scalar>();
    } else {
      auto* const bytes = reinterpret_cast<std::byte*>(&value);
      for (std::size_t k = 0; k < sizeof(T); k += sizeof(double)) {
        const auto number = in_.take<double>();
        std::memcpy(bytes + k, &number, sizeof number);
      }
    }
  }

  ByteSource& in_;
};

/// What a saved smoother must be like to be read.
struct StateHeader {
  std::uint32_t dof = 0;
  std::uint64_t factors = 0;
};

/// Of types of factors; changes with their number, their variables, rows and members.
template <class... Factors>
[[nodiscard]] std::uint64_t fingerprint() {
  ByteSink sizes;
  sizes.put(std::uint64_t{0});  // where a check number would be
  (
      [&] {
        sizes.put(static_cast<std::uint32_t>(Factors::arity));
        sizes.put(static_cast<std::int32_t>(Factors::rows));
        sizes.put(static_cast<std::uint32_t>(sizeof(Factors)));
      }(),
      ...);
  return check_number(sizes.bytes(), 0);
}

[[nodiscard]] inline ByteSink begin_state(const StateHeader& header) {
  ByteSink out;
  out.put(state_mark);
  out.put(state_version);
  out.put(header.dof);
  out.put(header.factors);
  out.put(std::uint64_t{0});  // bytes
  out.put(std::uint64_t{0});  // check number
  return out;
}

/// Writes length and check number into what is otherwise complete.
[[nodiscard]] inline std::vector<std::byte> end_state(ByteSink out) {
  std::vector<std::byte> bytes = std::move(out.bytes());
  ByteSink length;
  length.put(static_cast<std::uint64_t>(bytes.size()));
  std::copy(length.bytes().begin(), length.bytes().end(), bytes.begin() + state_check_at - sizeof(std::uint64_t));
  seal(bytes, state_check_at);
  return bytes;
}

/// Checks a saved smoother as a whole.
/// @returns what follows the header.
/// @throws IoError naming `name` and the byte.
[[nodiscard]] inline ByteSource check_state(std::span<const std::byte> bytes, const StateHeader& expected,
                                            const std::string& name) {
  const auto refuse = [&](std::size_t byte, std::string found) {
    throw_input_error(name, "byte " + std::to_string(byte), std::move(found),
                      "save it again with the program that made it, or build the graph from its factors");
  };
  if (bytes.size() < state_body_at) refuse(bytes.size(), "the end, where a header of 40 bytes is expected");
  ByteSource in(bytes);
  if (in.take<std::uint64_t>() != state_mark) refuse(0, "something that is not a saved smoother");
  if (const auto version = in.take<std::uint32_t>(); version != state_version)
    refuse(8,
           "format version " + std::to_string(version) + ", where this program reads " + std::to_string(state_version));
  if (const auto dof = in.take<std::uint32_t>(); dof != expected.dof)
    refuse(12, "variables of " + std::to_string(dof) + " degrees of freedom");
  if (in.take<std::uint64_t>() != expected.factors) refuse(16, "factors of other types");
  if (const auto length = in.take<std::uint64_t>(); length != bytes.size())
    refuse(24, std::to_string(length) + " bytes announced, " + std::to_string(bytes.size()) + " there");
  if (in.take<std::uint64_t>() != check_number(bytes, state_check_at))
    refuse(state_check_at, "a check number that is not that of the bytes");
  return in;
}

}  // namespace chainslam::detail
