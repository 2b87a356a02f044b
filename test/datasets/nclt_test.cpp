#include "datasets/nclt.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

#include "datasets/dataset.hpp"
#include "support/files.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {
namespace {

using namespace datasets;

std::uint16_t coded(double metres) { return static_cast<std::uint16_t>(std::lround((metres + 100) / 0.005)); }

/// Eight bytes of a hit, as the release's documentation lays them out.
std::string hit(double x, double y, double z, int intensity = 7, int laser = 3) {
  return little(coded(x)) + little(coded(y)) + little(coded(z)) + static_cast<char>(intensity) +
         static_cast<char>(laser);
}

std::string packet(std::int64_t microseconds, const std::string& hits) {
  std::string bytes;
  for (int i = 0; i < 4; ++i) bytes += little(std::uint16_t{44444});
  bytes += little(static_cast<std::uint32_t>(hits.size() / 8)) + little(microseconds) + std::string(4, '\0');
  return bytes + hits;
}

constexpr std::int64_t epoch = 1'326'030'975'000'000;
constexpr int packets_per_turn = 40;

/// Packets of four hits at one azimuth, 500 us apart, from azimuth `start` (turns) through so many `turns`.
std::string turning(double start, double turns, double direction, std::int64_t first = epoch) {
  std::string bytes;
  const int count = static_cast<int>(std::lround(turns * packets_per_turn));
  for (int i = 0; i < count; ++i) {
    const double azimuth = 2 * std::numbers::pi * (start + direction * i / packets_per_turn);
    std::string hits;
    for (int k = 0; k < 4; ++k) hits += hit(20 * std::cos(azimuth), 20 * std::sin(azimuth), k);
    bytes += packet(first + 500 * i, hits);
  }
  return bytes;
}

std::vector<LidarScan> sweeps_of(const std::string& bytes) {
  const TemporaryFolder folder;
  write_bytes(folder / "velodyne_hits.bin", bytes);
  NcltSweeps sweeps(folder / "velodyne_hits.bin");
  std::vector<LidarScan> result;
  while (auto sweep = sweeps.next()) result.push_back(std::move(*sweep));
  return result;
}

/// A road 1.7 m below the sensor in the direction that `down` says, and a wall.
std::string street(double down) {
  std::string bytes;
  for (int i = 0; i < 40; ++i)
    for (int k = 0; k < 20; ++k) bytes += hit(4 + 0.5 * i, k - 10, 1.7 * down);
  for (int i = 0; i < 100; ++i) bytes += hit(10, 5, 0.02 * i * -down);
  return bytes;
}

Eigen::Vector3d ecef_of(double latitude, double longitude, double altitude) {
  // WGS 84, the textbook's closed form.
  constexpr double a = 6378137, f = 1 / 298.257223563, e2 = f * (2 - f);
  const double n = a / std::sqrt(1 - e2 * std::sin(latitude) * std::sin(latitude));
  return {(n + altitude) * std::cos(latitude) * std::cos(longitude),
          (n + altitude) * std::cos(latitude) * std::sin(longitude), (n * (1 - e2) + altitude) * std::sin(latitude)};
}

}  // namespace

TEST_SUITE("datasets/nclt") {
  TEST_CASE("coordinates are unsigned: they reach from -100 m to 227.675 m") {
    const TemporaryFolder folder;
    const auto value = [](int v) { return little(static_cast<std::uint16_t>(v)); };
    write_bytes(folder / "0.bin", value(0) + value(20000) + value(65535) + "\xFF\x1F" + value(32768) + value(20001) +
                                      value(19999) + std::string("\0\0", 2));
    const PointCloud<float> cloud = read_nclt_sync(folder / "0.bin");
    REQUIRE(cloud.size() == 2);
    CHECK(cloud.positions[0].isApprox(Eigen::Vector3f(-100, 0, 227.675F)));
    CHECK(cloud.positions[1].isApprox(Eigen::Vector3f(63.84F, 0.005F, -0.005F)));
    CHECK(cloud.intensities == std::vector<float>{255, 0});
    write_bytes(folder / "0.bin", std::string(13, 'x'));
    CHECK(says(io_error([&] { return read_nclt_sync(folder / "0.bin").size(); }), "byte 8"));
  }

  TEST_CASE("sweeps are cut behind the sensor, whichever way it turns") {
    for (const double direction : {1.0, -1.0}) {
      // Starts ahead of the sensor (0), so that the first sweep is half a turn and is dropped.
      const auto sweeps = sweeps_of(turning(0.01 * direction, 3.4, direction));
      REQUIRE(sweeps.size() == 3);
      CHECK(sweeps[2].cloud.size() > 4 * packets_per_turn / 2);
      for (int i = 0; i < 2; ++i) {
        const LidarScan& sweep = sweeps[static_cast<std::size_t>(i)];
        CHECK(sweep.cloud.size() == 4 * packets_per_turn);
        CHECK(sweep.end - sweep.time == std::chrono::microseconds(500 * packets_per_turn));
        CHECK(sweep.cloud.positions.front().x() < 0);
        CHECK(std::abs(sweep.cloud.positions.front().y()) < 20 * std::sin(2 * std::numbers::pi / packets_per_turn));
      }
      CHECK(sweeps[1].time == sweeps[0].end);
    }
  }

  TEST_CASE("a packet's hits are spread evenly until the next packet") {
    const auto sweeps = sweeps_of(turning(0.51, 2.2, 1));
    REQUIRE(!sweeps.empty());
    const auto& offsets = sweeps[0].cloud.time_offsets;
    CHECK(sweeps[0].time == Timestamp::from_microseconds(epoch));
    for (std::size_t i = 0; i < offsets.size(); ++i)
      CHECK(static_cast<double>(offsets[i]) == doctest::Approx(125e-6 * static_cast<double>(i)).epsilon(1e-5));
    CHECK(static_cast<double>(offsets.back()) < to_seconds(sweeps[0].end - sweeps[0].time));
  }

  TEST_CASE("a pause ends a sweep, and does not stretch the points before it") {
    const auto sweeps = sweeps_of(turning(0.51, 1.9, 1) + turning(0.2, 2, 1, epoch + 5'000'000));
    for (const LidarScan& sweep : sweeps) CHECK(to_seconds(sweep.end - sweep.time) < 0.0211);
    CHECK(sweeps.size() >= 3);
  }

  TEST_CASE("empty packets and hits at the sensor are harmless") {
    std::string bytes;
    for (int i = 0; i < 50; ++i) bytes += packet(epoch + 500 * i, i % 2 == 0 ? "" : hit(0, 0, 0));
    CHECK(sweeps_of(bytes).empty());
    CHECK(sweeps_of("").empty());
  }

  TEST_CASE("noise of the azimuth at the cut does not cut twice") {
    std::string bytes;
    for (int i = 0; i < 5 * packets_per_turn; ++i) {
      const double jitter = i % 2 == 0 ? 0.02 : -0.02;
      const double azimuth = 2 * std::numbers::pi * (0.5001 + (i + jitter * 40) / packets_per_turn);
      bytes += packet(epoch + 500 * i, hit(20 * std::cos(azimuth), 20 * std::sin(azimuth), 0));
    }
    const auto sweeps = sweeps_of(bytes);
    CHECK(sweeps.size() <= 5);
    for (const LidarScan& sweep : sweeps) CHECK(sweep.cloud.size() >= packets_per_turn - 4);
  }

  TEST_CASE("damaged and cut files are named by their byte; any truncation is refused or gives whole packets") {
    const std::string whole = packet(epoch, hit(1, 2, 3)) + packet(epoch + 500, hit(1, 2, 3) + hit(4, 5, 6));
    const TemporaryFolder folder;
    const auto packets = [&](const std::string& bytes) {
      write_bytes(folder / "h.bin", bytes);
      InputFile file(folder / "h.bin");
      std::size_t count = 0;
      while (read_nclt_packet(file)) ++count;
      return count;
    };
    for (std::size_t n = 0; n <= whole.size(); ++n) {
      std::size_t count = 99;
      const std::string error = io_error([&] { return count = packets(whole.substr(0, n)); });
      if (n == 0 || n == 32 || n == whole.size())
        CHECK(count == (n == 0 ? 0U : n == 32 ? 1U : 2U));
      else
        CHECK(says(error, "byte"));
    }
    std::string bad = whole;
    bad[34] = 'x';
    CHECK(says(io_error([&] { return packets(bad); }), "byte 32\n  found: no packet"));
    bad = whole;
    bad[10] = '\x7F';
    CHECK(says(io_error([&] { return packets(bad); }), "384 are the most"));
  }

  TEST_CASE("a session's sensors come merged in time order, with z up") {
    const TemporaryFolder folder;
    write_bytes(folder / "velodyne_hits.bin", turning(0.51, 4, 1));
    std::string imu, gps;
    for (int i = 0; i < 8; ++i)
      imu += std::to_string(epoch + 10'000 * i) + ",0.1,0.2,0.3, 0.5, 0.25,-9.75, 0.01,0.02,0.03\n";
    imu += std::to_string(epoch + 90'000) + ",0,0,0,nan,0,0,0,0,0\n";
    gps += std::to_string(epoch + 5'000) + ",0,0,0,0,nan,0,0\n";
    gps += std::to_string(epoch + 25'000) + ",3,8,0.738156,-1.461009,250.5,0,0\n";
    gps += std::to_string(epoch + 45'000) + ",2,4,0.738157,-1.461008,nan,0,0\n";
    write_bytes(folder / "ms25.csv", imu);
    write_bytes(folder / "gps.csv", gps);
    const auto dataset = open_dataset(folder.path());
    CHECK(dataset->info().kind == DatasetKind::nclt);
    CHECK(dataset->info().warnings.empty());
    std::vector<Packet> packets;
    while (auto p = dataset->next()) packets.push_back(std::move(*p));
    for (std::size_t i = 1; i < packets.size(); ++i) CHECK(available_at(packets[i - 1]) <= available_at(packets[i]));
    std::array<int, 3> counts{};
    for (const Packet& p : packets) ++counts[p.index()];
    CHECK(counts == std::array<int, 3>{8, 4, 2});
    for (const Packet& p : packets) {
      if (const auto* sample = std::get_if<ImuSample>(&p)) {
        CHECK(sample->accel == Eigen::Vector3d(0.5, -0.25, 9.75));
        CHECK(sample->gyro == Eigen::Vector3d(0.01, -0.02, -0.03));
      }
      if (const auto* scan = std::get_if<LidarScan>(&p)) {
        CHECK(scan->cloud.positions[3].z() == doctest::Approx(-3));
        CHECK(scan->cloud.has_times());
      }
    }
    const auto& info = dataset->info();
    CHECK(!info.motion_corrected);
    CHECK(info.warnings.size() == 1);
    CHECK(says(info.warnings[0], "1 rows of ms25.csv"));
    // The LiDAR sits 0.247 m above the inertial unit, turned by -90.7 degrees, which z up makes +90.7.
    CHECK(info.T_body_lidar.translation().isApprox(Eigen::Vector3d(0.112, -0.176, 0.247), 1e-12));
    const Eigen::Vector3d ahead = info.T_body_lidar.rotation().matrix() * Eigen::Vector3d::UnitX();
    CHECK(std::atan2(ahead.y(), ahead.x()) * 180 / std::numbers::pi == doctest::Approx(90.703).epsilon(1e-3));
  }

  TEST_CASE("fixes become positions in the Earth's frame; a flat one keeps the last height and little trust in it") {
    const TemporaryFolder folder;
    write_bytes(folder / "velodyne_hits.bin", turning(0.51, 1.2, 1));
    write_bytes(folder / "gps_rtk.csv", std::to_string(epoch) + ",3,8,0.738156,-1.461009,250.5,0,0\n" +
                                            std::to_string(epoch + 1) + ",2,8,0.738156,-1.461009,nan,0,0\n");
    const auto dataset = open_dataset(folder.path());
    std::vector<GnssFix> fixes;
    while (const auto p = dataset->next())
      if (const auto* fix = std::get_if<GnssFix>(&*p)) fixes.push_back(*fix);
    REQUIRE(fixes.size() == 2);
    const Eigen::Vector3d expected = ecef_of(0.738156, -1.461009, 250.5);
    for (const GnssFix& fix : fixes) CHECK((fix.position_ecef - expected).norm() < 1e-6);
    CHECK(fixes[1].quality == GnssQuality::two_dimensional);
    const Eigen::Vector3d up(std::cos(0.738156) * std::cos(-1.461009), std::cos(0.738156) * std::sin(-1.461009),
                             std::sin(0.738156));
    CHECK(up.dot(fixes[0].covariance_ecef * up) == doctest::Approx(1));
    CHECK(up.dot(fixes[1].covariance_ecef * up) == doctest::Approx(2500));
    CHECK(fixes[0].covariance_ecef.trace() == doctest::Approx(1.5));
    CHECK(open_dataset(folder.path(), {.gnss = NcltGnss::none})->info().sensors.size() == 1);
  }

  TEST_CASE("the ground tells wrong axes, and a calib.txt lets them be put right") {
    const TemporaryFolder folder;
    const auto open = [&](double down, bool calibrated, NcltAxes axes) {
      std::filesystem::remove_all(folder / "s");
      write_bytes(folder / "s/velodyne_sync/1326030975000000.bin", street(down));
      if (calibrated) write_bytes(folder / "s/calib.txt", "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n");
      return open_dataset(folder / "s", {.axes = axes});
    };
    const auto z_of_road = [](Dataset& dataset) { return std::get<LidarScan>(*dataset.next()).cloud.positions[0].z(); };
    auto dataset = open(1, false, NcltAxes::automatic);
    CHECK(dataset->info().warnings.empty());
    CHECK(z_of_road(*dataset) == doctest::Approx(-1.7));
    dataset = open(-1, false, NcltAxes::automatic);
    REQUIRE(dataset->info().warnings.size() == 1);
    CHECK(says(dataset->info().warnings[0], "set the axes to kitti"));
    CHECK(z_of_road(*dataset) == doctest::Approx(1.7));
    dataset = open(-1, true, NcltAxes::automatic);
    CHECK(dataset->info().warnings.empty());
    CHECK(says(dataset->info().notes[0], "axes taken as KITTI's"));
    CHECK(z_of_road(*dataset) == doctest::Approx(-1.7));
    dataset = open(-1, true, NcltAxes::nclt);
    CHECK(dataset->info().warnings.size() == 1);
    dataset = open(1, false, NcltAxes::kitti);
    CHECK(says(dataset->info().warnings.at(0), "set the axes to nclt"));
  }

  TEST_CASE("the truth is turned to z up and moved to the inertial unit") {
    const TemporaryFolder folder;
    write_bytes(folder / "velodyne_sync/1326030975000000.bin", street(1));
    write_bytes(folder / "groundtruth_2012-01-08.csv",
                "1326030975000000, 10, 20, -3, 0, 0, 1.5707963267948966\n1326030975100000,nan,nan,nan,nan,nan,nan\n"
                "1326030975200000,0,0,0,0,0,0\n");
    const auto truth = open_dataset(folder.path())->truth();
    REQUIRE(truth);
    REQUIRE(truth->size() == 2);
    // Heading east, the unit's offset (-0.11, -0.18, -0.71) points west and north of the body: NED (0.18, -0.11,
    // -0.71).
    CHECK(truth->poses[0].translation().isApprox(Eigen::Vector3d(10.18, -19.89, 3.71), 1e-12));
    const Eigen::Vector3d ahead = truth->poses[0].rotation().matrix() * Eigen::Vector3d::UnitX();
    CHECK((ahead - Eigen::Vector3d(0, -1, 0)).norm() < 1e-12);  // x north, y west: east is -y
    CHECK(truth->times[1].nanoseconds() == 1'326'030'975'200'000'000);
  }

  TEST_CASE("the release's own folders are found; several dates ask for one") {
    const TemporaryFolder folder;
    write_bytes(folder / "velodyne_data/2012-01-08/velodyne_hits.bin", turning(0.51, 1.2, 1));
    write_bytes(folder / "sensor_data/2012-01-08/ms25.csv", "1326030975000000,0,0,0,0,0,-9.8,0,0,0\n");
    CHECK(open_dataset(folder.path())->info().sensors.size() == 2);
    write_bytes(folder / "sensor_data/2012-01-15/ms25.csv", "");
    CHECK(says(io_error([&] { return open_dataset(folder.path())->info().name; }), "2 sessions"));
  }

  TEST_CASE("errors of the tables name line and field") {
    const TemporaryFolder folder;
    write_bytes(folder / "velodyne_hits.bin", turning(0.51, 1.2, 1));
    write_bytes(folder / "ms25.csv", "1326030975000000,0,0,0,0,0,-9.8,0,0\n");
    CHECK(says(io_error([&] { return open_dataset(folder.path())->info().name; }), "ms25.csv, line 1, field value"));
    write_bytes(folder / "ms25.csv", "soon,0,0,0,0,0,-9.8,0,0,0\n");
    CHECK(says(io_error([&] { return open_dataset(folder.path())->info().name; }), "field time\n  found: 'soon'"));
  }

  TEST_CASE("a session that was cut within a packet is complete until then, and says where it ends") {
    const TemporaryFolder folder;
    const std::string whole = turning(0.51, 4, 1);
    const std::size_t packet_bytes = 24 + 4 * 8, last = whole.size() - packet_bytes;
    const auto scans_of = [&](const std::string& bytes) {
      write_bytes(folder / "velodyne_hits.bin", bytes);
      const auto dataset = open_dataset(folder.path());
      std::vector<LidarScan> scans;
      while (auto p = dataset->next()) scans.push_back(std::get<LidarScan>(std::move(*p)));
      return std::pair(scans.size(), dataset->info().warnings);
    };
    const auto [scans, warnings] = scans_of(whole);
    CHECK(warnings.empty());
    for (const std::size_t n : {last + 1, last + 23, last + 24, last + 30, whole.size() - 1}) {
      const auto [left, said] = scans_of(whole.substr(0, n));
      CHECK(left == scans);
      REQUIRE(said.size() == 1);
      CHECK(says(said[0], "velodyne_hits.bin, byte " + std::to_string(n < last + 24 ? last : last + 24)));
      CHECK(says(said[0], std::to_string(n - last) + " bytes from byte " + std::to_string(last) + " on are not used"));
    }
    std::string damaged = whole;
    damaged[2 * packets_per_turn * packet_bytes] = 'x';
    const auto [left, said] = scans_of(damaged);
    CHECK(left == scans / 2);
    CHECK(says(said.at(0), "no packet (four times 44444 expected"));
    write_bytes(folder / "velodyne_hits.bin", whole.substr(0, 30));  // nothing is usable
    CHECK(says(io_error([&] { return open_dataset(folder.path())->info().name; }), "velodyne_hits.bin, byte 24"));
  }

  TEST_CASE("tables and scans that were cut end there; the session goes on") {
    const TemporaryFolder folder;
    write_bytes(folder / "velodyne_sync/1326030975000000.bin", street(1));
    write_bytes(folder / "velodyne_sync/1326030975100000.bin", street(1).substr(0, 101));
    write_bytes(folder / "velodyne_sync/1326030975200000.bin", street(1));
    write_bytes(folder / "ms25.csv", "1326030975000000,0,0,0,0,0,-9.8,0,0,0\n1326030975010000,0,0,0,0,0,-9.");
    write_bytes(folder / "gps.csv", "1326030975000000,3,8,0.738156,-1.461009,250.5,0,0\n1326030975200");
    const auto dataset = open_dataset(folder.path());
    std::array<int, 3> counts{};
    while (const auto p = dataset->next()) ++counts[p->index()];
    CHECK(counts == std::array<int, 3>{1, 2, 1});
    const auto said = [&](const std::string& part) {
      return std::ranges::any_of(dataset->info().warnings, [&](const std::string& text) { return says(text, part); });
    };
    CHECK(said("1326030975100000.bin, byte 96: 5 bytes after the last point"));
    CHECK(said("ms25.csv, line 2, field value, byte 68: the file ends within a line"));
    CHECK(said("gps.csv, line 2, field value, byte 63: the file ends within a line"));
    // A damaged line in the middle is no cut.
    write_bytes(folder / "ms25.csv", "1326030975000000,0,0,0,0,0,-9.8,0,0\n1326030975010000,0,0,0,0,0,-9.8,0,0,0\n");
    CHECK(says(io_error([&] { return open_dataset(folder.path())->info().name; }), "ms25.csv, line 1, field value"));
  }

  TEST_CASE("decimal commas are refused with the line; accelerations in g are converted") {
    const TemporaryFolder folder;
    write_bytes(folder / "velodyne_hits.bin", turning(0.51, 1.2, 1));
    write_bytes(folder / "ms25.csv",
                "1326030975000000,0,1,0,2,0,3,0,5,0,25,-9,75,0,01,0,02,0,03\n"
                "1326030975010000,0,1,0,2,0,3,0,5,0,25,-9,75,0,01,0,02,0,03\n");
    const std::string error = io_error([&] { return open_dataset(folder.path())->info().name; });
    CHECK(says(error, "ms25.csv, line 1, field after the last"));
    CHECK(says(error, "do: each line holds utime and nine numbers, and decimals are written with a point"));
    std::string rows;
    for (int i = 0; i < 400; ++i)
      rows += std::to_string(epoch + 10'000 * i) + ",0,0,0,0.01," + (i % 2 == 0 ? "0.02" : "0.03") + ",-1.0,5.0," +
              (i % 3 == 0 ? "20.0" : "-17.0") + ",3.0\n";
    write_bytes(folder / "ms25.csv", rows);
    const auto dataset = open_dataset(folder.path());
    const auto noted = [&](const std::string& part) {
      return std::ranges::any_of(dataset->info().notes, [&](const std::string& text) { return says(text, part); });
    };
    CHECK(noted("acceleration in g: turned into m/s^2"));
    while (const auto p = dataset->next())
      if (const auto* sample = std::get_if<ImuSample>(&*p)) CHECK(sample->accel.z() == doctest::Approx(9.80665));
    const auto gnss = [&](const std::string& row) {
      write_bytes(folder / "gps.csv", row);
      return io_error([&] {
        const auto opened = open_dataset(folder.path());
        while (opened->next()) {
        }
        return 0;
      });
    };
    CHECK(says(gnss("1326030975000000,3,8,0,738156,-1,461009,250,5,0,0\n"), "gps.csv, line 1, field after the last"));
  }

  TEST_CASE("KITTI in NCLT's layout is read with the axes that it has") {
    if (const auto path = real_data("kitti00_first101")) {
      const auto dataset = open_dataset(*path);
      CHECK(dataset->info().sensors.at(0).count == 101);
      CHECK(says(dataset->info().notes.at(0), "axes taken as KITTI's"));
      CHECK(dataset->info().warnings.empty());
      const auto scan = std::get<LidarScan>(*dataset->next());
      CHECK(scan.time.nanoseconds() == 1'317'600'000'000'000'000);
      CHECK(scan.cloud.size() > 100'000);
      const auto truth = dataset->truth();
      REQUIRE(truth);
      CHECK(path_length(*truth) == doctest::Approx(84.6).epsilon(0.001));  // the collection's own figure
    }
  }
}

}  // namespace chainslam::test
