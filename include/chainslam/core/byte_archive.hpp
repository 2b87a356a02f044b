#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <type_traits>
#include <vector>

namespace chainslam {

/// Appends numbers, least significant byte first.
class ByteSink {
 public:
  explicit ByteSink(std::size_t expected = 0) { bytes_.reserve(expected); }  ///< reserves memory for so many bytes

  /// Appends a number, least significant byte first.
  template <class T>
  void put(const T& value) {
    auto bytes = std::bit_cast<std::array<std::byte, sizeof(T)>>(value);
    if constexpr (std::endian::native == std::endian::big) std::reverse(bytes.begin(), bytes.end());
    append(bytes.data(), bytes.size());
  }
  /// As it lies in memory.
  template <class T>
  void put_raw(const T& value) {
    append(&value, sizeof(T));
  }
  /// How many, and each.
  template <class List>
  void put_list(const List& list) {
    put(static_cast<std::uint64_t>(list.size()));
    for (const auto& value : list) put(value);
  }
  [[nodiscard]] std::vector<std::byte>& bytes() { return bytes_; }  ///< all that was appended

 private:
  void append(const void* data, std::size_t count) {
    const std::size_t end = bytes_.size();
    bytes_.resize(end + count);
    std::memcpy(bytes_.data() + end, data, count);
  }

  std::vector<std::byte> bytes_;
};

/// Takes numbers off bytes whose length has been checked.
class ByteSource {
 public:
  /// Reads these bytes, which must outlive it.
  explicit ByteSource(std::span<const std::byte> bytes) : bytes_(bytes) {}

  /// The next number. The caller checks that there are as many bytes.
  template <class T>
  [[nodiscard]] T take() {
    std::array<std::byte, sizeof(T)> bytes;
    std::memcpy(bytes.data(), bytes_.data(), sizeof(T));
    if constexpr (std::endian::native == std::endian::big) std::reverse(bytes.begin(), bytes.end());
    bytes_ = bytes_.subspan(sizeof(T));
    return std::bit_cast<T>(bytes);
  }
  /// The next object, as it lies in memory.
  template <class T>
  [[nodiscard]] T take_raw() {
    T value;
    std::memcpy(&value, bytes_.data(), sizeof(T));
    bytes_ = bytes_.subspan(sizeof(T));
    return value;
  }
  /// What `put_list` wrote, into a list with `resize`.
  template <class List>
  void take_list(List& list) {
    list.resize(static_cast<decltype(list.size())>(take<std::uint64_t>()));
    for (auto& value : list) value = take<std::remove_cvref_t<decltype(value)>>();
  }
  [[nodiscard]] bool empty() const { return bytes_.empty(); }  ///< whether there is nothing in it

 private:
  std::span<const std::byte> bytes_;
};

/// FNV-1a, 64 bits, of all bytes but the 8 of the check number itself.
[[nodiscard]] inline std::uint64_t check_number(std::span<const std::byte> bytes, std::size_t check_at) {
  std::uint64_t hash = 0xcbf2'9ce4'8422'2325U;
  for (std::size_t i = 0; i < bytes.size(); ++i)
    if (i < check_at || i >= check_at + sizeof hash)
      hash = (hash ^ static_cast<std::uint64_t>(bytes[i])) * 0x100'0000'01b3U;
  return hash;
}

/// Writes the check number into bytes that are otherwise complete.
inline void seal(std::vector<std::byte>& bytes, std::size_t check_at) {
  std::uint64_t number = check_number({bytes.data(), bytes.size()}, check_at);
  for (std::size_t i = 0; i < sizeof number; ++i, number >>= 8) bytes[check_at + i] = static_cast<std::byte>(number);
}

/// Loads a number stored in the given byte order; `data` needs no alignment.
template <class T>
[[nodiscard]] T load_as(const std::byte* data, std::endian order = std::endian::little) {
  std::array<std::byte, sizeof(T)> bytes;
  for (std::size_t i = 0; i < sizeof(T); ++i) bytes[i] = data[order == std::endian::native ? i : sizeof(T) - 1 - i];
  return std::bit_cast<T>(bytes);
}

/// Appends a number, least significant byte first.
template <class T>
void append_bytes(std::vector<std::byte>& out, T value) {
  const auto bytes = std::bit_cast<std::array<std::byte, sizeof(T)>>(value);
  for (std::size_t i = 0; i < sizeof(T); ++i)
    out.push_back(bytes[std::endian::native == std::endian::little ? i : sizeof(T) - 1 - i]);
}

}  // namespace chainslam
