#include <bzlib.h>
#include <doctest/doctest.h>

#include <cmath>

#include "datasets/dataset.hpp"
#include "datasets/inspect.hpp"
#include "datasets/ros_bytes.hpp"
#include "datasets/ros_message.hpp"
#include "datasets/transform_tree.hpp"
#include "support/files.hpp"

namespace chainslam::test {
namespace {

using namespace datasets;

std::span<const std::byte> bytes_of(const std::string& text) { return std::as_bytes(std::span(text)); }

// ---- ROS 1 bags, record by record as wiki.ros.org/Bags/Format/2.0 lays them out ----

std::string sized(const std::string& bytes) { return little(static_cast<std::uint32_t>(bytes.size())) + bytes; }

std::string bag_record(const std::vector<std::string>& fields, const std::string& data) {
  std::string header;
  for (const std::string& field : fields) header += sized(field);
  return sized(header) + sized(data);
}

std::string connection_record(std::uint32_t number, const std::string& topic, const std::string& type) {
  return bag_record({"op=\x07", "conn=" + little(number), "topic=" + topic},
                    sized("topic=" + topic) + sized("type=" + type) + sized("md5sum=*") + sized("message_definition=") +
                        sized("latching=0"));
}

std::string message_record(std::uint32_t connection, std::uint32_t seconds, std::uint32_t nanoseconds,
                           const std::string& data) {
  return bag_record({"op=\x02", "conn=" + little(connection), "time=" + little(seconds) + little(nanoseconds)}, data);
}

std::string chunk_record(const std::string& compression, const std::string& packed, std::size_t size) {
  return bag_record({"op=\x05", "compression=" + compression, "size=" + little(static_cast<std::uint32_t>(size))},
                    packed) +
         bag_record({"op=\x04", "ver=" + little(std::uint32_t{1}), "conn=" + little(std::uint32_t{0}),
                     "count=" + little(std::uint32_t{0})},
                    "");
}

std::string bag_of(const std::string& records) {
  // The index would follow the records.
  const std::string header =
      bag_record({"op=\x03", "index_pos=" + little(std::uint64_t{13 + 4104 + records.size()}),
                  "conn_count=" + little(std::uint32_t{3}), "chunk_count=" + little(std::uint32_t{2})},
                 std::string(4027, ' '));
  REQUIRE(header.size() == 4104);
  return "#ROSBAG V2.0\n" + header + records;
}

std::string bz2(std::string bytes) {
  std::string packed(bytes.size() + 1000, '\0');
  auto size = static_cast<unsigned>(packed.size());
  REQUIRE(BZ2_bzBuffToBuffCompress(packed.data(), &size, bytes.data(), static_cast<unsigned>(bytes.size()), 9, 0, 0) ==
          BZ_OK);
  return packed.substr(0, size);
}

constexpr auto ros1 = MessageBytes::ros1;

/// What one chunk holds: the connections, then 20 samples 10 ms apart, two scans and a fix, the scans recorded late.
std::string drive(std::uint32_t second) {
  std::string records = connection_record(0, "/imu/data", "sensor_msgs/Imu") +
                        connection_record(1, "/points", "sensor_msgs/PointCloud2") +
                        connection_record(2, "/fix", "sensor_msgs/NavSatFix") +
                        connection_record(3, "/camera", "sensor_msgs/Image");
  for (std::uint32_t i = 0; i < 20; ++i) {
    const std::uint32_t at = i * 10'000'000;
    records += message_record(0, second, at, imu_message(ros1, second, at));
    if (i == 12) records += message_record(1, second, at, velodyne_cloud(ros1, second, 0));
    if (i == 19) records += message_record(1, second, at + 5'000'000, velodyne_cloud(ros1, second, 100'000'000));
  }
  return records + message_record(2, second, 195'000'000, fix_message(ros1, second)) +
         message_record(3, second, 196'000'000, "no image");
}

constexpr std::uint32_t t0 = 1'600'000'000;

/// The first scan of a bag that holds one cloud; `sentences` gets what was said of it.
LidarScan only_scan(const std::string& type, const std::string& message,
                    std::vector<std::string>* sentences = nullptr) {
  const TemporaryFolder folder;
  write_bytes(folder / "a.bag", bag_of(connection_record(0, "/p", type) + message_record(0, t0, 0, message)));
  const auto dataset = open_dataset(folder / "a.bag");
  auto packets = packets_of(*dataset);
  REQUIRE(packets.size() == 1);
  if (sentences != nullptr) {
    *sentences = dataset->info().notes;
    sentences->insert(sentences->end(), dataset->info().warnings.begin(), dataset->info().warnings.end());
  }
  return std::get<LidarScan>(std::move(packets[0]));
}

}  // namespace

TEST_SUITE("datasets/ros_message") {
  TEST_CASE("a message reads alike as ROS 1's bytes and as CDR in both orders") {
    for (const auto layout : {MessageBytes::ros1, MessageBytes::cdr_little, MessageBytes::cdr_big}) {
      const auto encoding = layout == ros1 ? MessageEncoding::ros1 : MessageEncoding::cdr;
      const std::string points = velodyne_cloud(layout, t0, 250'000'000);
      const RosCloud cloud = decode_point_cloud2({bytes_of(points), encoding});
      CHECK(cloud.header.stamp.nanoseconds() == 1'600'000'000'250'000'000);
      CHECK(cloud.header.frame == "lidar");
      CHECK(cloud.fields == "x f32, y f32, z f32, intensity f32, ring u16, time f32");
      REQUIRE(cloud.points.cloud.size() == 11);
      CHECK(cloud.points.cloud.positions[7] == Eigen::Vector3f(7, 2, -1.5F));
      CHECK(cloud.points.cloud.intensities[7] == 70);
      CHECK(cloud.points.times[7] == doctest::Approx(0.07));

      const std::string sample = imu_message(layout, t0, 1);
      const RosImu imu = decode_imu({bytes_of(sample), encoding});
      CHECK(imu.sample.time.nanoseconds() == 1'600'000'000'000'000'001);
      CHECK(imu.sample.gyro == Eigen::Vector3d(0, 0, 0.25));
      CHECK(imu.sample.accel == Eigen::Vector3d(0, 0, 9.75));

      const std::string position = fix_message(layout, t0, 2);
      const RosFix fix = decode_fix({bytes_of(position), encoding});
      CHECK(fix.status == 2);
      CHECK(fix.position.latitude_deg == 42.293);
      CHECK(fix.position.altitude == 270);
      REQUIRE(fix.deviation);
      CHECK(fix.deviation->horizontal == 0.5);
      CHECK(fix.deviation->vertical == 2);

      const std::string livox = livox_message(layout, t0, 1'600'000'000'000'000'007);
      const RosCloud avia = decode_livox({bytes_of(livox), encoding});
      CHECK(avia.header.stamp.nanoseconds() == 1'600'000'000'000'000'007);
      REQUIRE(avia.points.cloud.size() == 10);
      CHECK(avia.noise == 1);
      CHECK(avia.points.cloud.positions[5] == Eigen::Vector3f(6, 2, 3));
      CHECK(avia.points.cloud.intensities[5] == 60);
      CHECK(avia.points.times[5] == 60e6);

      // Cut short at any byte, a message is refused; only PointCloud2 and the rest of a fix's or a sample's tail may
      // go.
      const auto refused = [&](const std::string& whole, auto decode) {
        std::size_t first_good = whole.size() + 1;
        for (std::size_t n = 0; n <= whole.size(); ++n) try {
            static_cast<void>(decode(MessageReader(bytes_of(whole).first(n), encoding)));
            first_good = std::min(first_good, n);
          } catch (const MessageError& error) {
            CHECK(n < first_good);
            CHECK(says(error.what(), "message"));
          }
        return whole.size() - first_good;
      };
      CHECK(refused(points, decode_point_cloud2) == 1);  // is_dense is not needed
      CHECK(refused(sample, decode_imu) == 72);          // nor the last covariance
      CHECK(refused(position, decode_fix) == 0);
      CHECK(refused(livox, decode_livox) == 0);
    }
  }

  TEST_CASE("sizes that do not fit together are refused before memory is taken") {
    const std::vector<FieldOf> fields{{"x", 0, 7}, {"y", 4, 7}, {"z", 8, 7}};
    const auto error = [](const std::string& message) {
      try {
        static_cast<void>(decode_point_cloud2({bytes_of(message), MessageEncoding::ros1}));
      } catch (const MessageError& e) {
        return std::string(e.what());
      }
      return std::string();
    };
    const std::string good = point_cloud2(ros1, t0, 0, fields, 12, std::string(24, '\0'));
    CHECK(error(good).empty());
    std::string bad = good;
    const std::size_t height = 4 + 8 + 4 + 5;
    bad[height + 3] = '\x7F';  // two thousand million rows
    CHECK(says(error(bad), "24 bytes of points for"));
    bad = good;
    bad[height + 7] = '\x7F';
    CHECK(says(error(bad), "24 bytes of points for"));
    bad = good;
    bad[height + 11] = '\x7F';
    CHECK(says(error(bad), "the message promises"));
    CHECK(says(error(point_cloud2(ros1, t0, 0, {{"x", 0, 7}, {"y", 4, 7}, {"z", 9, 7}}, 12, std::string(24, '\0'))),
               "field z at byte 9 of points of 12 bytes"));
    CHECK(says(error(point_cloud2(ros1, t0, 0, {{"x", 0, 7}, {"y", 4, 7}, {"z", 8, 9}}, 12, std::string(24, '\0'))),
               "field z of the unknown datatype 9"));
    CHECK(says(error(point_cloud2(ros1, t0, 0, {{"x", 0, 7}, {"y", 4, 7}}, 12, "")), "no fields x, y and z"));
    const std::string parameter_list("\0\3\0\0", 4);
    CHECK_THROWS_AS(MessageReader(bytes_of(parameter_list), MessageEncoding::cdr), MessageError);
  }

  TEST_CASE("each driver's time field is understood, and said") {
    struct Driver {
      const char* name;
      FieldOf time;
      double first, step;  // in the field's own unit
      std::int64_t start, sweep;
      const char* sentence;
    };
    const double stamp = t0;
    const std::array<Driver, 8> drivers{{
        {"velodyne",
         {"time", 12, 7},
         0,
         0.01,
         0,
         100,
         "time per point: s, relative to the scan's stamp, stamp at the sweep's start"},
        {"velodyne, last packet",
         {"time", 12, 7},
         -0.1,
         0.01,
         -100,
         100,
         "s, relative to the scan's stamp, stamp at the sweep's end"},
        {"community NCLT", {"time", 12, 7}, 0, 10'000, 0, 100, "time per point: us, relative"},
        {"ouster", {"t", 12, 6}, 0, 10'000'000, 0, 100, "time per point: ns, relative"},
        {"hesai", {"timestamp", 12, 8}, stamp, 0.01, 0, 100, "time per point: s, absolute"},
        {"robosense, stamped at the end",
         {"timestamp", 12, 8},
         stamp - 0.1,
         0.01,
         -100,
         100,
         "s, absolute, stamp at the sweep's end"},
        {"livox 2", {"timestamp", 12, 8}, stamp * 1e9, 1e7, 0, 100, "time per point: ns, absolute"},
        {"milliseconds", {"time_stamp", 12, 7}, 0, 10, 0, 100, "time per point: ms, relative"},
    }};
    for (const Driver& driver : drivers) {
      CAPTURE(driver.name);
      std::string data;
      for (int i = 0; i < 11; ++i) {
        const double time = driver.first + driver.step * i;
        data += little(1.0F) + little(2.0F) + little(static_cast<float>(i));
        data += driver.time.datatype == 8   ? little(time)
                : driver.time.datatype == 7 ? little(static_cast<float>(time)) + std::string(4, '\0')
                                            : little(static_cast<std::uint32_t>(time)) + std::string(4, '\0');
      }
      std::vector<std::string> sentences;
      const LidarScan scan = only_scan(
          "sensor_msgs/PointCloud2",
          point_cloud2(ros1, t0, 0, {{"x", 0, 7}, {"y", 4, 7}, {"z", 8, 7}, driver.time}, 20, data), &sentences);
      CHECK_MESSAGE(any_says(sentences, driver.sentence), sentences[0]);
      CHECK(std::abs((scan.time - Timestamp::from_nanoseconds(t0 * 1'000'000'000LL)).count() -
                     driver.start * 1'000'000) < 1000);
      CHECK(std::abs((scan.end - scan.time).count() - driver.sweep * 1'000'000) < 1000);
      REQUIRE(scan.cloud.has_times());
      CHECK(scan.cloud.time_offsets[5] == doctest::Approx(0.05).epsilon(1e-4));
    }
  }

  TEST_CASE("a LiDAR's own clock from its start is not believed, nor are points without time doubted") {
    std::vector<std::string> sentences;
    const LidarScan avia =
        only_scan("livox_ros_driver2/CustomMsg", livox_message(ros1, t0, 77'000'000'000), &sentences);
    CHECK(avia.time.nanoseconds() == t0 * 1'000'000'000LL);
    CHECK(avia.cloud.time_offsets[9] == doctest::Approx(0.1));
    CHECK(any_says(sentences, "the LiDAR's own clock is -1599999923 s from its messages' stamps"));
    CHECK(any_says(sentences, "/p: 1 points left out that the sensor marks as noise"));

    const LidarScan plain = only_scan(
        "sensor_msgs/PointCloud2",
        point_cloud2(ros1, 0, 0, {{"z", 0, 8}, {"y", 8, 7}, {"x", 12, 4}, {"tag", 14, 2}, {"line", 15, 2}}, 16,
                     little(3.5) + little(2.0F) + little(std::uint16_t{4}) + "\x10\1" + little(3.5) + little(2.0F) +
                         little(std::uint16_t{4}) + "\x30\1"),
        &sentences);
    REQUIRE(plain.cloud.size() == 1);
    CHECK(plain.cloud.positions[0] == Eigen::Vector3f(4, 2, 3.5F));
    CHECK(plain.time == plain.end);
    CHECK(plain.time.nanoseconds() == t0 * 1'000'000'000LL);  // of the recording: the driver wrote no stamp
    CHECK(any_says(sentences, "no time per point; scans are taken as snapshots"));
    CHECK(any_says(sentences, "1 messages without a stamp"));
  }
}

TEST_SUITE("datasets/ros1_bag") {
  TEST_CASE("chunks of every packing give the same packets, in time order") {
    const std::string first = drive(t0), second = drive(t0 + 1);
    for (const std::string packing : {"none", "lz4", "bz2"}) {
      CAPTURE(packing);
      const auto chunk = [&](const std::string& records) {
        return chunk_record(packing,
                            packing == "none"  ? records
                            : packing == "lz4" ? lz4_frame(records)
                                               : bz2(records),
                            records.size());
      };
      const TemporaryFolder folder;
      write_bytes(folder / "a.bag", bag_of(chunk(first) + chunk(second)));
      const auto dataset = open_dataset(folder.path());
      CHECK(dataset->info().kind == DatasetKind::ros);
      const auto packets = packets_of(*dataset);
      CHECK(dataset->info().warnings.size() == 1);  // no extrinsic is stated
      CHECK(counts_of(packets) == std::array<int, 3>{40, 4, 2});
      for (std::size_t i = 1; i < packets.size(); ++i) CHECK(available_at(packets[i - 1]) <= available_at(packets[i]));
      const auto scan = std::ranges::find_if(packets, [](const Packet& p) { return p.index() == 1; });
      CHECK(std::get<LidarScan>(*scan).cloud.size() == 11);
      CHECK(std::get<LidarScan>(*scan).end.nanoseconds() / 1000 == t0 * 1'000'000LL + 99'999);  // 0.1F
      const auto fix = std::ranges::find_if(packets, [](const Packet& p) { return p.index() == 2; });
      CHECK(std::get<GnssFix>(*fix).covariance_ecef.trace() == doctest::Approx(0.25 + 0.25 + 4));
      CHECK(any_says(dataset->info().notes, "topics that are not read: /camera (sensor_msgs/Image)"));
    }
  }

  TEST_CASE("cut short at any byte, a bag gives what is whole and says what is lost") {
    const std::string first = drive(t0), second = drive(t0 + 1);
    const std::string whole =
        bag_of(chunk_record("none", first, first.size()) + chunk_record("lz4", lz4_frame(second), second.size()));
    const TemporaryFolder folder;
    std::size_t last = 0, used = 0, refused = 0;
    for (std::size_t n = 0; n <= whole.size(); n += n < 4200 || n + 300 > whole.size() ? 7 : 101) {
      const std::size_t end = n + 7 > whole.size() ? whole.size() : n;
      write_bytes(folder / "a.bag", whole.substr(0, end));
      std::vector<Packet> packets;
      std::vector<std::string> warnings;
      const std::string error = io_error([&] {
        const auto dataset = open_dataset(folder / "a.bag");
        packets = packets_of(*dataset);
        warnings = dataset->info().warnings;
        return 0;
      });
      if (packets.empty()) {
        CHECK(says(error, end < 13 ? "byte 0" : "byte"));
        ++refused;
        continue;
      }
      CHECK(packets.size() >= last);
      last = packets.size();
      if (end != whole.size()) {
        CHECK_MESSAGE(any_says(warnings, "a.bag, byte"), end);
        ++used;
      }
    }
    CHECK(last == 46);
    CHECK(refused > 100);
    CHECK(used > 100);
  }

  TEST_CASE("a chunk that does not unpack costs itself alone; what is no record ends the reading") {
    const std::string first = drive(t0), second = drive(t0 + 1);
    std::string packed = bz2(first);
    packed[packed.size() / 2] ^= 1;
    const TemporaryFolder folder;
    write_bytes(folder / "a.bag", bag_of(chunk_record("bz2", packed, first.size()) +
                                         chunk_record("none", second, second.size()) + std::string(20, 'x')));
    const auto dataset = open_dataset(folder / "a.bag");
    CHECK(packets_of(*dataset).size() == 23);
    CHECK(any_says(dataset->info().warnings, "a.bag, byte 4117: a chunk that does not unpack ("));
    CHECK(any_says(dataset->info().warnings, "the file is damaged here; what comes before is used"));

    write_bytes(folder / "b.bag", bag_of(chunk_record("xz", "?", 1)));
    CHECK(says(io_error([&] { return open_dataset(folder / "b.bag")->info().notes.size(); }), "packed as \"xz\""));
    write_bytes(folder / "b.bag", "#ROSBAG V1.2\n");
    CHECK(says(io_error([&] { return open_dataset(folder / "b.bag")->info().notes.size(); }), "rosbag fix"));
    // A small chunk that claims to be large costs no memory.
    write_bytes(folder / "b.bag", bag_of(chunk_record("lz4", lz4_frame("x"), 0xFFFFFFF0U)));
    CHECK(says(io_error([&] { return open_dataset(folder / "b.bag")->info().notes.size(); }), "256 MiB are the most"));
  }

  TEST_CASE("damaged messages, other LiDARs, sensors in other units, and messages late or without a fix") {
    const TemporaryFolder folder;
    std::string records = connection_record(0, "/imu", "sensor_msgs/Imu") +
                          connection_record(1, "/top", "sensor_msgs/PointCloud2") +
                          connection_record(2, "/side", "livox_ros_driver/CustomMsg") +
                          connection_record(3, "/fix", "sensor_msgs/NavSatFix") +
                          connection_record(4, "/packets", "velodyne_msgs/VelodyneScan");
    for (std::uint32_t i = 0; i < 10; ++i) {
      records += message_record(0, t0 + i, 0, imu_message(ros1, t0 + i, 0, 0.995));
      records += message_record(1, t0 + i, 1, velodyne_cloud(ros1, t0 + i, 0));
      records += message_record(2, t0 + i, 2, livox_message(ros1, t0 + i, (t0 + i) * 1'000'000'000ULL));
      records += message_record(3, t0 + i, 3, fix_message(ros1, t0 + i, i < 4 ? -1 : 1));
    }
    records += message_record(1, t0 + 9, 5, "short") + message_record(0, t0 + 9, 6, imu_message(ros1, t0 + 2, 0)) +
               message_record(4, t0 + 9, 7, "raw");
    write_bytes(folder / "a.bag", bag_of(records));
    const auto dataset = open_dataset(folder / "a.bag");
    CHECK(counts_of(packets_of(*dataset)) == std::array<int, 3>{11, 10, 6});
    const auto& info = dataset->info();
    CHECK(any_says(info.notes, "acceleration in g"));
    CHECK(any_says(info.warnings, "/top: 1 messages that are damaged are left out; the first, a.bag, byte"));
    CHECK(any_says(info.warnings, "the message ends after"));
    CHECK(any_says(info.warnings, "/fix: 4 messages without a fix"));
    REQUIRE(info.sensors.size() == 4);
    CHECK(says(info.sensors[2].remark, "not used"));  // /side has one point fewer

    DatasetOptions options;
    options.lidar_topic = "/side";
    const auto side = open_dataset(folder / "a.bag", options);
    CHECK(std::get<LidarScan>(packets_of(*side).at(1)).cloud.size() == 10);
    options.lidar_topic = "/none";
    const auto none = open_dataset(folder / "a.bag", options);
    CHECK(counts_of(packets_of(*none))[1] == 0);
    CHECK(any_says(none->info().warnings, "no messages on /none"));
  }

  TEST_CASE("where the LiDAR and the antenna sit is read from /tf_static, over frames between them") {
    const TemporaryFolder folder;
    const std::string transforms =
        transform_message(ros1, {{"/base", "imu", {1, 0, 0.5}, true}, {"base", "mast", {0, 0, 1}}});
    const auto info_of = [&](const std::string& more, const DatasetOptions& options = {}) {
      std::string records = connection_record(7, "/tf_static", "tf2_msgs/TFMessage");
      for (const std::string& message : {transforms, more}) records += message_record(7, t0, 0, message);
      write_bytes(folder / "a.bag", bag_of(records + drive(t0)));
      return open_dataset(folder / "a.bag", options)->info();
    };
    const std::string mast = transform_message(ros1, {{"mast", "/lidar", {0.5, 0, 0}}, {"base", "gps", {1, 2, 0.5}}});
    const DatasetInfo info = info_of(mast);
    CHECK(info.T_body_lidar.translation().isApprox(Eigen::Vector3d(0.5, 0, 0.5)));
    CHECK((info.T_body_lidar.rotation() * Eigen::Vector3d::UnitX()).isApprox(-Eigen::Vector3d::UnitX()));
    REQUIRE(info.p_body_antenna);
    CHECK(info.p_body_antenna->isApprox(Eigen::Vector3d(0, -2, 0)));
    CHECK(any_says(info.notes, "T_body_lidar from imu to lidar, as /tf_static states it"));
    const SE3d given(SO3d(), {7, 8, 9});
    CHECK(info_of(mast, {.T_body_lidar = given}).T_body_lidar.translation() == given.translation());
    // A circle, nothing at all, and a message that is cut short: what leads nowhere is said.
    for (const std::string& other :
         {transform_message(ros1, {{"lidar", "mast", {1, 0, 0}}, {"mast", "lidar", {1, 0, 0}}}),
          transform_message(ros1, {}), mast.substr(0, mast.size() - 90)}) {
      const DatasetInfo loose = info_of(other);
      CHECK(loose.T_body_lidar.translation().norm() == 0);
      CHECK(any_says(loose.notes, "no /tf_static leads from imu to lidar"));
    }
    for (const auto layout : {MessageBytes::ros1, MessageBytes::cdr_little, MessageBytes::cdr_big}) {
      const std::string whole = transform_message(layout, {{"base", "imu", {1, 0, 0.5}}});
      const auto encoding = layout == ros1 ? MessageEncoding::ros1 : MessageEncoding::cdr;
      for (std::size_t n = 0; n <= whole.size(); ++n) {
        TransformTree tree;
        bool refused = false;
        try {
          tree.add(MessageReader(bytes_of(whole).first(n), encoding));
        } catch (const MessageError&) {
          refused = true;
        }
        CHECK(refused == (n < whole.size()));
        CHECK(tree.between("imu", "base").has_value() == !refused);
      }
    }
  }

  TEST_CASE("inspect knows a bag and a folder of a bag's parts") {
    const TemporaryFolder folder;
    const std::string first = drive(t0), second = drive(t0 + 10);
    write_bytes(folder / "parts/run_2.bag", bag_of(chunk_record("none", first, first.size())));
    write_bytes(folder / "parts/run_10.bag", bag_of(chunk_record("none", second, second.size())));
    const std::string text = to_text(inspect(folder / "parts"));
    for (const char* part : {"data set, ros", "40, 10.19 s, usually 100 Hz", "/points", "frame lidar",
                             "field time: time per point: s, relative", "44, of a scan 11 to 11", "2 3-D"})
      CHECK_MESSAGE(says(text, part), text);
    CHECK(says(text, "gaps"));
    CHECK(says(to_text(inspect(folder / "parts/run_2.bag")), "20, 0.19 s"));
  }
}

}  // namespace chainslam::test
