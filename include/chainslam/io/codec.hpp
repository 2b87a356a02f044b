#pragma once

#include <algorithm>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace chainslam {

/// Packs bytes and unpacks them again.
///
/// `C::id` is the number that files name it by. `decompress` fills `out`, whose size the caller has already checked, to
/// its last byte; false if the data are damaged or hold another number of bytes. It takes memory for no more than `out`
/// and never reads or writes outside. The same bytes are packed the same way by the same version of the codec.
template <class C>
concept Codec = std::copyable<C> && requires(const C& codec, std::span<const std::byte> in, std::span<std::byte> out) {
  { C::id } -> std::convertible_to<std::uint32_t>;
  { codec.compress(in) } -> std::same_as<std::vector<std::byte>>;
  { codec.decompress(in, out) } -> std::same_as<bool>;
};

/// Keeps bytes as they are.
struct RawCodec {
  static constexpr std::uint32_t id = 0;  ///< 0 in a chunk's header

  /// A copy.
  [[nodiscard]] std::vector<std::byte> compress(std::span<const std::byte> in) const { return {in.begin(), in.end()}; }
  /// Copies; false unless the sizes agree.
  [[nodiscard]] bool decompress(std::span<const std::byte> in, std::span<std::byte> out) const {
    if (in.size() != out.size()) return false;
    std::copy(in.begin(), in.end(), out.begin());
    return true;
  }
};
static_assert(Codec<RawCodec>);

}  // namespace chainslam
