#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

#include "datasets/dataset.hpp"
#include "datasets/imu_table.hpp"
#include "datasets/inspect.hpp"
#include "datasets/ros_bytes.hpp"
#include "support/files.hpp"

// KITTI, MulRan, HeLiPR, Newer College and folders of clouds with tables: bytes by hand, as the releases lay them out.

namespace chainslam::test {
namespace {

using namespace datasets;

/// x y z and one number more, as floats.
std::string four_floats(float x, float y, float z, float w) { return little(x) + little(y) + little(z) + little(w); }

std::string inspected(const std::filesystem::path& path) { return to_text(inspect(path)); }

std::string reading_error(const std::filesystem::path& path, const DatasetOptions& options = {}) {
  return io_error([&] { return packets_of(*open_dataset(path, options)).size(); });
}

/// Three scans ahead of, left of and behind a sensor at rest whose camera looks ahead: Tr as KITTI's.
void write_kitti(const std::filesystem::path& root) {
  for (int i = 0; i < 3; ++i)
    write_bytes(root / "sequences/07/velodyne" / ("00000" + std::to_string(i) + ".bin"),
                four_floats(10, 0, 0, 0.5F) + four_floats(0, 20, -1, 0.25F));
  write_bytes(root / "sequences/07/times.txt", "0.000000e+00\n1.036224e-01\n2.072448e-01\n");
  write_bytes(root / "sequences/07/calib.txt", "P0: 7 0 6 0 0 7 1 0 0 0 1 0\nTr: 0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3\n");
  write_bytes(root / "poses/07.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 2\n1 0 0 0.5 0 1 0 0 0 0 1 4\n");
}

std::string oxts(double latitude, double yaw, int mode) {
  std::string text = std::to_string(latitude) + " 8.4 110.5 0 0 " + std::to_string(yaw);
  for (int i = 6; i < 11; ++i) text += " 0";
  text += " 0.25 0.5 9.75";  // ax ay az
  for (int i = 14; i < 17; ++i) text += " 7";
  text += " 0.01 0.02 0.03";  // wx wy wz
  for (int i = 20; i < 23; ++i) text += " 7";
  return text + " 0.5 0.1 4 9 " + std::to_string(mode) + " 4 4\n";  // pos_accuracy ... orimode
}

/// Two scans of four points a quarter turn apart, four INS records; the third scan's file is missing.
void write_kitti_raw(const std::filesystem::path& day) {
  const auto drive = day / "2011_09_26_drive_0001_sync";
  const std::string cloud =
      four_floats(-10, 0.001F, 0, 0) + four_floats(0, 10, 0, 0) + four_floats(10, 0, 0, 0) + four_floats(0, -10, 0, 1);
  write_bytes(drive / "velodyne_points/data/0000000000.bin", cloud);
  write_bytes(drive / "velodyne_points/data/0000000002.bin", cloud);
  const auto stamps = [](const char* fraction) {
    std::string text;
    for (const char* second : {"25.1", "25.2", "25.3"})
      text += std::string("2011-09-26 13:02:") + second + fraction + '\n';
    return text;
  };
  write_bytes(drive / "velodyne_points/timestamps_start.txt", stamps("00000000"));
  write_bytes(drive / "velodyne_points/timestamps_end.txt", stamps("80000000"));
  for (int i = 0; i < 4; ++i)
    write_bytes(drive / "oxts/data" / ("000000000" + std::to_string(i) + ".txt"),
                oxts(49 + 1e-5 * i, std::numbers::pi / 2, i == 3 ? 1 : 6));
  write_bytes(drive / "oxts/timestamps.txt",
              "2011-09-26 13:02:25.10\n2011-09-26 13:02:25.20\n2011-09-26 13:02:25.15\n2011-09-26 13:02:25.40\n");
  write_bytes(day / "calib_imu_to_velo.txt",
              "calib_time: 25-May-2012 16:47:16\nR: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n");
}

constexpr std::int64_t mulran_start = 1'561'000'444'390'857'630;

/// A table row of so many numbers after a time, of which some are given.
std::string row(std::int64_t time, const std::vector<double>& values) {
  std::string text = std::to_string(time);
  for (const double value : values) text += "," + std::to_string(value);
  return text + "\n";
}

std::vector<double> xsens(double rate, double accel) {
  return {0, 0, 0, 1, 0, 0, 0, 0, 0, rate, 0, 0, accel, 0.3, 0.3, 0.3};
}

void write_mulran(const std::filesystem::path& root, const std::string& scans) {
  for (int scan = 0; scan < 2; ++scan) {
    std::string bytes;
    for (int i = 0; i < 130; ++i) bytes += four_floats(static_cast<float>(i), 1, 2, 99);
    write_bytes(root / scans / (std::to_string(mulran_start + 100'000'000 * scan) + ".bin"), bytes);
  }
  std::string imu, gps;
  for (int i = 0; i < 12; ++i) imu += row(mulran_start + 10'000'000 * i, xsens(0.1, 9.8));
  for (int i = 0; i < 2; ++i)
    gps += row(mulran_start + 50'000'000 * i, {36.3, 127.3, 60, 0.25, 0, 0, 0, 0.25, 0, 0, 0, 4});
  write_bytes(root / "xsens_imu.csv", imu);
  write_bytes(root / "gps.csv", gps);
  write_bytes(root / "global_pose.csv",
              row(mulran_start, {0, -1, 0, 345000, 1, 0, 0, 4025000, 0, 0, 1, 20}) +
                  row(mulran_start + 100'000'000, {0, -1, 0, 345000, 1, 0, 0, 4025001, 0, 0, 1, 20}));
}

/// Three points of each of HeLiPR's sensors, 10 ms apart.
std::string helipr_scan(const std::string& sensor, bool with_intensity = false) {
  std::string bytes;
  for (std::uint32_t i = 0; i < 3; ++i) {
    bytes += little(static_cast<float>(i)) + little(2.0F) + little(3.0F);
    const std::uint32_t time = 10'000'000 * i;
    const auto two = little(std::uint16_t{7});
    if (sensor == "Ouster") bytes += little(41.0F) + little(time) + two + two + two;
    if (sensor == "Velodyne") bytes += little(42.0F) + two + little(0.01F * static_cast<float>(i));
    if (sensor == "Aeva") bytes += little(43.0F) + little(-1.5F) + little(time) + '\5';
    if (sensor == "Avia") bytes += std::string("\x2C\x10\1", 3) + little(time);
    if (with_intensity) bytes += little(0.5F);
  }
  return bytes;
}

constexpr std::int64_t helipr_start = 1'691'936'500'000'000'000;

std::string named(std::int64_t time, const char* extension) { return std::to_string(time) + extension; }

}  // namespace

TEST_SUITE("datasets/kitti") {
  TEST_CASE("a sequence: snapshots with points turned upwards, and truth in the LiDAR's frame") {
    const TemporaryFolder folder;
    write_kitti(folder.path());
    const auto path = folder / "sequences/07";
    const auto dataset = open_dataset(path);
    CHECK(dataset->info().kind == DatasetKind::kitti);
    CHECK(dataset->info().motion_corrected);
    CHECK(dataset->info().truth_frame.empty());
    const auto scan = std::get<LidarScan>(*dataset->next());
    constexpr double up = 0.205 * std::numbers::pi / 180;
    CHECK(scan.cloud.positions[0].isApprox(
        Eigen::Vector3d(10 * std::cos(up), 0, 10 * std::sin(up)).cast<float>().eval(), 1e-6F));
    CHECK(scan.cloud.positions[1].norm() == doctest::Approx(std::hypot(20, 1)));
    CHECK(std::asin(scan.cloud.positions[1].z() / scan.cloud.positions[1].norm()) ==
          doctest::Approx(std::atan2(-1, 20) + up));
    CHECK(scan.cloud.intensities == std::vector<float>{0.5F, 0.25F});
    CHECK(std::get<LidarScan>(*dataset->next()).time.nanoseconds() == 103'622'400);
    const auto truth = dataset->truth();
    REQUIRE(truth);
    REQUIRE(truth->size() == 3);
    // The camera's z is the LiDAR's x, and its x the LiDAR's -y.
    CHECK(truth->poses[0].log().norm() < 1e-9);
    CHECK(truth->poses[2].translation().isApprox(Eigen::Vector3d(4, -0.5, 0), 1e-9));
    const auto as_stored = std::get<LidarScan>(*open_dataset(path, {.kitti_elevation_offset_deg = 0})->next());
    CHECK(as_stored.cloud.positions[1] == Eigen::Vector3f(0, 20, -1));
    CHECK(says(inspected(path), "truth path"));
  }

  TEST_CASE("what is missing or cut of a sequence is named") {
    const TemporaryFolder folder;
    write_kitti(folder.path());
    const auto path = folder / "sequences/07";
    const std::string whole = read_bytes(path / "velodyne/000001.bin");
    for (std::size_t n = 0; n <= whole.size(); ++n) {
      write_bytes(path / "velodyne/000001.bin", whole.substr(0, n));
      const auto dataset = open_dataset(path);
      CHECK(packets_of(*dataset).size() == (n % 16 == 0 ? 3 : 2));
      if (n % 16 != 0) CHECK(any_says(dataset->info().warnings, "000001.bin, byte " + std::to_string(n - n % 16)));
    }
    write_bytes(path / "times.txt", "0\n0.1\n");
    CHECK(says(reading_error(path), "3 scans in velodyne, 2 lines in times.txt"));
    write_kitti(folder.path());
    for (const char* calibration : {"P0: 1\n", "Tr: 1 2 3\n", "Tr: 1 0 0 0 0 2 0 0 0 0 1 0\n"}) {
      write_bytes(path / "calib.txt", calibration);
      CHECK(says(reading_error(path), "calib.txt, entry Tr"));
    }
  }

  TEST_CASE("a raw drive: times of points by azimuth, samples, fixes and poses of the INS") {
    const TemporaryFolder folder;
    write_kitti_raw(folder.path());
    const auto dataset = open_dataset(folder.path());  // the day's folder, with one drive
    CHECK(dataset->info().kind == DatasetKind::kitti_raw);
    CHECK(!dataset->info().motion_corrected);
    CHECK(dataset->info().T_body_lidar.translation().isApprox(Eigen::Vector3d(0.8, -0.3, 0.8)));
    CHECK(dataset->info().warnings.empty());
    const auto packets = packets_of(*dataset);
    CHECK(counts_of(packets) == std::array<int, 3>{3, 2, 2});  // a sample that goes back takes its fix along
    CHECK(any_says(dataset->info().warnings, "2 packets dropped that went back in time"));
    for (const Packet& packet : packets) {
      if (const auto* sample = std::get_if<ImuSample>(&packet)) {
        CHECK(sample->accel == Eigen::Vector3d(0.25, 0.5, 9.75));
        CHECK(sample->gyro == Eigen::Vector3d(0.01, 0.02, 0.03));
      }
      if (const auto* fix = std::get_if<GnssFix>(&packet)) {
        CHECK(fix->quality == GnssQuality::rtk_fixed);
        CHECK(fix->covariance_ecef.trace() == doctest::Approx(0.25 + 0.25 + 1));
      }
      if (const auto* scan = std::get_if<LidarScan>(&packet)) {
        CHECK(scan->end - scan->time == std::chrono::milliseconds(80));
        for (std::size_t i = 0; i < 4; ++i)
          CHECK(scan->cloud.time_offsets[i] == doctest::Approx(0.02 * static_cast<double>(i)).epsilon(1e-4));
      }
    }
    const auto truth = dataset->truth();
    REQUIRE(truth);
    REQUIRE(truth->size() == 3);
    CHECK(truth->poses[1].translation().y() == doctest::Approx(1.1121).epsilon(1e-3));  // 1e-5 degrees to the north
    CHECK((truth->poses[0].rotation() * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm() < 1e-6);
  }

  TEST_CASE("records of a raw drive that are damaged, cut or do not belong are named") {
    const TemporaryFolder folder;
    write_kitti_raw(folder.path());
    const auto drive = folder / "2011_09_26_drive_0001_sync";
    const std::string whole = oxts(49, 0, 6);
    for (std::size_t n = 0; n + 2 < whole.size(); n += 3) {
      write_bytes(drive / "oxts/data/0000000001.txt", whole.substr(0, n));
      const auto dataset = open_dataset(drive);
      CHECK(counts_of(packets_of(*dataset))[0] == 3);  // the other records
      CHECK(any_says(dataset->info().warnings, "1 file cannot be read and is left out: "));
      CHECK(any_says(dataset->info().warnings,
                     n == 0 ? "0000000001.txt: an empty file" : "0000000001.txt, line 1, field"));
      CHECK(dataset->truth()->size() == 3);
    }
    write_kitti_raw(folder.path());
    write_bytes(drive / "velodyne_points/data/0000000009.bin", "");
    CHECK(says(reading_error(drive), "no line of the stamps belongs to it, of which there are 3"));
    std::filesystem::remove(drive / "velodyne_points/data/0000000009.bin");
    write_bytes(drive / "velodyne_points/timestamps_end.txt", "2011-09-26 13:02:25.2\n");
    CHECK(says(reading_error(drive), "starts and ends of sweeps"));
    std::filesystem::remove_all(drive / "velodyne_points/data");
    std::filesystem::remove(drive / "velodyne_points/timestamps_start.txt");
    write_bytes(drive / "velodyne_points/timestamps.txt", "2011-09-26 13:02:25.15\n");
    write_bytes(drive / "velodyne_points/data/0000000000.txt", "10 0 0 0.5\n0 -10 1 0.25\n");
    std::filesystem::remove(folder / "calib_imu_to_velo.txt");
    const auto extracted = open_dataset(drive);  // clouds as text; no stamps of starts and ends
    CHECK(any_says(extracted->info().warnings, "nothing states where the LiDAR sits on the IMU"));
    const auto packets = packets_of(*extracted);
    const auto scan = std::ranges::find_if(packets, [](const Packet& p) { return p.index() == 1; });
    REQUIRE(scan != packets.end());
    CHECK(std::get<LidarScan>(*scan).cloud.positions[1] == Eigen::Vector3f(0, -10, 1));
    CHECK(std::get<LidarScan>(*scan).cloud.time_offsets[1] == doctest::Approx(0.075));
    write_bytes(drive / "velodyne_points/data/0000000000.txt", "10 0 0\n");
    const auto cut = open_dataset(drive);
    static_cast<void>(packets_of(*cut));
    CHECK(any_says(cut->info().warnings, "0000000000.txt, line 1, field reflectance"));
  }
}

TEST_SUITE("datasets/mulran") {
  TEST_CASE("scans by column, samples, fixes with their covariance, and poses of the car moved to the inertial unit") {
    for (const char* scans : {"Ouster", "sensor_data/Ouster"}) {
      const TemporaryFolder folder;
      write_mulran(folder.path(), scans);
      const auto dataset = open_dataset(folder.path());
      CHECK(dataset->info().kind == DatasetKind::mulran);
      CHECK(!dataset->info().truth_frame.empty());
      const auto packets = packets_of(*dataset);
      REQUIRE(counts_of(packets) == std::array<int, 3>{12, 2, 2});
      for (std::size_t i = 1; i < packets.size(); ++i) CHECK(available_at(packets[i - 1]) <= available_at(packets[i]));
      for (const Packet& packet : packets) {
        if (const auto* sample = std::get_if<ImuSample>(&packet)) {
          CHECK(sample->gyro == Eigen::Vector3d(0, 0, 0.1));
          CHECK(sample->accel == Eigen::Vector3d(0, 0, 9.8));
        }
        if (const auto* fix = std::get_if<GnssFix>(&packet))
          CHECK(fix->covariance_ecef.trace() == doctest::Approx(4.5));
        if (const auto* scan = std::get_if<LidarScan>(&packet)) {
          REQUIRE(scan->cloud.size() == 130);  // a short scan: two columns and a part of the third
          CHECK(scan->cloud.time_offsets[63] == 0);
          CHECK(scan->cloud.time_offsets[64] == doctest::Approx(0.1 / 1024));
          CHECK(scan->cloud.time_offsets[129] == doctest::Approx(0.2 / 1024));
          CHECK(static_cast<double>(scan->cloud.time_offsets[129]) <= to_seconds(scan->end - scan->time));
        }
      }
      const auto truth = dataset->truth();
      REQUIRE(truth);
      REQUIRE(truth->size() == 2);
      // The LiDAR's place in the world is that by the car, whatever lies between.
      const SE3d T_utm_lidar = truth->poses[0] * dataset->info().T_body_lidar;
      CHECK(T_utm_lidar.translation().isApprox(Eigen::Vector3d(345000.021, 4025001.7042, 21.8047), 1e-9));
    }
  }

  TEST_CASE("a sequence with cut scans, a cut table or angles only") {
    const TemporaryFolder folder;
    write_mulran(folder.path(), "Ouster");
    write_bytes(folder / "Ouster" / named(mulran_start, ".bin"), std::string(35, 'x'));
    const auto dataset = open_dataset(folder.path());
    CHECK(counts_of(packets_of(*dataset))[1] == 1);
    CHECK(any_says(dataset->info().warnings, "1 file cannot be read and is left out: "));
    CHECK(any_says(dataset->info().warnings, "byte 32: 3 bytes after the last point"));
    for (const char* name : {"xsens_imu.csv", "gps.csv", "global_pose.csv"}) {
      const std::string whole = read_bytes(folder / name);
      const std::size_t line = whole.find('\n') + 1;  // the second line is cut short, at every comma
      for (std::size_t n = whole.find(',', line); n < whole.find('\n', line); n = whole.find(',', n + 1)) {
        const bool enough =
            std::string(name) == "xsens_imu.csv" && std::ranges::count(whole.substr(line, n - line), ',') >= 13;
        const bool truth = std::string(name) == "global_pose.csv";
        for (const char* end : {"", "\n"}) {  // the file was cut, or the line was damaged
          write_bytes(folder / name, whole.substr(0, n) + end);
          std::vector<std::string> warnings;
          const std::string error = io_error([&] {
            const auto cut = open_dataset(folder.path());
            static_cast<void>(packets_of(*cut));
            warnings = cut->info().warnings;
            return cut->truth()->size();
          });
          if (enough) continue;
          if (*end == '\0' && !truth)
            CHECK_MESSAGE((error.empty() && any_says(warnings, std::string(name) + ", line 2, field") &&
                           any_says(warnings, "byte " + std::to_string(n) + ": the file ends within a line")),
                          error);
          else
            CHECK_MESSAGE((says(error, name) && says(error, "line 2, field")), error);
        }
      }
      write_bytes(folder / name, whole);
    }
    write_bytes(folder / "xsens_imu.csv", row(mulran_start, {0, 0, 0, 1, 0, 0, 0}));
    const auto angles = open_dataset(folder.path());
    CHECK(counts_of(packets_of(*angles)) == std::array<int, 3>{0, 1, 2});
    CHECK(any_says(angles->info().warnings, "holds angles, no rates and accelerations"));
  }
}

TEST_SUITE("datasets/helipr") {
  TEST_CASE("each sensor's records, the last point among them") {
    const TemporaryFolder folder;
    const auto scan_of = [&](const std::string& sensor, std::int64_t time, bool with_intensity = false) {
      std::filesystem::remove_all(folder / "LiDAR");
      write_bytes(folder / ("LiDAR/" + sensor) / named(time, ".bin"), helipr_scan(sensor, with_intensity));
      const auto dataset = open_dataset(folder.path());
      CHECK(dataset->info().kind == DatasetKind::helipr);
      return std::get<LidarScan>(*dataset->next());
    };
    float intensity = 41;
    for (const char* sensor : {"Ouster", "Velodyne", "Aeva", "Avia"}) {
      const LidarScan scan = scan_of(sensor, helipr_start);
      REQUIRE(scan.cloud.size() == 3);
      CHECK(scan.time.nanoseconds() == helipr_start);
      CHECK(to_seconds(scan.end - scan.time) == doctest::Approx(0.02).epsilon(1e-6));
      CHECK(scan.cloud.positions[2] == Eigen::Vector3f(2, 2, 3));
      CHECK(scan.cloud.intensities[2] == intensity++);
      CHECK(scan.cloud.time_offsets[1] == doctest::Approx(0.01));
    }
    CHECK(scan_of("Aeva", 1'691'936'557'946'849'180, true).cloud.size() == 3);  // 29 bytes from here on
  }

  TEST_CASE("of several LiDARs one is read; samples, the INS's fixes and the LiDAR's own truth come along") {
    const TemporaryFolder folder;
    for (const char* sensor : {"Ouster", "Avia"})
      write_bytes(folder / "LiDAR" / sensor / named(helipr_start, ".bin"), helipr_scan(sensor));
    std::string imu;
    for (int i = 0; i < 5; ++i) imu += row(helipr_start + 10'000'000 * i, xsens(0.1, 9.8));
    write_bytes(folder / "Inertial_data/xsens_imu.csv", imu);
    write_bytes(folder / "Inertial_data/inspva.csv",
                std::to_string(helipr_start) + ",36.3,127.3,60,0,0,0,0.1,0.2,90,status: 3\n");
    write_bytes(folder / "LiDAR_GT/global_Ouster_gt.txt", std::to_string(helipr_start) + " 1 2 3 0 0 0 1\n");
    const auto dataset = open_dataset(folder.path());
    CHECK(any_says(dataset->info().notes, "Avia/, Ouster/; read: Ouster"));
    CHECK(counts_of(packets_of(*dataset)) == std::array<int, 3>{5, 1, 1});
    const auto truth = dataset->truth();
    REQUIRE(truth);
    CHECK((truth->poses.at(0) * dataset->info().T_body_lidar).translation().isApprox(Eigen::Vector3d(1, 2, 3)));
    const auto avia = open_dataset(folder.path(), {.lidar_topic = "Avia"});
    CHECK(any_says(avia->info().warnings, "nothing states where the LiDAR sits on the IMU"));
    CHECK(!avia->truth());
    CHECK(says(reading_error(folder.path(), {.lidar_topic = "Aeva"}), "no scans of Aeva"));
    write_bytes(folder / "LiDAR_GT/global_Ouster_gt.txt", std::to_string(helipr_start) + " 1 2 3 0 0 0\n");
    CHECK(says(io_error([&] { return dataset->truth()->size(); }), "line 1, field qw"));
  }

  TEST_CASE("times that no sweep has cost their scan alone") {
    const TemporaryFolder folder;
    for (const float time : {1e30F, -1e30F, 3.0F}) {
      std::string bytes = helipr_scan("Velodyne");
      bytes.replace(22 + 18, 4, little(time));
      write_bytes(folder / "LiDAR/Velodyne" / named(helipr_start, ".bin"), bytes);
      const auto dataset = open_dataset(folder.path());
      CHECK(packets_of(*dataset).empty());
      CHECK(any_says(dataset->info().warnings, std::abs(time) > 3 ? "points of no time" : "points that span 3"));
    }
  }

  TEST_CASE("scans cut at any byte are left out and named, unless whole records are left") {
    const TemporaryFolder folder;
    for (const auto& [sensor, stride] : std::array<std::pair<const char*, std::size_t>, 4>{
             {{"Ouster", 26}, {"Velodyne", 22}, {"Aeva", 25}, {"Avia", 19}}}) {
      std::filesystem::remove_all(folder / "LiDAR");
      const std::string whole = helipr_scan(sensor);
      REQUIRE(whole.size() == 3 * stride);
      for (std::size_t n = 0; n < whole.size(); ++n) {
        write_bytes(folder / "LiDAR" / sensor / named(helipr_start, ".bin"), whole.substr(0, n));
        const auto dataset = open_dataset(folder.path());
        const std::size_t scans = packets_of(*dataset).size();
        CHECK(scans == (n % stride == 0 ? 1 : 0));
        if (scans == 0) CHECK(any_says(dataset->info().warnings, std::to_string(stride) + " bytes a point") == false);
        if (scans == 0) CHECK(any_says(dataset->info().warnings, "byte " + std::to_string(n - n % stride)));
      }
    }
  }
}

TEST_SUITE("datasets/newer_college") {
  TEST_CASE("scans by column, the unit's own table and poses of the camera") {
    const TemporaryFolder folder;
    std::string text = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 130\nHEIGHT 1\nDATA ascii\n";
    for (int i = 0; i < 130; ++i) text += std::to_string(i) + " 1 2\n";
    write_bytes(folder / "raw_format/ouster_scan/cloud_1583836591_182590976.pcd", text);
    write_bytes(folder / "raw_format/ouster_imu/ouster_imu.csv",
                "#counter,sec,nsec,orientation_x,gyro_x,gyro_y,gyro_z,acc_x,acc_y,acc_z\n"
                "0,1583836591,182590976,0,0.5,0.25,0.125,1,2,9.5\n1,1583836591,192590976,0,nan,0,0,0,0,9.8\n");
    write_bytes(folder / "ground_truth/registered_poses.csv",
                "#sec,nsec,x,y,z,qx,qy,qz,qw\n1583836591,182590976,5,6,7,0,0,0,1\n");
    const auto dataset = open_dataset(folder.path());
    CHECK(dataset->info().kind == DatasetKind::newer_college);
    const auto packets = packets_of(*dataset);
    REQUIRE(counts_of(packets) == std::array<int, 3>{1, 1, 0});
    const auto& sample = std::get<ImuSample>(packets[0]);
    CHECK(sample.time.nanoseconds() == 1'583'836'591'182'590'976);
    CHECK(sample.gyro == Eigen::Vector3d(0.5, 0.25, 0.125));
    CHECK(sample.accel == Eigen::Vector3d(1, 2, 9.5));
    CHECK(std::get<LidarScan>(packets[1]).cloud.time_offsets[129] == doctest::Approx(0.2 / 1024));
    CHECK(any_says(dataset->info().warnings, "1 rows of ouster_imu.csv skipped"));
    const auto truth = dataset->truth();
    REQUIRE(truth);
    CHECK((truth->poses.at(0) * dataset->info().T_body_lidar)
              .translation()
              .isApprox(Eigen::Vector3d(4.916, 5.975, 7.05), 1e-9));
    write_bytes(folder / "ground_truth/registered_poses.csv", "1583836591,182590976,5,6,7,0,0,0\n");
    CHECK(says(io_error([&] { return dataset->truth()->size(); }), "registered_poses.csv, line 1, field qw"));
  }
}

TEST_SUITE("datasets/imu_table") {
  TEST_CASE("columns are found by their names, or are EuRoC's") {
    const TemporaryFolder folder;
    const auto columns = [&](const std::string& text) {
      write_bytes(folder / "imu.csv", text);
      return imu_columns(folder / "imu.csv");
    };
    using Three = std::array<std::size_t, 3>;
    const ImuColumns euroc = columns(
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],"
        "a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n");
    CHECK(euroc.gyro == Three{1, 2, 3});
    CHECK(euroc.accel == Three{4, 5, 6});
    const ImuColumns ros = columns(
        "# exported\nTime,linear_acceleration.x,linear_acceleration.y,linear_acceleration.z,"
        "angular_velocity.x,angular_velocity.y,angular_velocity.z\n");
    CHECK(ros.accel == Three{1, 2, 3});
    CHECK(ros.gyro == Three{4, 5, 6});
    CHECK(columns("az,ay,ax,gz,gy,gx,t\n").gyro == Three{5, 4, 3});
    CHECK(columns("az,ay,ax,gz,gy,gx,t\n").time == 6);
    CHECK(columns("t,gps_x,angle_x,angular_acceleration_x,gx,gy,gz,ax,ay,az\n").gyro == Three{4, 5, 6});
    CHECK(columns("1.5,0,0,0,0,0,9.8\n").gyro == Three{1, 2, 3});
    CHECK(says(io_error([&] { return columns("t,ax,ay\n1,2,3\n").time; }), "line 1\n  found: 't,ax,ay'"));
  }

  TEST_CASE("a folder of clouds with a table and a trajectory as TUM's; accelerations in g become m/s^2") {
    const TemporaryFolder folder;
    write_bytes(folder / "clouds/1583836591.100000000.bin", four_floats(1, 2, 3, 4));
    std::string imu = "t,gx,gy,gz,ax,ay,az\n";
    for (int i = 0; i < 300; ++i)
      imu += "158383659" + std::to_string(1 + i / 100) + (i % 100 < 10 ? ".0" : ".") + std::to_string(i % 100) +
             ",0,0,0.1,0,0,1\n";
    write_bytes(folder / "imu.csv", imu);
    write_bytes(folder / "run.tum", "1583836591 1 0 0 0 0 0 1\n1583836592 3 0 0 0 0 0 1\n");
    const auto dataset = open_dataset(folder.path());
    CHECK(dataset->info().kind == DatasetKind::clouds);
    CHECK(any_says(dataset->info().warnings, "set dataset.T_body_lidar"));
    CHECK(any_says(dataset->info().notes, "acceleration in g"));
    const auto packets = packets_of(*dataset);
    REQUIRE(counts_of(packets) == std::array<int, 3>{300, 1, 0});
    CHECK(std::get<ImuSample>(packets[0]).accel.z() == doctest::Approx(9.80665));
    CHECK(path_length(*dataset->truth()) == doctest::Approx(2));
    write_bytes(folder / "imu.csv", imu + "1583836594.1,0,0,0.1,0,0\n");
    CHECK(says(reading_error(folder.path()), "imu.csv, line 302, field acceleration"));
    write_bytes(folder / "imu.csv", imu + "1583836594.1,0,0,x,0,0,1\n");
    CHECK(says(reading_error(folder.path()), "imu.csv, line 302, field rate"));
  }
}

}  // namespace chainslam::test
