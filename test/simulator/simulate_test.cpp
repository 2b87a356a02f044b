#include "simulator/simulate.hpp"

#include <doctest/doctest.h>
#include <sys/resource.h>

#include <algorithm>
#include <charconv>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <numbers>
#include <set>
#include <sstream>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "simulator/hurry.hpp"
#include "simulator/rig.hpp"
#include "simulator/town_drive.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::simulator {
namespace {

namespace fs = std::filesystem;

/// A folder's name that is free, and is removed with all that was put there.
struct Folder {
  fs::path path;

  explicit Folder(const std::string& name)
      : path(fs::temp_directory_path() / ("chainslam_simulate_" + name + "_" + std::to_string(::getpid()))) {
    fs::remove_all(path);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  ~Folder() { fs::remove_all(path); }
};

Preset quick_preset() {
  Preset quick = *preset("town-small");
  quick.lidar.firings_per_revolution = 60;
  return quick;
}

/// Around a corner in traffic with a coarse VLS-128, in two sessions.
Preset quick_avenue() {
  Preset quick = *preset("mars-like", PresetSize::small);
  quick.lidar.firings_per_revolution = 15;
  quick.sessions.resize(2);
  quick.town.streets = {.columns = 2, .rows = 2, .block = 60.0};
  quick.town.passages.clear();
  quick.sessions[0].route = {{0, 0}, {1, 0}, {1, 1}};
  quick.sessions[1].route = {{1, 1}, {1, 0}, {0, 0}};
  chainslam::test::hurry(quick);
  return quick;
}

std::size_t packets_of(const TownDrive& drive) {
  return static_cast<std::size_t>(drive.scan_count() * quick_preset().lidar.firings_per_revolution / 12);
}

/// The value of a field in each row of a table, as it is written; a row is a line.
std::vector<std::string> column(const fs::path& table, const std::string& key) {
  std::ifstream file(table);
  std::vector<std::string> values;
  for (std::string line; std::getline(file, line);) {
    const auto at = line.find('"' + key + "\": ");
    if (at == std::string::npos) continue;
    const auto from = at + key.size() + 4;
    const auto to = line.find_first_of(line[from] == '[' ? "]" : ",}", from);
    values.push_back(line.substr(from, to - from + (line[from] == '[' ? 1 : 0)));
  }
  return values;
}

std::string read_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::vector<std::vector<double>> read_csv(const fs::path& path) {
  std::vector<std::vector<double>> rows;
  std::istringstream text(read_file(path));
  for (std::string line; std::getline(text, line);) {
    std::vector<double> row;
    std::istringstream fields(line);
    for (std::string field; std::getline(fields, field, ',');) row.push_back(std::strtod(field.c_str(), nullptr));
    rows.push_back(std::move(row));
  }
  return rows;
}

struct Hit {
  Eigen::Vector3d position;  ///< as recorded: z down
  int laser;
};
struct HitsPacket {
  std::uint64_t utime;
  std::vector<Hit> hits;
};

/// By the layout alone: 4 x u16 44444, u32, u64, 4 bytes, then 8 bytes a hit; little endian, as this machine is.
std::vector<HitsPacket> read_hits(const fs::path& path) {
  const std::string bytes = read_file(path);
  std::vector<HitsPacket> packets;
  for (std::size_t at = 0; at < bytes.size();) {
    REQUIRE(at + 24 <= bytes.size());
    REQUIRE(bytes.compare(at, 8, "\x9c\xad\x9c\xad\x9c\xad\x9c\xad") == 0);
    std::uint32_t count = 0;
    HitsPacket packet{};
    std::memcpy(&count, bytes.data() + at + 8, 4);
    std::memcpy(&packet.utime, bytes.data() + at + 12, 8);
    REQUIRE(count <= 384);
    at += 24;
    REQUIRE(at + 8 * count <= bytes.size());
    for (std::uint32_t i = 0; i < count; ++i, at += 8) {
      std::uint16_t raw[3];
      std::memcpy(raw, bytes.data() + at, 6);
      packet.hits.push_back({{raw[0] * 0.005 - 100.0, raw[1] * 0.005 - 100.0, raw[2] * 0.005 - 100.0},
                             static_cast<unsigned char>(bytes[at + 7])});
    }
    packets.push_back(std::move(packet));
  }
  return packets;
}

SO3d from_rph(double roll, double pitch, double heading) {
  return SO3d::from_quaternion(Eigen::Quaterniond(Eigen::AngleAxisd(heading, Eigen::Vector3d::UnitZ()) *
                                                  Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
                                                  Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX())));
}

/// Limits the size of files that this process may write, as a full disk would.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) : handler_(std::signal(SIGXFSZ, SIG_IGN)) {
    getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limit{bytes, before_.rlim_max};
    setrlimit(RLIMIT_FSIZE, &limit);
  }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;
  ~FileSizeLimit() {
    setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, handler_);
  }

 private:
  void (*handler_)(int);
  rlimit before_{};
};

std::size_t entries_in(const fs::path& path) {
  return static_cast<std::size_t>(std::distance(fs::directory_iterator(path), fs::directory_iterator()));
}

}  // namespace

TEST_SUITE("simulator/simulate") {
  THREADS_TEST_CASE("simulator/simulate", "one thread and two write the same bytes") {
    const Folder one("one");
    const Folder two("two");
    const SimulationReport report = simulate(quick_preset(), 11, one.path, Serial{});
    CHECK(simulate(quick_preset(), 11, two.path, ThreadPool(2)).points == report.points);
    std::uint64_t bytes = 0;
    for (const auto& entry : fs::directory_iterator(one.path)) {
      const std::string name = entry.path().filename().string();
      CAPTURE(name);
      CHECK(read_file(entry.path()) == read_file(two.path / name));
      bytes += entry.file_size();
    }
    CHECK(entries_in(one.path) == 6);
    CHECK(entries_in(two.path) == 6);
    CHECK(bytes == report.bytes);
  }

  TEST_CASE("what is written reads back by NCLT's layout as what the stream gives") {
    static const Folder folder("layout");  // once for all of its files
    static const SimulationReport report = simulate(quick_preset(), 5, folder.path, ThreadPool(2));
    const TownDrive drive(quick_preset(), 5);
    const std::uint64_t epoch_us = static_cast<std::uint64_t>(drive.epoch().nanoseconds() / 1000);

    SUBCASE("velodyne_hits.bin") {
      const auto packets = read_hits(folder.path / "velodyne_hits.bin");
      REQUIRE(packets.size() == packets_of(drive));
      CHECK(packets.front().utime == epoch_us);
      std::uint64_t points = 0;
      for (std::size_t i = 0; i < packets.size(); ++i) {
        points += packets[i].hits.size();
        CHECK(packets[i].utime == epoch_us + 20000 * i);  // five packets a revolution of 0.1 s
      }
      CHECK(points == report.points);
      const Index index = 100;
      const LidarScan scan = drive.scan(index);
      std::size_t i = 0;
      for (std::size_t p = 500; p < 505; ++p)
        for (const Hit& hit : packets[p].hits) {
          const Eigen::Vector3d z_up(hit.position.x(), -hit.position.y(), -hit.position.z());
          CHECK((z_up - scan.cloud.positions[i].cast<double>()).cwiseAbs().maxCoeff() < 0.0026);
          CHECK(hit.laser < 32);
          ++i;
        }
      CHECK(i == scan.cloud.size());
    }
    SUBCASE("ms25.csv") {
      const auto rows = read_csv(folder.path / "ms25.csv");
      REQUIRE(rows.size() == drive.imu().size());
      for (std::size_t i = 0; i < rows.size(); i += 37) {
        REQUIRE(rows[i].size() == 10);
        CHECK(rows[i][0] == static_cast<double>(drive.imu()[i].time.nanoseconds() / 1000));
        const Eigen::Vector3d accel(rows[i][4], -rows[i][5], -rows[i][6]);
        const Eigen::Vector3d gyro(rows[i][7], -rows[i][8], -rows[i][9]);
        CHECK((accel - drive.imu()[i].accel).norm() < 1e-5);
        CHECK((gyro - drive.imu()[i].gyro).norm() < 1e-6);
      }
      CHECK(rows[0][6] < -9.5);  // z down: specific force at rest points up
      CHECK(rows[0][3] > 0.4);   // the magnetic field points down
    }
    SUBCASE("gps.csv") {
      const auto rows = read_csv(folder.path / "gps.csv");
      REQUIRE(rows.size() == drive.gnss().size());
      for (std::size_t i = 0; i < rows.size(); ++i) {
        REQUIRE(rows[i].size() == 8);
        CHECK(rows[i][1] == drive.gnss()[i].mode);
        CHECK(std::abs(rows[i][3] - drive.gnss()[i].latitude) < 1e-11);
        CHECK(std::abs(rows[i][4] - drive.gnss()[i].longitude) < 1e-11);
        CHECK(std::isnan(rows[i][5]) == (drive.gnss()[i].mode == 0));
      }
    }
    SUBCASE("groundtruth and truth.tum") {
      const SE3d T_base_ms25(SO3d(), {-0.11, -0.18, -0.71});
      for (const auto& row : read_csv(folder.path / "groundtruth_2013-06-01.csv")) {
        REQUIRE(row.size() == 7);
        const SE3d T_ned_base(from_rph(row[4], row[5], row[6]), {row[1], row[2], row[3]});
        const SE3d T_ned_body = T_ned_base * T_base_ms25;
        const SE3d truth = drive.truth(Timestamp::from_microseconds(static_cast<std::int64_t>(row[0])));
        const Eigen::Vector3d p = T_ned_body.translation();
        CHECK((Eigen::Vector3d(p.x(), -p.y(), -p.z()) - truth.translation()).norm() < 1e-5);
        const Eigen::Vector3d ahead = T_ned_body.rotation() * Eigen::Vector3d::UnitX();
        const Eigen::Vector3d ahead_z_up(ahead.x(), -ahead.y(), -ahead.z());
        CHECK((ahead_z_up - truth.rotation() * Eigen::Vector3d::UnitX()).norm() < 1e-7);
      }
      const Trajectory trajectory = read_tum(folder.path / "truth.tum");
      REQUIRE(trajectory.size() == static_cast<std::size_t>(drive.scan_count()));
      CHECK(trajectory.times == drive.truth_at_scan_ends().times);
      CHECK(trajectory.poses[17].local(drive.truth(trajectory.times[17])).norm() < 1e-9);
      CHECK(read_file(folder.path / "README.txt").find("seed: 5\n") != std::string::npos);
    }
  }

  TEST_CASE("nuScenes' tables hold a scene for each session, and the same bytes by one thread and two") {
    const Folder folder("tables");
    const Folder again("tables2");
    const Preset avenue = quick_avenue();
    const SimulationReport report = simulate(avenue, 2, folder.path, ThreadPool(2));
    CHECK(simulate(avenue, 2, again.path, Serial{}).bytes == report.bytes);
    std::uint64_t bytes = 0;
    std::uint64_t points = 0;
    for (const auto& entry : fs::recursive_directory_iterator(folder.path)) {
      if (!entry.is_regular_file()) continue;
      const fs::path name = fs::relative(entry.path(), folder.path);
      if (read_file(entry.path()) != read_file(again.path / name)) FAIL_CHECK(name.string());
      bytes += entry.file_size();
      if (name.string().ends_with(".pcd.bin")) points += entry.file_size() / 20;
    }
    CHECK(bytes == report.bytes);
    CHECK(points == report.points);

    const fs::path tables = folder.path / "v1.0";
    CHECK(column(tables / "scene.json", "name") == std::vector<std::string>{"\"session1\"", "\"session2\""});
    CHECK(column(tables / "sensor.json", "channel") ==
          std::vector<std::string>{"\"LIDAR_FRONT_CENTER\"", "\"IMU_TOP\""});
    const auto times = column(tables / "sample.json", "timestamp");
    REQUIRE(times.size() == static_cast<std::size_t>(report.scans));
    const auto nexts = column(tables / "sample.json", "next");
    const auto tokens = column(tables / "sample.json", "token");
    CHECK(std::set<std::string>(tokens.begin(), tokens.end()).size() == tokens.size());
    CHECK(nexts[3] == tokens[4]);
    CHECK(std::ranges::count(nexts, "\"\"") == 2);
    for (const std::string& file : column(tables / "sample_data.json", "filename"))
      if (!fs::exists(folder.path / file.substr(1, file.size() - 2))) FAIL_CHECK(file);

    const TownDrive drive(avenue, 2, 0);
    const Index index = 40;
    const LidarScan scan = drive.scan(index);
    const std::string time = std::to_string(scan.end.nanoseconds() / 1000);
    CHECK(times[index] == time);
    const std::string cloud = read_file(folder.path / "sweeps" / "LIDAR_FRONT_CENTER" / (time + ".pcd.bin"));
    REQUIRE(cloud.size() == 20 * scan.cloud.size());
    for (std::size_t i = 0; i < scan.cloud.size(); i += 11) {
      std::array<float, 5> point{};
      std::memcpy(point.data(), cloud.data() + 20 * i, 20);
      CHECK(Eigen::Vector3f(point[0], point[1], point[2]) == scan.cloud.positions[i]);
      CHECK(point[3] == scan.cloud.intensities[i]);
      CHECK(point[4] >= 0.0F);
      CHECK(point[4] <= 127.0F);
    }
    const ImuSample& imu = drive.imu()[30];
    const fs::path record =
        folder.path / "sweeps" / "IMU_TOP" / (std::to_string(imu.time.nanoseconds() / 1000) + ".json");
    double x = 0.0, y = 0.0, z = 0.0;
    REQUIRE(std::sscanf(column(record, "acc").at(0).c_str(), "[%lf, %lf, %lf]", &x, &y, &z) == 3);
    CHECK((Eigen::Vector3d(x, y, z) - imu.accel).norm() == 0.0);
    REQUIRE(std::sscanf(column(record, "avel").at(0).c_str(), "[%lf, %lf, %lf]", &x, &y, &z) == 3);
    CHECK((Eigen::Vector3d(x, y, z) - imu.gyro).norm() == 0.0);
    const GnssReading& fix = drive.gnss()[30];
    REQUIRE(fix.time == imu.time);
    if (fix.mode != 0)
      CHECK(std::stod(column(record, "lat").at(0)) ==
            doctest::Approx(fix.latitude * 180.0 / std::numbers::pi).epsilon(1e-12));

    REQUIRE(std::sscanf(column(tables / "ego_pose.json", "translation").at(index).c_str(), "[%lf, %lf, %lf]", &x, &y,
                        &z) == 3);
    const SE3d T_map_ego = drive.truth(scan.end) * nominal_T_ego_imu().inverse();
    CHECK((Eigen::Vector3d(x, y, z) - T_map_ego.translation()).norm() < 1e-9);
    CHECK(T_map_ego.translation().z() - drive.truth(scan.end).translation().z() < -1.8);  // on the road
    REQUIRE(std::sscanf(column(tables / "calibrated_sensor.json", "translation").at(0).c_str(), "[%lf, %lf, %lf]", &x,
                        &y, &z) == 3);
    CHECK((Eigen::Vector3d(x, y, z) - Eigen::Vector3d(2.128, 0.0, 1.57)).norm() < 1e-9);
    CHECK(read_tum(folder.path / "truth_session2.tum").size() + static_cast<std::size_t>(drive.scan_count()) ==
          static_cast<std::size_t>(report.scans));
    CHECK(fs::file_size(folder.path / column(tables / "lidarseg.json", "filename")
                                          .at(index)
                                          .substr(1, column(tables / "lidarseg.json", "filename").at(index).size() -
                                                         2)) == scan.cloud.size());
  }

  TEST_CASE("labels say of every hit whether it lasts, changes or moves") {
    Preset labelled = quick_preset();
    labelled.labelled = true;
    labelled.traffic = {.companions = 2};
    const Folder folder("labels");
    const SimulationReport report = simulate(labelled, 3, folder.path, ThreadPool(2));
    CHECK(entries_in(folder.path) == 7);
    const std::string labels = read_file(folder.path / "labels.bin");
    REQUIRE(labels.size() == report.points);
    const TownDrive drive(labelled, 3);
    std::string first;
    for (const Index index : {0, 1})
      for (const LidarReturn& hit : drive.revolution(index).returns) first += static_cast<char>(hit.presence);
    CHECK(labels.starts_with(first));
    for (const char label : {'\0', '\1', '\2'}) CHECK(std::ranges::count(labels, label) > 1000);
  }

  TEST_CASE("several sessions are folders, each as if it were alone, dated by its day") {
    Preset two_days = quick_preset();
    two_days.sessions.push_back({.route = {{2, 2}, {2, 1}, {1, 1}}, .day = 30});
    const Folder folder("days");
    const SimulationReport report = simulate(two_days, 4, folder.path, ThreadPool(2));
    CHECK(entries_in(folder.path) == 2);
    Index scans = 0;
    for (const std::size_t session : {0U, 1U}) {
      const fs::path place = folder.path / ("session" + std::to_string(session + 1));
      const TownDrive drive(two_days, 4, session);
      CHECK(entries_in(place) == 6);
      CHECK(read_tum(place / "truth.tum").times == drive.truth_at_scan_ends().times);
      CHECK(read_hits(place / "velodyne_hits.bin").size() == packets_of(drive));
      const std::string number = std::to_string(session + 1);
      CHECK(read_file(place / "README.txt").find("session: " + number + " of 2, ") != std::string::npos);
      scans += drive.scan_count();
    }
    CHECK(report.scans == scans);
    CHECK(fs::exists(folder.path / "session1" / "groundtruth_2013-06-01.csv"));
    CHECK(fs::exists(folder.path / "session2" / "groundtruth_2013-07-01.csv"));
    CHECK(TownDrive(two_days, 4, 1).epoch() - TownDrive(two_days, 4, 0).epoch() == std::chrono::days(30));

    const Folder alone("alone");
    static_cast<void>(simulate(quick_preset(), 4, alone.path, Serial{}));
    for (const char* name : {"velodyne_hits.bin", "ms25.csv", "gps.csv", "truth.tum"}) {
      CAPTURE(name);
      CHECK(read_file(alone.path / name) == read_file(folder.path / "session1" / name));
    }
  }

  TEST_CASE("progress reaches the end, and what it throws stops the work without a trace") {
    const Folder folder("progress");
    Index last = 0;
    Index all = 0;
    static_cast<void>(simulate(quick_preset(), 1, folder.path, Serial{}, [&](Index done, Index total) {
      CHECK(done > last);
      last = done;
      all = total;
    }));
    CHECK(last == all);
    CHECK(all > 200);

    const Folder stopped("stopped");
    const auto stop = [&](Index done, Index) {
      if (done > all + 100) throw std::runtime_error("stop");
    };
    Preset twice = quick_preset();
    twice.sessions.push_back(twice.sessions.front());
    CHECK_THROWS_AS(static_cast<void>(simulate(twice, 1, stopped.path, Serial{}, stop)), std::runtime_error);
    CHECK(entries_in(stopped.path) == 0);
  }

  TEST_CASE("a folder that holds something is refused and left as it is") {
    const Folder folder("full");
    fs::create_directories(folder.path);
    std::ofstream(folder.path / "mine.txt") << "mine";
    try {
      static_cast<void>(simulate(quick_preset(), 1, folder.path, Serial{}));
      FAIL("an exception was expected");
    } catch (const IoError& error) {
      CHECK(error.kind() == IoError::Kind::output);
      CHECK(error.report().found == "a folder that is not empty");
    }
    CHECK(entries_in(folder.path) == 1);
  }

  TEST_CASE("a disk that takes no more is an error with a remedy, and no file is left") {
    const Folder folder("limit");
    const auto fails_at = [&](rlim_t bytes) {
      const FileSizeLimit limit(bytes);
      try {
        static_cast<void>(simulate(quick_preset(), 1, folder.path, Serial{}));
      } catch (const IoError& error) {
        return error.kind() == IoError::Kind::output && !error.report().remedy.empty();
      }
      return false;
    };
    CHECK(fails_at(100'000));  // within velodyne_hits.bin
    CHECK(entries_in(folder.path) == 0);
    CHECK_FALSE(fails_at(100'000'000));
  }
}

}  // namespace chainslam::simulator
