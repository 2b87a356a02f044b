#include "datasets/chunk_codec.hpp"

#include <bzlib.h>
#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <memory>
#include <utility>

namespace chainslam::datasets {
namespace {

/// What one call of a codec did.
struct Step {
  std::size_t consumed = 0, produced = 0;
  bool done = false;
  std::string fault{};
};

/// Calls `step(packed, room)` until it is done, wants more than there is, or makes more than was claimed.
template <class Codec>
Unpacked run(Codec& codec, std::span<const std::byte> packed, std::uint64_t claimed) {
  Unpacked out;
  const std::size_t most = static_cast<std::size_t>(claimed) + 1;  // one more shows that there is more
  std::size_t in = 0, made = 0;
  for (bool done = false; !done;) {
    if (made == out.bytes.size()) {
      if (made == most) break;
      out.bytes.resize(std::min(most, std::max<std::size_t>(2 * made, std::max<std::size_t>(3 * packed.size(), 4096))));
    }
    Step step = codec.step(packed.subspan(in), std::span(out.bytes).subspan(made));
    in += step.consumed;
    made += step.produced;
    done = step.done;
    out.fault = std::move(step.fault);
    if (!out.fault.empty()) break;
    if (!done && step.consumed == 0 && step.produced == 0) {
      out.fault = "the packed bytes end early";
      break;
    }
  }
  out.bytes.resize(std::min<std::size_t>(made, static_cast<std::size_t>(claimed)));
  if (out.fault.empty() && made != claimed)
    out.fault = std::string(made > claimed ? "more than the " : std::to_string(made) + " of the ") +
                std::to_string(claimed) + " bytes promised come out";
  return out;
}

class Bz2 {
 public:
  Bz2() { BZ2_bzDecompressInit(&stream_, 0, 0); }
  Bz2(const Bz2&) = delete;
  Bz2& operator=(const Bz2&) = delete;
  ~Bz2() { BZ2_bzDecompressEnd(&stream_); }

  Step step(std::span<const std::byte> packed, std::span<std::byte> room) {
    constexpr std::size_t most = std::size_t{1} << 30;  // the library counts in 32 bits
    const auto in = static_cast<unsigned>(std::min(packed.size(), most));
    const auto out = static_cast<unsigned>(std::min(room.size(), most));
    stream_.next_in = const_cast<char*>(reinterpret_cast<const char*>(packed.data()));
    stream_.avail_in = in;
    stream_.next_out = reinterpret_cast<char*>(room.data());
    stream_.avail_out = out;
    const int result = BZ2_bzDecompress(&stream_);
    Step step{.consumed = in - stream_.avail_in, .produced = out - stream_.avail_out, .done = result == BZ_STREAM_END};
    if (result != BZ_OK && result != BZ_STREAM_END) step.fault = "bz2 error " + std::to_string(result);
    return step;
  }

 private:
  bz_stream stream_{};
};

class Lz4 {
 public:
  Lz4() { LZ4F_createDecompressionContext(&context_, LZ4F_VERSION); }
  Lz4(const Lz4&) = delete;
  Lz4& operator=(const Lz4&) = delete;
  ~Lz4() { LZ4F_freeDecompressionContext(context_); }

  Step step(std::span<const std::byte> packed, std::span<std::byte> room) {
    std::size_t in = packed.size(), out = room.size();
    const std::size_t result = LZ4F_decompress(context_, room.data(), &out, packed.data(), &in, nullptr);
    if (LZ4F_isError(result) != 0) return {.fault = std::string("lz4: ") + LZ4F_getErrorName(result)};
    return {.consumed = in, .produced = out, .done = result == 0};
  }

 private:
  LZ4F_dctx* context_ = nullptr;
};

class Zstd {
 public:
  Step step(std::span<const std::byte> packed, std::span<std::byte> room) {
    ZSTD_inBuffer in{packed.data(), packed.size(), 0};
    ZSTD_outBuffer out{room.data(), room.size(), 0};
    const std::size_t result = ZSTD_decompressStream(context_.get(), &out, &in);
    Step step{.consumed = in.pos, .produced = out.pos, .done = result == 0};
    if (ZSTD_isError(result) != 0) step.fault = std::string("zstd: ") + ZSTD_getErrorName(result);
    return step;
  }

 private:
  struct Free {
    void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
  };
  std::unique_ptr<ZSTD_DCtx, Free> context_{ZSTD_createDCtx()};
};

template <class Codec>
Unpacked run(std::span<const std::byte> packed, std::uint64_t claimed) {
  Codec codec;
  return run(codec, packed, claimed);
}

}  // namespace

std::optional<Compression> compression_of(std::string_view name) {
  constexpr std::array<std::string_view, 4> names{"none", "bz2", "lz4", "zstd"};
  if (name.empty()) return Compression::none;
  const auto found = std::ranges::find(names, name);
  return found == names.end() ? std::nullopt : std::optional(static_cast<Compression>(found - names.begin()));
}

Unpacked ChunkUnpacker::unpack(Compression compression, std::span<const std::byte> packed, std::uint64_t claimed) {
  if (compression == Compression::none) {
    Unpacked out{.bytes = {packed.begin(), packed.end()}, .fault = ""};
    if (packed.size() != claimed)
      out.fault = std::to_string(packed.size()) + " of the " + std::to_string(claimed) + " bytes promised are there";
    return out;
  }
  constexpr std::uint64_t largest_ratio = 64;
  allowed_ = std::min(allowed_ + largest_ratio * packed.size(), largest_chunk);
  if (claimed > largest_chunk)
    return {.bytes = {}, .fault = "a chunk of " + std::to_string(claimed) + " bytes; 256 MiB are the most"};
  if (claimed > allowed_)
    return {.bytes = {},
            .fault = std::to_string(packed.size()) + " bytes that claim to become " + std::to_string(claimed) +
                     "; 64 times as many, and 16 MiB once, are the most"};
  allowed_ -= claimed;
  switch (compression) {
    case Compression::bz2:
      return run<Bz2>(packed, claimed);
    case Compression::lz4:
      return run<Lz4>(packed, claimed);
    default:
      return run<Zstd>(packed, claimed);
  }
}

}  // namespace chainslam::datasets
