#include <doctest/doctest.h>
#include <sqlite3.h>

#include "datasets/dataset.hpp"
#include "datasets/inspect.hpp"
#include "datasets/ros_bytes.hpp"
#include "support/files.hpp"

namespace chainslam::test {
namespace {

using namespace datasets;

// ---- MCAP, record by record as mcap.dev/spec lays them out ----

const std::string mcap_magic_bytes("\x89MCAP0\r\n", 8);

std::string mcap_text(const std::string& text) { return little(static_cast<std::uint32_t>(text.size())) + text; }

std::string mcap_record(char op, const std::string& content) {
  return op + little(static_cast<std::uint64_t>(content.size())) + content;
}

std::string schema_and_channel(std::uint16_t id, const std::string& topic, const std::string& type,
                               const std::string& encoding = "cdr") {
  return mcap_record(3, little(id) + mcap_text(type) + mcap_text("ros2msg") + mcap_text("")) +
         mcap_record(4, little(id) + little(id) + mcap_text(topic) + mcap_text(encoding) + little(std::uint32_t{0}));
}

std::string mcap_message_record(std::uint16_t channel, std::uint64_t time, const std::string& data) {
  return mcap_record(5, little(channel) + little(std::uint32_t{0}) + little(time) + little(time) + data);
}

/// A Zstandard frame of one stored block (RFC 8878, sections 3.1.1.1 and 3.1.1.2).
std::string zstd_frame(const std::string& bytes) {
  const auto size = static_cast<std::uint32_t>(bytes.size());
  return "\x28\xB5\x2F\xFD\xA0" + little(size) + little(size << 3 | 1U).substr(0, 3) + bytes;
}

std::string mcap_chunk_record(const std::string& compression, const std::string& packed, std::size_t size,
                              std::uint32_t crc = 0) {
  return mcap_record(6, little(std::uint64_t{0}) + little(std::uint64_t{0}) + little(std::uint64_t{size}) +
                            little(crc) + mcap_text(compression) + little(std::uint64_t{packed.size()}) + packed);
}

std::string mcap_of(const std::string& records) {
  return mcap_magic_bytes + mcap_record(1, mcap_text("ros2") + mcap_text("by hand")) + records +
         mcap_record(15, little(std::uint32_t{0})) + mcap_record(2, std::string(20, '\0')) + mcap_magic_bytes;
}

constexpr auto cdr = MessageBytes::cdr_little;
constexpr std::uint32_t mcap_start = 1'600'000'000;

std::string channels() {
  return schema_and_channel(1, "/imu", "sensor_msgs/msg/Imu") +
         schema_and_channel(2, "/livox/lidar", "livox_ros_driver2/msg/CustomMsg") +
         schema_and_channel(3, "/fix", "sensor_msgs/msg/NavSatFix") +
         schema_and_channel(4, "/pose", "foxglove.Pose", "protobuf");
}

/// Three samples, a scan of which the points end 0.1 s after them, and a fix.
std::string moments(std::uint32_t second) {
  const std::uint64_t time = second * 1'000'000'000ULL;
  std::string records;
  for (std::uint32_t i = 0; i < 3; ++i)
    records += mcap_message_record(1, time + i, imu_message(cdr, second, i * 10'000'000));
  return records + mcap_message_record(2, time + 5, livox_message(cdr, second, time)) +
         mcap_message_record(3, time + 6, fix_message(cdr, second)) + mcap_message_record(4, time + 7, "other");
}

/// A database made by SQLite's own statements, as rosbag2 makes it.
void write_db3(const std::filesystem::path& path, int messages) {
  sqlite3* database = nullptr;
  REQUIRE(sqlite3_open(path.c_str(), &database) == SQLITE_OK);
  const auto run = [&](const char* statement) {
    REQUIRE(sqlite3_exec(database, statement, nullptr, nullptr, nullptr) == SQLITE_OK);
  };
  run("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
      " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)");
  run("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
      " data BLOB NOT NULL)");
  run("INSERT INTO topics VALUES(1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr', '')");
  run("BEGIN");
  for (int i = 0; i < messages; ++i) {
    const auto second = mcap_start + static_cast<std::uint32_t>(i);
    const std::string data = velodyne_cloud(MessageBytes::cdr_big, second, 0);
    sqlite3_stmt* insert = nullptr;
    REQUIRE(sqlite3_prepare_v2(database, "INSERT INTO messages VALUES(NULL, ?, ?, ?)", -1, &insert, nullptr) ==
            SQLITE_OK);
    sqlite3_bind_int(insert, 1, i == 1 ? 9 : 1);  // the second message's topic is not described
    sqlite3_bind_int64(insert, 2, second * 1'000'000'000LL);
    sqlite3_bind_blob(insert, 3, data.data(), static_cast<int>(data.size()), SQLITE_TRANSIENT);
    REQUIRE(sqlite3_step(insert) == SQLITE_DONE);
    sqlite3_finalize(insert);
  }
  run("COMMIT");
  sqlite3_close(database);
}

std::vector<std::string> warnings_of(const std::filesystem::path& path, std::size_t& count) {
  const auto dataset = open_dataset(path);
  count = packets_of(*dataset).size();
  return dataset->info().warnings;
}

}  // namespace

TEST_SUITE("datasets/mcap") {
  TEST_CASE("chunks of every packing, and messages without a chunk, give the same packets") {
    const std::string first = channels() + moments(mcap_start), second = moments(mcap_start + 1);
    for (const std::string packing : {"", "lz4", "zstd", "plain"}) {
      CAPTURE(packing);
      const auto chunk = [&](const std::string& records) {
        if (packing == "plain") return records;
        return mcap_chunk_record(packing,
                                 packing.empty()    ? records
                                 : packing == "lz4" ? lz4_frame(records)
                                                    : zstd_frame(records),
                                 records.size());
      };
      const TemporaryFolder folder;
      write_bytes(folder / "run/run_0.mcap", mcap_of(chunk(first) + mcap_record(7, "index") + chunk(second)));
      write_bytes(folder / "run/metadata.yaml", "not needed");
      const auto dataset = open_dataset(folder.path());
      const auto packets = packets_of(*dataset);
      CHECK(dataset->info().warnings.size() == 1);  // no extrinsic is stated
      CHECK(counts_of(packets) == std::array<int, 3>{6, 2, 2});
      for (std::size_t i = 1; i < packets.size(); ++i) CHECK(available_at(packets[i - 1]) <= available_at(packets[i]));
      REQUIRE(packets[4].index() == 1);  // at its end
      CHECK(std::get<LidarScan>(packets[4]).cloud.size() == 10);
      CHECK(any_says(dataset->info().notes, "/pose (foxglove.Pose as protobuf)"));
    }
  }

  TEST_CASE("cut short at any byte, a file gives what is whole and says what is lost") {
    const std::string first = channels() + moments(mcap_start), second = moments(mcap_start + 1),
                      third = moments(mcap_start + 2);
    const std::string whole = mcap_of(mcap_chunk_record("zstd", zstd_frame(first), first.size()) + second +
                                      mcap_chunk_record("", third, third.size()));
    const std::size_t complete = whole.size() - 8 - 29 - 13;  // magic number, footer, end of the data
    const TemporaryFolder folder;
    std::size_t last = 0, refused = 0;
    for (std::size_t n = 0; n <= whole.size(); n += n + 200 > whole.size() ? 1 : 5) {
      write_bytes(folder / "a.mcap", whole.substr(0, n));
      std::size_t count = 0;
      std::vector<std::string> warnings;
      const std::string error = io_error([&] { return (warnings = warnings_of(folder / "a.mcap", count)).size(); });
      if (count == 0) {
        if (!error.empty()) CHECK(says(error, "byte"));
        refused += error.empty() ? 0 : 1;
        continue;
      }
      CHECK(count >= last);
      last = count;
      CHECK(any_says(warnings, "a.mcap, byte") == (n < complete + 9));
    }
    CHECK(last == 15);
    CHECK(refused > 10);
  }

  TEST_CASE("a damaged chunk costs itself alone, and one that fails its CRC is not believed") {
    const std::string first = channels() + moments(mcap_start), second = channels() + moments(mcap_start + 1);
    std::size_t count = 0;
    const TemporaryFolder folder;
    write_bytes(folder / "a.mcap", mcap_of(mcap_chunk_record("", first, first.size(), 77) +
                                           mcap_chunk_record("lz4", second, second.size()) +
                                           mcap_chunk_record("", second, second.size())));
    const auto warnings = warnings_of(folder / "a.mcap", count);
    CHECK(count == 5);
    CHECK(any_says(warnings, "a.mcap, byte 36: a chunk that does not unpack (its CRC is another); it is left out"));
    CHECK(any_says(warnings, "a chunk that does not unpack (lz4: ERROR_frameType_unknown)"));

    // CRC-32 of "123456789" is CBF43926 (zip, PNG).
    write_bytes(folder / "b.mcap",
                mcap_of(mcap_chunk_record("", "123456789", 9, 0xCBF43926U) + channels() + moments(mcap_start)));
    CHECK(!any_says(warnings_of(folder / "b.mcap", count), "CRC"));

    write_bytes(folder / "c.mcap", mcap_of(mcap_chunk_record("zstd", zstd_frame("x"), std::size_t{1} << 60)));
    CHECK(says(io_error([&] { return warnings_of(folder / "c.mcap", count).size(); }), "256 MiB are the most"));
    write_bytes(folder / "c.mcap", "MCAP");
    CHECK(says(io_error([&] { return warnings_of(folder / "c.mcap", count).size(); }), "no MCAP magic number"));
  }
}

TEST_SUITE("datasets/db3") {
  TEST_CASE("rosbag2's databases are read; cut short, they give what is whole or are refused") {
    const TemporaryFolder folder;
    write_db3(folder / "a.db3", 100);
    const auto dataset = open_dataset(folder / "a.db3");
    const auto packets = packets_of(*dataset);
    CHECK(packets.size() == 99);
    CHECK(std::get<LidarScan>(packets[1]).time.nanoseconds() == (mcap_start + 2) * 1'000'000'000LL);
    CHECK(any_says(dataset->info().warnings, "a.db3, row 2: no topic"));
    CHECK(says(to_text(inspect(folder / "a.db3")), "data set, ros"));

    const std::string whole = read_bytes(folder / "a.db3");
    std::size_t last = 0, refused = 0;
    for (std::size_t n = 0; n < whole.size(); n += 1024) {
      write_bytes(folder / "b.db3", whole.substr(0, n));
      std::size_t count = 0;
      std::vector<std::string> warnings;
      const std::string error = io_error([&] { return (warnings = warnings_of(folder / "b.db3", count)).size(); });
      CHECK(count <= 99);
      if (error.empty()) CHECK(any_says(warnings, "b.db3, "));
      if (!error.empty()) CHECK(says(error, "b.db3"));
      refused += error.empty() ? 0 : 1;
      last = std::max(last, count);
    }
    CHECK(refused > 0);
    CHECK(last > 50);
  }
}

}  // namespace chainslam::test
