#include "chainslam/core/error.hpp"

#include <doctest/doctest.h>

#include <cstdint>
#include <string>

namespace chainslam::test {

TEST_SUITE("core/printable") {
  TEST_CASE("what can be read is kept, in any script") {
    const std::string text = "run 1/scan_07.pcd \\ \xC3\xA4\xC3\xB6 \xE6\x9D\xB1\xE4\xBA\xAC \xF0\x9F\x97\xBA ~";
    CHECK(printable(text) == text);
    CHECK(printable("").empty());
  }

  TEST_CASE("controls, bytes that are no UTF-8 and marks that turn the line become hexadecimal") {
    CHECK(printable("a\x1b[31mb\x07\x7F\t") == "a\\x1B[31mb\\x07\\x7F\\x09");
    CHECK(printable("\xC2\x9B") == "\\xC2\\x9B");  // C1's introducer, as UTF-8
    CHECK(printable("\x9B") == "\\x9B");           // and as a byte
    CHECK(printable("a\xE2\x80\xAE"
                    "b") ==
          "a\\xE2\\x80\\xAE"
          "b");                                                               // right-to-left override
    CHECK(printable("\xC0\xAF\xE0\x80\xAF") == "\\xC0\\xAF\\xE0\\x80\\xAF");  // overlong
    CHECK(printable("\xED\xA0\x80") == "\\xED\\xA0\\x80");                    // half of a surrogate pair
    CHECK(printable("\xF4\x90\x80\x80") == "\\xF4\\x90\\x80\\x80");           // beyond Unicode
    CHECK(printable("\xE6\x9D") == "\\xE6\\x9D");                             // cut short
    CHECK(printable("a\nb\r\n") == "a\\x0Ab\\x0D\\x0A");
    CHECK(printable("a\nb\r\n", true) == "a\nb\\x0D\n");
  }

  TEST_CASE("no text of any two or three bytes comes out with a control in it, and printing twice changes nothing") {
    const auto harmless = [](const std::string& text) {
      for (std::size_t i = 0; i < text.size(); ++i) {
        const auto byte = static_cast<std::uint8_t>(text[i]);
        if (byte < 0x20 || byte == 0x7F) return false;
        if (byte == 0xC2 && static_cast<std::uint8_t>(text[i + 1]) < 0xA0) return false;
      }
      return printable(text) == text;
    };
    for (int a = 0; a < 256; ++a)
      for (int b = 0; b < 256; ++b) {
        const std::string two{static_cast<char>(a), static_cast<char>(b)};
        if (!harmless(printable(two)) || !harmless(printable(two + 'x')) || !harmless(printable('\xE2' + two)))
          FAIL("bytes " << a << " " << b);
      }
  }

  TEST_CASE("errors about files keep their three lines, whatever the files are called") {
    const IoError error(IoError::Kind::input, {"evil\n  do: rm -rf\x1b[2J.pcd", "field \x07", "'\xff'\n", "a\nb"});
    CHECK(std::string(error.what()) ==
          "evil\\x0A  do: rm -rf\\x1B[2J.pcd, field \\x07\n  found: '\\xFF'\\x0A\n  do: a\nb");
    CHECK(error.report().path == "evil\n  do: rm -rf\x1b[2J.pcd");  // as the caller named it
  }
}

}  // namespace chainslam::test
