#include <doctest/doctest.h>
#include <malloc.h>
#include <png.h>
#include <sqlite3.h>
#include <zstd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <map>
#include <new>
#include <span>
#include <string>
#include <vector>

#include "chainslam/io/g2o.hpp"
#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/chunk_codec.hpp"
#include "datasets/dataset.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/imu_table.hpp"
#include "datasets/json_table.hpp"
#include "datasets/kitti_calibration.hpp"
#include "datasets/png_image.hpp"
#include "datasets/range_image.hpp"
#include "datasets/ros_bytes.hpp"
#include "datasets/ros_message.hpp"
#include "support/files.hpp"

// Files of at most 1 MB whose headers promise more than they hold: no reader may take 512 MB or a second for one. What
// `operator new` gives out is counted here, also where it is only reserved and so not seen in the process's size.

namespace {

std::atomic<std::size_t> memory_now{0}, memory_most{0};

void* counted(void* place) {
  if (place == nullptr) throw std::bad_alloc();
  const std::size_t now = memory_now += malloc_usable_size(place);
  for (std::size_t most = memory_most; now > most && !memory_most.compare_exchange_weak(most, now);) {
  }
  return place;
}

void release(void* place) {
  if (place != nullptr) memory_now -= malloc_usable_size(place);
  std::free(place);
}

}  // namespace

void* operator new(std::size_t size) { return counted(std::malloc(size == 0 ? 1 : size)); }
void* operator new[](std::size_t size) { return counted(std::malloc(size == 0 ? 1 : size)); }
void operator delete(void* place) noexcept { release(place); }
void operator delete[](void* place) noexcept { release(place); }
void operator delete(void* place, std::size_t) noexcept { release(place); }
void operator delete[](void* place, std::size_t) noexcept { release(place); }

namespace chainslam::test {
namespace {

using namespace datasets;

constexpr std::size_t megabyte = 1'000'000;

#if defined(__SANITIZE_ADDRESS__)
constexpr bool sanitized = true;
#elif defined(__has_feature)
constexpr bool sanitized = __has_feature(address_sanitizer);
#else
constexpr bool sanitized = false;
#endif
constexpr double seconds_allowed = sanitized ? 10 : 1;  // checked reads of a large JSON file alone take one

/// Has a file of these bytes read, which may be refused by an `IoError`.
void check_bounded_file(const std::filesystem::path& path, const std::string& bytes,
                        const std::function<void(const std::filesystem::path&)>& read) {
  CAPTURE(path.filename().string());
  REQUIRE(bytes.size() <= megabyte);
  write_bytes(path, bytes);
  const std::size_t before = memory_now;
  memory_most = before;
  const std::clock_t start = std::clock();  // the processor's time: other programs do not count
  const std::string error = io_error([&] { return read(path), 0; });
  const double seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  CAPTURE(error);
  CHECK(memory_most - before < 512'000'000);
  CHECK(seconds < seconds_allowed);
}

void check_bounded(const std::string& name, const std::string& bytes,
                   const std::function<void(const std::filesystem::path&)>& read) {
  const TemporaryFolder folder;
  check_bounded_file(folder / name, bytes, read);
}

void read_data(const std::filesystem::path& path) {
  const auto dataset = open_dataset(path);
  while (dataset->next()) {
  }
}

/// The text again and again, 1 MB of it.
std::string filled(const std::string& head, const std::string& text) {
  std::string bytes = head;
  bytes.reserve(megabyte);
  while (bytes.size() + text.size() <= megabyte) bytes += text;
  return bytes;
}

std::string pcd(const std::string& sizes, const std::string& types, const std::string& counts,
                const std::string& points, const std::string& encoding) {
  return "VERSION 0.7\nFIELDS x y z\nSIZE " + sizes + "\nTYPE " + types + "\nCOUNT " + counts + "\nWIDTH " + points +
         "\nHEIGHT 1\nPOINTS " + points + "\nDATA " + encoding + "\n";
}

/// A deflated image of zeros.
std::string zero_png(std::uint32_t width, std::uint32_t height) {
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = width;
  image.height = height;
  image.format = PNG_FORMAT_GRAY;
  const std::vector<std::uint8_t> samples(std::size_t{width} * height, 0);
  std::string bytes(samples.size() / 100 + 4096, '\0');
  png_alloc_size_t size = bytes.size();
  REQUIRE(png_image_write_to_memory(&image, bytes.data(), &size, 0, samples.data(), 0, nullptr) != 0);
  bytes.resize(size);
  return bytes;
}

std::string zstd_packed(const std::string& bytes) {
  std::string packed(ZSTD_compressBound(bytes.size()), '\0');
  packed.resize(ZSTD_compress(packed.data(), packed.size(), bytes.data(), bytes.size(), 3));
  return packed;
}

std::string mcap_bytes(char op, const std::string& content) {
  return op + little(static_cast<std::uint64_t>(content.size())) + content;
}

std::string mcap_text_of(const std::string& text) { return little(static_cast<std::uint32_t>(text.size())) + text; }

/// Chunks that each claim, and hold, so many zeros: nine of them are an empty record of the kind 0.
std::string mcap_bomb(std::size_t unpacked) {
  const std::string packed = zstd_packed(std::string(unpacked, '\0'));
  const std::string chunk = mcap_bytes(6, little(std::uint64_t{0}) + little(std::uint64_t{0}) +
                                              little(std::uint64_t{unpacked}) + little(std::uint32_t{0}) +
                                              mcap_text_of("zstd") + little(std::uint64_t{packed.size()}) + packed);
  return filled(std::string("\x89MCAP0\r\n", 8), chunk);
}

/// A PointCloud2 whose points share their bytes: one each.
std::string dense_cloud() {
  return point_cloud2(MessageBytes::cdr_little, 1, 0,
                      {{"x", 0, 2},
                       {"y", 0, 2},
                       {"z", 0, 2},
                       {"intensity", 0, 2},
                       {"time", 0, 2},
                       {"nx", 0, 2},
                       {"ny", 0, 2},
                       {"nz", 0, 2}},
                      1, std::string(900'000, '\1'));
}

}  // namespace

TEST_SUITE("datasets/bounded readers") {
  TEST_CASE("point files take no more than their bytes can hold") {
    const auto read_pcd_of = [](const std::filesystem::path& path) { static_cast<void>(read_pcd_file(path)); };
    const auto read_ply_of = [](const std::filesystem::path& path) { static_cast<void>(read_ply_file(path)); };
    for (const char* encoding : {"ascii", "binary", "binary_compressed"}) {
      CAPTURE(encoding);
      const std::string sizes = little(std::uint32_t{900'000}) + little(std::uint32_t{3'000'000'000U});
      for (const std::string& body : {std::string(), filled("", "1 2 3\n").substr(0, 900'000), sizes}) {
        check_bounded("count0.pcd", pcd("4 4 4", "F F F", "0 0 0", "2000000000", encoding) + body, read_pcd_of);
        check_bounded("many.pcd", pcd("1 1 1", "I I I", "1 1 1", "2147483647", encoding) + body, read_pcd_of);
        check_bounded("wide.pcd", pcd("8 8 8", "F F F", "65536 65536 65536", "2147483647", encoding) + body,
                      read_pcd_of);
        check_bounded("none.pcd", pcd("8 8 8", "F F F", "65536 65536 65536", "0", encoding) + body, read_pcd_of);
      }
    }
    // Bytes that unpack by the largest ratio of LZF, to the points that the header promises: 1 byte each.
    std::string packed = "\x01xx";
    while (packed.size() < 900'000) packed += std::string("\xE0\xFF\x00", 3);
    const std::uint32_t points = (2 + 264 * static_cast<std::uint32_t>(packed.size() / 3 - 1)) / 3;
    check_bounded("packed.pcd",
                  pcd("1 1 1", "I I I", "1 1 1", std::to_string(points), "binary_compressed") +
                      little(static_cast<std::uint32_t>(packed.size())) + little(3 * points) + packed,
                  read_pcd_of);
    std::string fields = "VERSION 0.7\nFIELDS", eights, kinds, counts;
    for (int i = 0; i < 90'000; ++i)
      fields += i < 3 ? std::string(" ") + "xyz"[i] : " a", eights += " 8", kinds += " F";
    for (int i = 0; i < 90'000; ++i) counts += " 65536";
    check_bounded("fields.pcd",
                  (fields + "\nSIZE" + eights + "\nTYPE" + kinds + "\nWIDTH 0\nHEIGHT 1\nDATA binary\n" + counts)
                      .substr(0, megabyte),
                  read_pcd_of);
    for (const char* format : {"ascii", "binary_little_endian", "binary_big_endian"})
      for (const char* element : {"element vertex 2147483647\nproperty uchar x\nproperty uchar y\nproperty uchar z\n",
                                  "element vertex 2147483647\nproperty list uchar uchar a\nproperty float x\n"
                                  "property float y\nproperty float z\n",
                                  "element face 2147483647\nelement vertex 0\nproperty float x\nproperty float y\n"
                                  "property float z\n"}) {
        const std::string head = std::string("ply\nformat ") + format + " 1.0\n" + element + "end_header\n";
        check_bounded("short.ply", head, read_ply_of);
        check_bounded("long.ply", filled(head, "1 1 1 1\n"), read_ply_of);
      }
  }

  TEST_CASE("images take no more than a range image's size") {
    const auto read_image = [](const std::filesystem::path& path) { static_cast<void>(read_gray_png(path)); };
    check_bounded("huge.png", zero_png(8192, 4096), read_image);
    check_bounded("large.png", zero_png(2048, 2048), read_image);
    const TemporaryFolder folder;
    write_bytes(folder / "huge.png", zero_png(8192, 4096));
    CHECK(says(io_error([&] { return read_gray_png(folder / "huge.png").width; }), "8192 x 4096 pixels"));
    write_bytes(folder / "large.png", zero_png(2048, 2048));
    CHECK(read_gray_png(folder / "large.png").pixels.size() == 2048 * 2048);
    const auto read_geometry = [](const std::filesystem::path& path) {
      static_cast<void>(read_range_image_geometry(path));
    };
    for (const char* text : {"2e9 2e9 0 360 1 2\n", "65536 4096 0 360 1 2\n", "1e308 1 0 360 1\n"})
      check_bounded("img.cfg", text, read_geometry);
    check_bounded("img.cfg", filled("500 100000 4 0 360 ", "1 ").substr(0, megabyte), read_geometry);
  }

  TEST_CASE("recordings of packed chunks do not unpack to more than 64 times their size") {
    check_bounded("one.mcap", mcap_bomb(200'000'000), read_data);
    check_bounded("many.mcap", mcap_bomb(10'000'000), read_data);
    check_bounded("small.mcap", mcap_bomb(100'000), read_data);
    const std::string zeros(8'000'000, '\0'), packed = zstd_packed(zeros);
    ChunkUnpacker unpacker;
    const auto unpack = [&](const std::string& bytes, std::size_t claimed) {
      return unpacker.unpack(Compression::zstd, std::as_bytes(std::span(bytes)), claimed);
    };
    CHECK(unpack(packed, zeros.size()).fault.empty());
    CHECK(unpack(packed, zeros.size()).fault.empty());
    CHECK(says(unpack(packed, zeros.size()).fault, "64 times as many"));
    std::string sensor;  // what hardly packs never comes near
    for (std::uint32_t i = 0; i < 1'000'000; ++i) sensor += static_cast<char>(i * 2654435761U >> 24);
    const std::string hardly = zstd_packed(sensor);
    for (int i = 0; i < 40; ++i) CHECK(unpack(hardly, sensor.size()).fault.empty());
  }

  TEST_CASE("rows without points take no time, however many there are") {
    std::string rows = point_cloud2(MessageBytes::cdr_little, 1, 0, {{"x", 0, 7}, {"y", 4, 7}, {"z", 8, 7}}, 12, "");
    constexpr std::size_t height = 24;  // behind encapsulation, stamp and "lidar"
    REQUIRE(rows.substr(height, 8) == little(std::uint32_t{1}) + little(std::uint32_t{0}));
    rows.replace(height, 4, 4, '\xFF');
    const auto start = std::chrono::steady_clock::now();
    const RosCloud cloud = decode_point_cloud2(MessageReader(std::as_bytes(std::span(rows)), MessageEncoding::cdr));
    CHECK(cloud.points.cloud.empty());
    CHECK(std::chrono::steady_clock::now() - start < std::chrono::milliseconds(100));
  }

  TEST_CASE("points that share their bytes are bounded in number") {
    const std::string cloud = dense_cloud();
    const std::string bytes = std::string("\x89MCAP0\r\n", 8) +
                              mcap_bytes(3, little(std::uint16_t{1}) + mcap_text_of("sensor_msgs/msg/PointCloud2") +
                                                mcap_text_of("") + mcap_text_of("")) +
                              mcap_bytes(4, little(std::uint16_t{1}) + little(std::uint16_t{1}) + mcap_text_of("/p") +
                                                mcap_text_of("cdr") + little(std::uint32_t{0})) +
                              mcap_bytes(5, little(std::uint16_t{1}) + std::string(20, '\0') + cloud);
    check_bounded("dense.mcap", bytes, read_data);
    const std::string huge = point_cloud2(MessageBytes::cdr_little, 1, 0, {{"x", 0, 2}, {"y", 0, 2}, {"z", 0, 2}}, 1,
                                          std::string(5'000'000, '\1'));
    CHECK_THROWS_WITH_AS(
        static_cast<void>(decode_point_cloud2(MessageReader(std::as_bytes(std::span(huge)), MessageEncoding::cdr))),
        "1 rows of 5000000 points; 2^22 points are the most", MessageError);
  }

  TEST_CASE("databases hold no more rows and bytes than their file") {
    const TemporaryFolder folder;
    const auto made = [&](const std::vector<const char*>& statements) {
      std::filesystem::remove(folder / "a.db3");
      sqlite3* database = nullptr;
      REQUIRE(sqlite3_open((folder / "a.db3").c_str(), &database) == SQLITE_OK);
      for (const char* statement : statements)
        REQUIRE(sqlite3_exec(database, statement, nullptr, nullptr, nullptr) == SQLITE_OK);
      sqlite3_close(database);
      return read_bytes(folder / "a.db3");
    };
    const char* topics = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)";
    const char* rows =
        "INSERT INTO messages(topic_id, timestamp) WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n "
        "LIMIT "
        "20000) SELECT 1, i FROM n";
    for (const char* value : {"zeroblob(250000000)", "zeroblob(300000)"}) {
      const std::string table =
          std::string(
              "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB "
              "GENERATED ALWAYS AS (") +
          value + "))";
      check_bounded(
          "zeros.db3",
          made({topics, "INSERT INTO topics VALUES(1, '/a', 'sensor_msgs/msg/Imu', 'cdr')", table.c_str(), rows}),
          read_data);
    }
    check_bounded(
        "names.db3",
        made({"CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT GENERATED ALWAYS AS "
              "(hex(zeroblob(300000))), type TEXT, serialization_format TEXT)",
              "INSERT INTO topics(type, serialization_format) WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL "
              "SELECT i + 1 FROM n LIMIT 10000) SELECT 'a', 'cdr' FROM n",
              "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"}),
        read_data);
  }

  TEST_CASE("packets that never turn, and whose time stands still, do not become one sweep") {
    std::string header;
    for (int i = 0; i < 4; ++i) header += little(std::uint16_t{44444});
    const std::string hits(8 * 384, '\0');
    const auto packet = [&](std::uint64_t time, std::uint32_t claimed) {
      return header + little(claimed) + little(time) + std::string(4, '\0') + hits;
    };
    const auto read_folder = [](const std::filesystem::path& path) { read_data(path.parent_path()); };
    check_bounded("velodyne_hits.bin", filled("", packet(0, 384)), read_folder);
    check_bounded("velodyne_hits.bin", packet(1, 384) + packet(2, 4'000'000'000U), read_folder);
    check_bounded("velodyne_hits.bin", filled("", packet(4'294'967'295'000'000U, 384)), read_folder);
    check_bounded("1326030975000000.bin", filled("", hits),
                  [](const std::filesystem::path& path) { static_cast<void>(read_kitti_bin(path)); });
  }

  TEST_CASE("tables and texts of one line, of empty fields and of deep brackets") {
    using Read = std::function<void(const std::filesystem::path&)>;
    const std::vector<std::pair<std::string, Read>> readers{
        {"a.tum", [](const auto& p) { static_cast<void>(read_tum(p)); }},
        {"poses.txt", [](const auto& p) { static_cast<void>(read_kitti_poses(p)); }},
        {"data.csv", [](const auto& p) { static_cast<void>(read_euroc_csv(p)); }},
        {"a.g2o", [](const auto& p) { static_cast<void>(read_g2o(p)); }},
        {"times.txt", [](const auto& p) { static_cast<void>(read_stamps(p)); }},
        {"imu.csv", [](const auto& p) { static_cast<void>(imu_columns(p)); }},
        {"calib.txt", [](const auto& p) { static_cast<void>(KittiCalibration(p).matrix("Tr")); }},
        {"T_body_lidar.txt", [](const auto& p) { static_cast<void>(find_extrinsic({p.parent_path()})); }},
        {"img.cfg", [](const auto& p) { static_cast<void>(read_range_image_geometry(p)); }},
        {"sample.json", [](const auto& p) { read_json_table(p, [](const JsonRow&) {}); }},
        {"a.pcd", [](const auto& p) { static_cast<void>(read_pcd_file(p)); }},
        {"a.ply", [](const auto& p) { static_cast<void>(read_ply_file(p)); }}};
    const std::vector<std::string> texts{filled("", "["),
                                         filled("", "{\"a\":"),
                                         filled("", "1 "),
                                         filled("", ","),
                                         filled("", "1\n"),
                                         filled("", "9"),
                                         filled("", "1.0e400 "),
                                         filled("", "0 0 0 1\n"),
                                         filled("", "\n"),
                                         filled("Tr: ", "1e-320 "),
                                         filled("", "EDGE_SE2 1 2\n"),
                                         filled("[{\"a\":[", "1,"),
                                         filled("ply\nformat ascii 1.0\n", "element a 1\n"),
                                         filled("FIELDS ", "x ")};
    for (const auto& [name, read] : readers)
      for (const std::string& text : texts) check_bounded(name, text, read);
  }

  TEST_CASE("chunks of maps and of journals take what their bytes hold, whatever they claim under right checksums") {
    const auto read_both = [](const std::filesystem::path& path) {
      static_cast<void>(io_error([&] { return load_map(path, {.recover = true}).report.complete; }));
      static_cast<void>(io_error([&] { return load_map(path).report.complete; }));
      static_cast<void>(read_input_journal(path));
    };
    const auto bytes_of = [](std::uint16_t type, std::uint32_t codec, std::uint32_t count, std::uint64_t raw,
                             const std::string& payload) {
      const auto* text = reinterpret_cast<const std::byte*>(payload.data());
      std::vector<std::byte> bytes;
      detail::append_map_header(bytes, {.file_id = 1});
      detail::append_chunk(bytes, {.type = static_cast<std::uint16_t>(detail::ChunkType::parameters), .file_id = 1},
                           {});
      detail::append_chunk(
          bytes, {.type = type, .codec = codec, .count = count, .raw_bytes = raw, .sequence = 1, .file_id = 1},
          std::vector<std::byte>(text, text + payload.size()));
      detail::append_chunk(
          bytes,
          {.type = static_cast<std::uint16_t>(detail::ChunkType::commit), .count = 1, .sequence = 2, .file_id = 1},
          std::vector<std::byte>(32));
      return std::string(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    };
    const std::string zeros(900'000, '\0'), packed = zstd_packed(std::string(5'000'000, '\0')), ones(64, '\xFF');
    for (std::uint16_t type = 1; type <= 15; ++type)
      for (const std::uint16_t flag : {std::uint16_t{0}, detail::critical}) {
        if (!detail::is_known_chunk(type | flag)) continue;
        CAPTURE(type);
        const auto kind = static_cast<std::uint16_t>(type | flag);
        check_bounded("a.cslam", bytes_of(kind, 0, 0xFFFF'FFFFU, zeros.size(), zeros), read_both);
        check_bounded("a.cslam", bytes_of(kind, 0, 1'000'000, ones.size(), ones), read_both);
        check_bounded("a.cslam", bytes_of(kind, 1, 0xFFFF'FFFFU, std::uint64_t{1} << 28, packed), read_both);
        check_bounded("a.cslam", bytes_of(kind, 1, 2'000'000'000, 6 * packed.size(), packed), read_both);
      }
  }

  TEST_CASE("data sets of several files, one of which is large") {
    const std::string row = "1 0 0 0 0 1 0 0 0 0 1 0\n",
                      cloud = pcd("4 4 4", "F F F", "1 1 1", "1", "ascii") + "1 2 3\n";
    const std::map<std::string, std::string> keyframes{
        {"Scans/0.pcd", cloud}, {"times.txt", "1\n"}, {"odom_poses.txt", row}, {"gnss.txt", "48 9 100 1\n"}};
    const std::map<std::string, std::string> images{{"data/0.png", zero_png(2, 2)},
                                                    {"velodyne_config.txt", "500 4 2 180 -180 -30 0\n"},
                                                    {"timestamps_start.txt", "2011-07-14 13:52:31.1\n"},
                                                    {"timestamps_end.txt", "2011-07-14 13:52:31.2\n"}};
    const std::map<std::string, std::string> tables{{"velodyne_sync/1326030975000000.bin", std::string(8, '\0')},
                                                    {"ms25.csv", ""},
                                                    {"gps.csv", ""},
                                                    {"gps_rtk.csv", ""},
                                                    {"groundtruth.csv", ""}};
    std::map<std::string, std::string> recorded = keyframes;
    recorded["odometry.json"] = recorded["frames.csv"] = recorded["fixes.csv"] = "";
    const std::map<std::string, std::string> raw{{"velodyne_points/timestamps_start.txt", "2011-09-26 13:02:25.0\n"},
                                                 {"velodyne_points/timestamps_end.txt", "2011-09-26 13:02:25.1\n"},
                                                 {"velodyne_points/data/0.bin", std::string(16, '\0')},
                                                 {"oxts/timestamps.txt", "2011-09-26 13:02:25.0\n"}};
    const std::map<std::string, std::string> mulran{
        {"Ouster/1.bin", std::string(16, '\0')}, {"xsens_imu.csv", ""}, {"gps.csv", ""}, {"global_pose.csv", ""}};
    const std::map<std::string, std::string> scenes{
        {"v1.0/scene.json", "[]"},       {"v1.0/sample.json", "[]"},
        {"v1.0/sensor.json", "[]"},      {"v1.0/calibrated_sensor.json", "[]"},
        {"v1.0/sample_data.json", "[]"}, {"v1.0/ego_pose.json", "[]"}};
    for (const auto& set : {keyframes, images, tables, recorded, raw, mulran, scenes})
      for (const auto& [name, text] : set)
        for (const std::string& large :
             {filled("", row), filled("", "1,2,3,4,5,6,7,8,9,10,11,12\n"), filled("", "9"), filled("", "["),
              filled("[", "{\"token\": \"a\", \"name\": \"b\"},"), filled("", "\n"), filled(text, "1\n")}) {
          const TemporaryFolder folder;
          for (const auto& [other, bytes] : set)
            if (other != name) write_bytes(folder / other, bytes);
          check_bounded_file(folder / name, large, [&](const auto&) { read_data(folder.path()); });
        }
  }
}

}  // namespace chainslam::test
