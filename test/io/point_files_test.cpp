#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <random>

#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "support/files.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {
namespace {

constexpr float nan_f = std::numeric_limits<float>::quiet_NaN();

PointFile pcd(const std::string& bytes) {
  const TemporaryFolder folder;
  write_bytes(folder / "c.pcd", bytes);
  return read_pcd_file(folder / "c.pcd");
}

std::string pcd_error(const std::string& bytes) {
  return io_error([&] { return pcd(bytes).cloud.size(); });
}

PointFile ply(const std::string& bytes) {
  const TemporaryFolder folder;
  write_bytes(folder / "c.ply", bytes);
  return read_ply_file(folder / "c.ply");
}

std::string ply_error(const std::string& bytes) {
  return io_error([&] { return ply(bytes).cloud.size(); });
}

std::string pcd_header(const std::string& fields, const std::string& sizes, const std::string& types,
                       const std::string& points, const std::string& data) {
  return "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS " + fields + "\nSIZE " + sizes + "\nTYPE " +
         types + "\nWIDTH " + points + "\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS " + points + "\nDATA " + data +
         "\n";
}

std::string with_counts(std::string header, const std::string& counts) {
  return header.insert(header.find("WIDTH"), "COUNT " + counts + "\n");
}

PointCloud<float> full_cloud(std::size_t count) {
  PointCloud<float> cloud;
  std::mt19937 random(7);
  const auto number = [&] { return static_cast<float>(random() % 4096) / 64.0F - 31.7F; };
  for (std::size_t i = 0; i < count; ++i) {
    cloud.positions.emplace_back(number(), number(), i % 17 == 0 ? nan_f : number());
    cloud.normals.push_back(Eigen::Vector3f(number(), number(), number()).normalized());
    cloud.intensities.push_back(std::floor(number()));
    cloud.time_offsets.push_back(0.1F * static_cast<float>(i) / static_cast<float>(count));
  }
  return cloud;
}

template <class Vectors>
bool same_bits(const Vectors& a, const Vectors& b) {
  if (a.size() != b.size()) return false;
  for (std::size_t i = 0; i < a.size(); ++i)
    for (int k = 0; k < 3; ++k)
      if (!(a[i][k] == b[i][k] || (std::isnan(a[i][k]) && std::isnan(b[i][k])))) return false;
  return true;
}

/// Every prefix is refused with words, or gives as many points as the whole.
template <class Read>
void check_truncations(const std::string& whole, std::size_t needed, const Read& read) {
  const std::size_t size = read(whole).cloud.size();
  for (std::size_t n = 0; n < whole.size(); ++n) {
    std::size_t points = size;
    const std::string error = io_error([&] { return points = read(whole.substr(0, n)).cloud.size(); });
    CAPTURE(n);
    CHECK(points == size);
    if (n < needed) CHECK(says(error, "do: "));
  }
}

}  // namespace

TEST_SUITE("io/pcd") {
  TEST_CASE("a binary file's fields are found by name, in any order and type") {
    const std::string header = with_counts(
        pcd_header("z _ intensity y ring x t", "8 1 1 4 2 4 4", "F U U F U I U", "2", "binary"), "1 3 1 1 1 1 1");
    const auto point = [](double z, std::uint8_t i, float y, std::int32_t x, std::uint32_t t) {
      return little(z) + "abc" + little(i) + little(y) + little(std::uint16_t{5}) + little(x) + little(t);
    };
    const PointFile file =
        pcd(header + point(0.25, 200, -1.5F, -7, 99'999'999) + point(1e300, 0, nan_f, 8, 4'294'967'295U));
    REQUIRE(file.cloud.size() == 2);
    CHECK(file.cloud.positions[0] == Eigen::Vector3f(-7, -1.5F, 0.25F));
    CHECK(file.cloud.intensities == std::vector<float>{200, 0});
    CHECK(std::isnan(file.cloud.positions[1].y()));
    CHECK(file.cloud.positions[1].z() == std::numeric_limits<float>::infinity());
    CHECK(file.times == std::vector<double>{99'999'999, 4'294'967'295});
    CHECK(file.time_field == "t");
    CHECK(file.integer_times);
    CHECK(file.cloud.time_offsets.empty());
  }

  TEST_CASE("ascii files with CRLF, comments and NaN are read") {
    const PointFile file = pcd(with_counts(pcd_header("x y z rgb normal_x normal_y normal_z time", "4 4 4 4 4 4 4 4",
                                                      "F F F F F F F F", "2", "ascii"),
                                           "1 1 1 2 1 1 1 1") +
                               "1 2 3 9 9 0 0 1 0.05\r\n\nnan -2.5e1 +3 9 9 nan nan nan 0.1");
    REQUIRE(file.cloud.size() == 2);
    CHECK(file.cloud.positions[0] == Eigen::Vector3f(1, 2, 3));
    CHECK(std::isnan(file.cloud.positions[1].x()));
    CHECK(file.cloud.positions[1].y() == -25);
    CHECK(file.cloud.normals[0] == Eigen::Vector3f(0, 0, 1));
    CHECK(!file.integer_times);
    CHECK(file.times[1] == 0.1);
  }

  TEST_CASE("a hand-packed compressed file is read field by field, with literals, short and long overlapping copies") {
    // 100 points x y z = 0, 1, 1: x is 400 zeros, y and z are 800 bytes of 00 00 80 3F.
    std::string packed;
    packed += std::string("\x00\x00", 2);                                  // one literal 0
    packed += std::string("\xE0\xFF\x00", 3);                              // copy 264 from 1 back
    packed += std::string("\xE0\x7E\x00", 3);                              // copy 135 from 1 back: 400 zeros
    packed += std::string("\x03\x00\x00\x80\x3F", 5);                      // four literals
    for (int i = 0; i < 3; ++i) packed += std::string("\xE0\xFF\x03", 3);  // three times 264 from 4 back
    packed += std::string("\x40\x03", 2);                                  // copy 4 from 4 back: 800 bytes
    const std::string bytes = pcd_header("x y z", "4 4 4", "F F F", "100", "binary_compressed") +
                              little(static_cast<std::uint32_t>(packed.size())) + little(std::uint32_t{1200}) + packed;
    const PointFile file = pcd(bytes);
    REQUIRE(file.cloud.size() == 100);
    for (const auto& p : file.cloud.positions) CHECK(p == Eigen::Vector3f(0, 1, 1));
    check_truncations(bytes, bytes.size(), pcd);
  }

  TEST_CASE("damaged compressed data are refused, never crash") {
    const TemporaryFolder folder;
    write_pcd(folder / "a.pcd", full_cloud(30), PcdEncoding::binary_compressed);
    const std::string good = read_bytes(folder / "a.pcd");
    const std::size_t start = good.find("binary_compressed\n") + 18;
    std::mt19937 random(3);
    int refused = 0;
    for (int i = 0; i < 3000; ++i) {
      std::string bad = good;
      for (int k = 0; k < 3; ++k) bad[start + random() % (bad.size() - start)] = static_cast<char>(random());
      refused += !pcd_error(bad).empty();
    }
    CHECK(refused > 1000);
    std::string huge = pcd_header("x y z", "4 4 4", "F F F", "300000000", "binary_compressed");
    huge += little(std::uint32_t{10}) + little(std::uint32_t{3'600'000'000U}) + std::string(10, '\0');
    CHECK(says(pcd_error(huge), "claim to unpack to 3600000000"));
  }

  TEST_CASE("LZF packs and unpacks random, repetitive and empty data") {
    std::mt19937 random(11);
    for (const std::size_t size : {0U, 1U, 2U, 3U, 4U, 32U, 33U, 264U, 265U, 8191U, 8192U, 8193U, 8200U, 30000U})
      for (const unsigned alphabet : {1U, 2U, 5U, 256U}) {
        std::vector<std::byte> data(size), back(size);
        for (std::byte& b : data) b = static_cast<std::byte>(random() % alphabet);
        const std::vector<std::byte> packed = detail::lzf_compress(data);
        CHECK(detail::lzf_decompress(packed, back));
        CHECK(back == data);
        CHECK(packed.size() <= size + size / 32 + 1);
        if (alphabet == 1 && size > 1000) CHECK(packed.size() < size / 80);
      }
  }

  TEST_CASE("every encoding survives a round trip, NaN among it") {
    const TemporaryFolder folder;
    for (const PcdEncoding encoding : {PcdEncoding::ascii, PcdEncoding::binary, PcdEncoding::binary_compressed})
      for (const std::size_t count : {0U, 1U, 1000U}) {
        const PointCloud<float> cloud = full_cloud(count);
        write_pcd(folder / "a.pcd", cloud, encoding);
        const PointCloud<float> back = read_pcd(folder / "a.pcd");
        CHECK(same_bits(back.positions, cloud.positions));
        CHECK(same_bits(back.normals, cloud.normals));
        CHECK(back.intensities == cloud.intensities);
        CHECK(back.time_offsets == cloud.time_offsets);
      }
    PointCloud<float> bare;
    bare.positions.emplace_back(1.F, 2.F, 3.F);
    write_pcd(folder / "b.pcd", bare);
    CHECK(read_bytes(folder / "b.pcd") ==
          pcd_header("x y z", "4 4 4", "F F F", "1", "binary")
                  .insert(pcd_header("x y z", "4 4 4", "F F F", "1", "binary").find("WIDTH"), "COUNT 1 1 1\n") +
              little(1.F) + little(2.F) + little(3.F));
  }

  TEST_CASE("nanosecond times become offsets, absolute stamps do not") {
    const TemporaryFolder folder;
    write_bytes(folder / "t.pcd", pcd_header("x y z t", "4 4 4 4", "F F F U", "1", "ascii") + "0 0 0 50000000\n");
    CHECK(read_pcd(folder / "t.pcd").time_offsets == std::vector<float>{0.05F});
    write_bytes(folder / "t.pcd",
                pcd_header("x y z timestamp", "4 4 4 8", "F F F F", "1", "ascii") + "0 0 0 1567410201.7\n");
    CHECK(read_pcd(folder / "t.pcd").time_offsets.empty());
    CHECK(read_pcd_file(folder / "t.pcd").times == std::vector<double>{1567410201.7});
  }

  TEST_CASE("any truncation is refused") {
    const TemporaryFolder folder;
    for (const PcdEncoding encoding : {PcdEncoding::binary, PcdEncoding::binary_compressed}) {
      write_pcd(folder / "a.pcd", full_cloud(3), encoding);
      const std::string bytes = read_bytes(folder / "a.pcd");
      check_truncations(bytes, bytes.size(), pcd);
    }
    // Of text, the last number may lose digits unnoticed.
    const std::string text = pcd_header("x y z", "4 4 4", "F F F", "2", "ascii") + "1 2 3\n4 5 6\n";
    check_truncations(text, text.size() - 2, pcd);
  }

  TEST_CASE("damaged headers are named, and cost no memory") {
    CHECK(says(pcd_error(""), "no line that starts with DATA"));
    CHECK(says(pcd_error("ply\n"), "line 1, field keyword\n  found: 'ply'"));
    CHECK(says(pcd_error(pcd_header("x y intensity", "4 4 4", "F F F", "1", "ascii")), "no fields x, y and z"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4", "F F F", "1", "ascii")), "3 FIELDS, 2 SIZE, 3 TYPE"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 3", "F F F", "1", "ascii")), "TYPE 'F' and SIZE 3"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F Q", "1", "ascii")), "TYPE 'Q'"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "-1", "ascii")), "WIDTH -1"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "99999999999", "binary")), "WIDTH 99999999999"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "2147483647", "binary")), "0 bytes, where the header"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "2147483647", "ascii")), "0 bytes, where the header"));
    CHECK(
        says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "2147483647", "binary_compressed") + std::string(8, '\0')),
             "header asks for"));
    CHECK(says(pcd_error(with_counts(pcd_header("x y z", "4 4 4", "F F F", "1", "binary"), "1 1 999999999")), "COUNT"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "1", "zip")), "'zip'"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "1", "ascii") + "1 2 three\n"), "field z"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "1", "ascii") + "1 2,5 3\n"), "point"));
    CHECK(says(pcd_error(pcd_header("x y z", "4 4 4", "F F F", "1", "ascii") + "1 2 3 4\n"), "as many numbers"));
    std::string grid = pcd_header("x y z", "4 4 4", "F F F", "4", "ascii");
    CHECK(says(pcd_error(grid.replace(grid.find("HEIGHT 1"), 8, "HEIGHT 2")), "WIDTH * HEIGHT 8"));
  }

  TEST_CASE("real scans are read") {
    if (const auto path = real_data("hku_square_two_sessions/session1/Scans/000000.pcd")) {
      const PointCloud<float> cloud = read_pcd(*path);
      CHECK(cloud.size() == 3430);
      CHECK(cloud.has_intensities());
      CHECK(!cloud.has_times());
    }
    if (const auto path = real_data("nuscenes_scene/nuscenes_scene/clouds/0.pcd"))
      CHECK(read_pcd(*path).size() > 30'000);
  }
}

TEST_SUITE("io/ply") {
  const std::string head = "ply\nformat ascii 1.0\ncomment made by hand\n";

  TEST_CASE("ascii: vertices after another element, properties in any order, lists skipped") {
    const PointFile file =
        ply("ply\r\nformat ascii 1.0\r\nobj_info none\r\nelement face 2\r\nproperty list uchar int vertex_indices\r\n"
            "element vertex 2\r\nproperty double z\r\nproperty list uchar float extra\r\nproperty uchar red\r\n"
            "property float x\r\nproperty float y\r\nproperty float scalar_intensity\r\nend_header\r\n"
            "3 0 1 2\r\n0\r\n3.5 2 7 7 255 1 2 9\r\nnan 0 0 -1 -2 8\r\n");
    REQUIRE(file.cloud.size() == 2);
    CHECK(file.cloud.positions[0] == Eigen::Vector3f(1, 2, 3.5F));
    CHECK(file.cloud.intensities == std::vector<float>{9, 8});
    CHECK(std::isnan(file.cloud.positions[1].z()));
  }

  TEST_CASE("binary, little and big endian, behind faces and a fixed element") {
    for (const bool is_big : {false, true}) {
      const auto number = [&](auto value) { return is_big ? big(value) : little(value); };
      const std::string bytes =
          std::string("ply\nformat binary_") + (is_big ? "big" : "little") +
          "_endian 1.0\nelement camera 2\nproperty double a\nproperty uchar b\nelement face 1\n"
          "property list uchar int vertex_indices\nelement vertex 2\nproperty float x\nproperty short y\n"
          "property double z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty uint t\n"
          "element tail 1\nproperty list int float l\nend_header\n" +
          std::string(18, 'c') + number(std::uint8_t{3}) + std::string(12, 'f') + number(1.5F) +
          number(std::int16_t{-300}) + number(2.25) + number(0.F) + number(1.F) + number(0.F) +
          number(std::uint32_t{100'000}) + number(-1.F) + number(std::int16_t{7}) + number(1e-3) + number(0.F) +
          number(0.F) + number(-1.F) + number(std::uint32_t{4'000'000'000U}) + number(std::int32_t{2}) +
          std::string(8, 't');
      const PointFile file = ply(bytes);
      REQUIRE(file.cloud.size() == 2);
      CHECK(file.cloud.positions[0] == Eigen::Vector3f(1.5F, -300, 2.25F));
      CHECK(file.cloud.positions[1] == Eigen::Vector3f(-1, 7, 1e-3F));
      CHECK(file.cloud.normals[1] == Eigen::Vector3f(0, 0, -1));
      CHECK(file.times == std::vector<double>{100'000, 4'000'000'000});
      CHECK(file.integer_times);
      check_truncations(bytes, bytes.size() - 12, ply);
    }
  }

  TEST_CASE("what is written is read back, with colours, and byte for byte as stated") {
    const TemporaryFolder folder;
    for (const std::size_t count : {0U, 1U, 500U}) {
      const PointCloud<float> cloud = full_cloud(count);
      write_ply(folder / "a.ply", cloud, std::vector<Color>(count, Color{1, 2, 3}));
      const PointCloud<float> back = read_ply(folder / "a.ply");
      CHECK(same_bits(back.positions, cloud.positions));
      CHECK(same_bits(back.normals, cloud.normals));
      CHECK(back.intensities == cloud.intensities);
    }
    PointCloud<float> one;
    one.positions.emplace_back(1.F, 2.F, 3.F);
    write_ply(folder / "b.ply", one, std::vector<Color>{{255, 0, 7}});
    CHECK(
        read_bytes(folder / "b.ply") ==
        "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n" +
            little(1.F) + little(2.F) + little(3.F) + std::string("\xFF\x00\x07", 3));
    CHECK_THROWS_AS(write_ply(folder / "c.ply", one, std::vector<Color>(2)), std::invalid_argument);
    CHECK(!std::filesystem::exists(folder / "c.ply"));
  }

  TEST_CASE("points written one by one are the file of their cloud; another number of them leaves the old file") {
    const TemporaryFolder folder;
    for (const std::size_t count : {0U, 1U, 500U}) {
      PointCloud<float> cloud;
      cloud.positions = full_cloud(count).positions;
      const auto each = [&](const auto& take) {
        for (const Eigen::Vector3f& position : cloud.positions) take(position);
      };
      write_ply(folder / "whole.ply", cloud);
      write_ply(folder / "single.ply", count, each);
      CHECK(read_bytes(folder / "single.ply") == read_bytes(folder / "whole.ply"));
      CHECK_THROWS_AS(write_ply(folder / "single.ply", count + 1, each), std::invalid_argument);
      CHECK(read_bytes(folder / "single.ply") == read_bytes(folder / "whole.ply"));
    }
  }

  TEST_CASE("damaged headers and rows are named, and cost no memory") {
    const std::string xyz = "property float x\nproperty float y\nproperty float z\n";
    CHECK(says(ply_error(""), "no 'ply'"));
    CHECK(says(ply_error("ply\n"), "no end_header"));
    CHECK(says(ply_error("ply\nelement vertex 0\nend_header\n"), "no format"));
    CHECK(says(ply_error("ply\nformat zip 1.0\n"), "'zip'"));
    CHECK(says(ply_error(head + "property float x\n"), "before any element"));
    CHECK(says(ply_error(head + "element vertex 1\nproperty half x\n"), "'half'"));
    CHECK(says(ply_error(head + "element vertex -1\n"), "2^31"));
    CHECK(says(ply_error(head + "elephant vertex 1\n"), "'elephant'"));
    CHECK(says(ply_error(head + "end_header\n"), "no element named vertex"));
    CHECK(says(ply_error(head + "element vertex 1\nproperty float x\nend_header\n1\n"), "no properties x, y and z"));
    CHECK(says(ply_error(head + "element vertex 2147483647\n" + xyz + "end_header\n1 2 3\n"), "promises 2147483647"));
    CHECK(says(ply_error(head + "element vertex 2\n" + xyz + "end_header\n1 2 3\n"), "end of the file"));
    CHECK(says(ply_error(head + "element vertex 1\n" + xyz + "end_header\n1 2\n"), "line 9, field z"));
    CHECK(says(ply_error(head + "element vertex 1\n" + xyz + "end_header\n1 2 3 4\n"), "one row"));
    CHECK(says(ply_error("ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uint double l\n"
                         "element vertex 0\n" +
                         xyz + "end_header\n" + little(std::uint32_t{4'000'000'000U})),
               "promises 32000000000"));
    CHECK(says(ply_error("ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list int double l\n"
                         "element vertex 0\n" +
                         xyz + "end_header\n" + little(std::int32_t{-5})),
               "a list of -5"));
  }

  TEST_CASE("real scans are read") {
    if (const auto path = real_data("registration_pairs/small_gicp_outdoor/source.ply")) {
      const PointCloud<float> cloud = read_ply(*path);
      CHECK(cloud.size() == 69792);
      CHECK(cloud.has_intensities());
    }
    if (const auto path = real_data("registration_pairs/teaser_3dmatch/cloud_bin_0.ply"))
      CHECK(read_ply(*path).size() == 258'342);
  }
}

}  // namespace chainslam::test
