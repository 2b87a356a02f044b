#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

#include "datasets/azimuth_times.hpp"
#include "datasets/dataset.hpp"
#include "datasets/inspect.hpp"
#include "datasets/ros_bytes.hpp"
#include "support/files.hpp"

namespace chainslam::test {
namespace {

using namespace datasets;

/// A turn of 40 azimuths with two points each, clockwise from behind, as MARS's `.pcd.bin` holds it.
std::string turn_bytes(int points = 80) {
  std::string bytes;
  for (int i = 0; i < points; ++i) {
    const double azimuth = std::numbers::pi - 2 * std::numbers::pi * (i / 2) / 40;
    bytes += little(static_cast<float>(10 * std::cos(azimuth))) + little(static_cast<float>(10 * std::sin(azimuth))) +
             little(static_cast<float>(i % 2)) + little(200.0F) + little(static_cast<float>(i % 2));
  }
  return bytes;
}

std::string numbered(std::string text, int i) {
  for (std::size_t at = text.find('#'); at != text.npos; at = text.find('#')) text.replace(at, 1, std::to_string(i));
  return text;
}

/// Tables in nuScenes' schema as MARS fills them: two scenes, the first with three samples 0.1 s apart.
void write_mars(const std::filesystem::path& root) {
  const auto table = [&](const char* name, const std::string& rows) {
    write_bytes(root / "v1.0" / (std::string(name) + ".json"), "[" + rows + "]");
  };
  table("scene", R"({"token": "s1", "name": "2023_10_04_scene_3_maisy", "intersection": [1, 2], "err_max": 20068.0},
                    {"token": "s2", "name": "empty", "nested": {"token": "no"}})");
  table("sensor", R"({"token": "L", "channel": "LIDAR_FRONT_CENTER", "modality": "lidar"},
                     {"token": "I", "channel": "IMU_TOP", "modality": "imu"},
                     {"token": "C", "channel": "CAM_FRONT_CENTER", "modality": "camera"})");
  table("calibrated_sensor",
        R"({"token": "cL", "sensor_token": "L", "translation": [2.128, 0, 1.57], "rotation": [1, 0, 0, 0]},
           {"token": "cI", "sensor_token": "I", "translation": [0.128, 0, 0], "rotation": [0, 0, 0, 1]},
           {"token": "cC", "sensor_token": "C", "translation": [0, 0, 0], "rotation": [1, 0, 0, 0],
            "camera_intrinsic": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]})");
  std::string samples = R"({"token": "x", "scene_token": "s2", "timestamp": 1})", data, poses;
  for (int i = 0; i < 3; ++i) {
    const std::string time = "1696430800#00000";
    samples += numbered(R"(, {"token": "m#", "scene_token": "s1", "timestamp": )" + time + "}", i);
    for (const char* kind : {"L", "I", "C"}) {
      const std::string file = *kind == 'L'   ? "sweeps/LIDAR_FRONT_CENTER/" + time + ".pcd.bin"
                               : *kind == 'I' ? "sweeps/IMU_TOP/" + time + ".json"
                                              : "sweeps/CAM_FRONT_CENTER/none.jpg";
      data += numbered((data.empty() ? R"({"token": ")" : R"(, {"token": ")") + std::string(kind) +
                           R"(#", "sample_token": "m#", "is_key_frame": true, "ego_pose_token": "p#",
                             "calibrated_sensor_token": "c)" +
                           kind + R"(", "filename": ")" + file + R"(", "timestamp": )" + time + "}",
                       i);
    }
    poses +=
        numbered((i == 0 ? R"({"token": "p#", "translation": [#, 2, 0], "rotation": [1, 0, 0, 0], "timestamp": )"
                         : R"(, {"token": "p#", "translation": [#, 2, 0], "rotation": [1, 0, 0, 0], "timestamp": )") +
                     time + "}",
                 i);
    write_bytes(root / numbered("sweeps/LIDAR_FRONT_CENTER/" + time + ".pcd.bin", i), turn_bytes());
    write_bytes(root / numbered("sweeps/IMU_TOP/" + time + ".json", i),
                i == 2 ? R"({"utime": 1, "vel": [0, 0, 0], "avel": [0, 0, 0.5], "acc": [0.25, 0, 9.75]})"
                       : R"({"utime": 1, "lat": 42.3, "lon": -71.5, "elev": 31.5, "vel": [0, 0, 0],
                             "avel": [0, 0, 0.5], "acc": [0.25, 0, 9.75]})");
  }
  table("sample", samples);
  table("sample_data", data);
  table("ego_pose", poses);
}

}  // namespace

TEST_SUITE("datasets/nuscenes") {
  TEST_CASE("a scene of MARS: scans with times by azimuth, samples and fixes in time order, mounting and truth") {
    const TemporaryFolder folder;
    write_mars(folder / "MARS");
    const auto dataset = open_dataset(folder / "MARS/2023_10_04_scene_3_maisy");
    const DatasetInfo& info = dataset->info();
    CHECK(info.kind == DatasetKind::nuscenes);
    CHECK(info.name == "2023_10_04_scene_3_maisy");
    // The IMU is turned by half a turn about z, 2 m behind the LiDAR and 1.57 m below.
    CHECK(info.T_body_lidar.translation().isApprox(Eigen::Vector3d(-2, 0, 1.57), 1e-12));
    CHECK(any_says(info.notes, "times of points from their azimuth, in turns of 0.1 s"));
    const auto packets = packets_of(*dataset);
    CHECK(info.warnings.empty());
    REQUIRE(counts_of(packets) == std::array<int, 3>{3, 3, 2});
    for (std::size_t i = 1; i < packets.size(); ++i) CHECK(available_at(packets[i - 1]) <= available_at(packets[i]));
    const auto& sample = std::get<ImuSample>(packets[0]);
    CHECK(sample.time.nanoseconds() == 1'696'430'800'000'000'000);
    CHECK(sample.gyro == Eigen::Vector3d(0, 0, 0.5));
    CHECK(sample.accel == Eigen::Vector3d(0.25, 0, 9.75));
    const auto scan = std::ranges::find_if(packets, [](const Packet& p) { return p.index() == 1; });
    const auto& sweep = std::get<LidarScan>(*scan);
    CHECK(sweep.end.nanoseconds() == 1'696'430'800'000'000'000);
    CHECK(sweep.end - sweep.time == std::chrono::milliseconds(100));
    REQUIRE(sweep.cloud.size() == 80);
    CHECK(sweep.cloud.intensities[7] == 200);
    CHECK(sweep.cloud.time_offsets[40] == doctest::Approx(0.05).epsilon(1e-4));  // ahead
    CHECK(sweep.cloud.positions[40].x() == doctest::Approx(10));
    const auto truth = dataset->truth();
    REQUIRE(truth);
    REQUIRE(truth->size() == 3);
    CHECK(truth->poses[1].translation().isApprox(Eigen::Vector3d(1.128, 2, 0), 1e-12));
  }

  TEST_CASE("scenes are named where there are several; what is missing or cut is left out and said") {
    const TemporaryFolder folder;
    write_mars(folder / "MARS");
    const auto error_of = [&](const std::string& name) {
      return io_error([&] { return packets_of(*open_dataset(folder / name)).size(); });
    };
    CHECK(says(error_of("MARS"), "2 scenes: 2023_10_04_scene_3_maisy, empty"));
    CHECK(says(error_of("MARS/other"), "name one of them as if it were a folder"));
    CHECK(says(error_of("MARS/empty"), "no LiDAR scans of the scene empty"));

    const std::string scans = "MARS/sweeps/LIDAR_FRONT_CENTER/1696430800";
    for (std::size_t n = 0; n < 60; ++n) {
      write_bytes(folder / (scans + "100000.pcd.bin"), turn_bytes(3).substr(0, n));
      const auto dataset = open_dataset(folder / "MARS/2023_10_04_scene_3_maisy");
      CHECK(counts_of(packets_of(*dataset))[1] == (n % 20 == 0 ? 3 : 2));
      if (n % 20 != 0)
        CHECK(any_says(dataset->info().warnings, "bytes after the last point"));
      else
        CHECK(any_says(dataset->info().warnings, "1 scans do not turn steadily"));
    }
    std::filesystem::remove(folder / (scans + "200000.pcd.bin"));
    write_bytes(folder / "MARS/sweeps/IMU_TOP/1696430800100000.json", R"({"utime": 1, "avel": [0, )");
    const std::string text = to_text(inspect(folder / "MARS/2023_10_04_scene_3_maisy"));
    CHECK_MESSAGE(says(text, "3 files cannot be read and are left out"), text);
    CHECK(says(text, "truth path"));
  }

  TEST_CASE("a table cut short at any byte is an error that names it") {
    const TemporaryFolder folder;
    write_mars(folder / "MARS");
    for (const char* name : {"scene", "sample", "sensor", "calibrated_sensor", "sample_data"}) {
      const auto path = folder / ("MARS/v1.0/" + std::string(name) + ".json");
      const std::string whole = read_bytes(path);
      for (std::size_t n = 0; n < whole.size(); n += 13) {
        write_bytes(path, whole.substr(0, n));
        const std::string error = io_error([&] { return open_dataset(folder / "MARS/empty")->info().notes.size(); });
        CHECK_MESSAGE((says(error, std::string(name) + ".json, byte") && says(error, "no JSON")), error);
      }
      write_bytes(path, whole);
    }
    write_bytes(folder / "MARS/v1.0/calibrated_sensor.json",
                R"([{"token": "cL", "sensor_token": "L", "translation": [0, 0], "rotation": [1, 0, 0, 0]}])");
    CHECK(says(io_error([&] { return open_dataset(folder / "MARS/2023_10_04_scene_3_maisy")->info().notes.size(); }),
               "calibrated_sensor.json, token cL"));
  }

  TEST_CASE("times by azimuth: either direction, from anywhere; not of rings one after the other") {
    for (const double direction : {1.0, -1.0}) {
      PointCloud<float> cloud;
      for (int i = 0; i < 1000; ++i) {
        const double azimuth = 1.2 + direction * 2 * std::numbers::pi * i / 1000 + (i % 2 == 0 ? 0.05 : -0.05);
        cloud.positions.emplace_back(static_cast<float>(5 * std::cos(azimuth)),
                                     static_cast<float>(5 * std::sin(azimuth)), 0.0F);
      }
      cloud.positions[500].setZero();  // no return: the time of its neighbour
      const auto times = times_by_azimuth(cloud, 0.1);
      REQUIRE(times);
      for (std::size_t i = 0; i < 1000; ++i) {
        CHECK(std::abs((*times)[i] - 1e-4F * static_cast<float>(i)) < 2e-3F);
        CHECK((*times)[i] >= 0);
        CHECK((*times)[i] <= 0.1F);
      }
      PointCloud<float> rings = cloud;
      rings.positions.insert(rings.positions.end(), cloud.positions.begin(), cloud.positions.end());
      CHECK(!times_by_azimuth(rings, 0.1));
    }
    CHECK(!times_by_azimuth({}, 0.1));
  }
}

}  // namespace chainslam::test
