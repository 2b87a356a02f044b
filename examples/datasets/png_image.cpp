#include "datasets/png_image.hpp"

#include <png.h>

#include <algorithm>
#include <csetjmp>
#include <cstddef>
#include <cstring>
#include <string>

#include "chainslam/io/input_file.hpp"

namespace chainslam::datasets {
namespace {

constexpr png_uint_32 largest_side = 16384;
constexpr std::size_t most_pixels = std::size_t{1} << 22;  // 1024 rings by 4096 columns

/// All that libpng touches, so that its jumps out of errors leave no object behind.
struct Decoder {
  explicit Decoder(InputFile& input) : file(input) {
    png = png_create_read_struct(PNG_LIBPNG_VER_STRING, this, on_error, on_warning);
    info = png != nullptr ? png_create_info_struct(png) : nullptr;
  }
  Decoder(const Decoder&) = delete;
  Decoder& operator=(const Decoder&) = delete;
  ~Decoder() { png_destroy_read_struct(&png, &info, nullptr); }

  static void on_error(png_structp png, png_const_charp message) {
    static_cast<Decoder*>(png_get_error_ptr(png))->error = message;
    png_longjmp(png, 1);
  }
  static void on_warning(png_structp, png_const_charp) {}
  static void on_read(png_structp png, png_bytep data, png_size_t size) {
    auto* self = static_cast<Decoder*>(png_get_io_ptr(png));
    if (self->read(data, size) < size) png_error(png, "the file ends within the image");
  }

  /// Errors of the disk are kept too: an exception must not cross libpng.
  std::size_t read(png_bytep data, std::size_t size) noexcept {
    try {
      return file.read_some(std::as_writable_bytes(std::span(data, size)));
    } catch (const IoError&) {
      return 0;
    }
  }

  InputFile& file;
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::string error;
  std::vector<png_byte> bytes;
  std::vector<png_bytep> rows;
};

/// False if libpng met an error; its words are then in `decoder.error`.
bool decode_header(Decoder& decoder) {
  if (setjmp(png_jmpbuf(decoder.png)) != 0) return false;
  png_set_read_fn(decoder.png, &decoder, Decoder::on_read);
  png_set_user_limits(decoder.png, largest_side, largest_side);
  png_set_keep_unknown_chunks(decoder.png, PNG_HANDLE_CHUNK_NEVER, nullptr, -1);  // no texts, which may be large
  png_read_info(decoder.png, decoder.info);
  return true;
}

bool decode_rows(Decoder& decoder) {
  if (setjmp(png_jmpbuf(decoder.png)) != 0) return false;
  png_read_image(decoder.png, decoder.rows.data());
  png_read_end(decoder.png, nullptr);
  return true;
}

}  // namespace

GrayImage read_gray_png(const std::filesystem::path& path) {
  InputFile file(path);
  Decoder decoder(file);
  const auto fail = [&](const std::string& found) {
    throw_input_error(path.string(), file.place_of_byte(), found, "give a grey PNG image of 8 or 16 bits");
  };
  if (decoder.info == nullptr || !decode_header(decoder)) fail("no PNG image: " + decoder.error);
  const int depth = png_get_bit_depth(decoder.png, decoder.info);
  if (png_get_color_type(decoder.png, decoder.info) != PNG_COLOR_TYPE_GRAY || (depth != 8 && depth != 16))
    fail("a PNG image that is not grey of 8 or 16 bits");
  GrayImage image;
  image.width = static_cast<int>(png_get_image_width(decoder.png, decoder.info));
  image.height = static_cast<int>(png_get_image_height(decoder.png, decoder.info));
  const std::size_t pixels = static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height);
  if (pixels > most_pixels)
    fail(std::to_string(image.width) + " x " + std::to_string(image.height) +
         " pixels, where a range image has 2^22 at most");
  const std::size_t stride = png_get_rowbytes(decoder.png, decoder.info);
  // Deflate packs at most 1032 to 1: a larger claim is a lie, and must not cost memory.
  if (stride * static_cast<std::size_t>(image.height) / 1032 > file.size().value_or(0))
    fail("a size that the file is too small for");
  decoder.bytes.resize(stride * static_cast<std::size_t>(image.height));
  for (std::size_t row = 0; row < static_cast<std::size_t>(image.height); ++row)
    decoder.rows.push_back(decoder.bytes.data() + row * stride);
  if (!decode_rows(decoder)) fail("a damaged PNG image: " + decoder.error);
  image.pixels.reserve(pixels);
  for (std::size_t i = 0; i < pixels; ++i)
    image.pixels.push_back(depth == 8
                               ? decoder.bytes[i]
                               : static_cast<std::uint16_t>(decoder.bytes[2 * i] << 8 | decoder.bytes[2 * i + 1]));
  return image;
}

}  // namespace chainslam::datasets
