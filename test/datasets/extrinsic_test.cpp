#include "datasets/extrinsic.hpp"

#include <doctest/doctest.h>

#include <array>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "datasets/ros_bytes.hpp"
#include "support/files.hpp"

namespace chainslam::test {
namespace {

using namespace datasets;

/// A folder of two clouds with an IMU's table, of a body at rest.
void write_clouds(const TemporaryFolder& folder) {
  for (const char* name : {"1.pcd", "2.pcd"})
    write_bytes(folder / ("clouds/" + std::string(name)),
                "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nDATA ascii\n1 0 0\n");
  write_bytes(folder / "times.txt", "10\n10.1\n");
  write_bytes(folder / "imu.csv", "t,gx,gy,gz,ax,ay,az\n9.9,0,0,0,0,0,9.8\n10.0,0,0,0.01,0,0,9.8\n");
}

}  // namespace

TEST_SUITE("datasets/extrinsic") {
  TEST_CASE("every layout of numbers gives the same pose") {
    // A quarter turn to the left, then 30 degrees nose down, then 90 degrees about the new x.
    const std::vector<double> angles{1, 2, 3, 90, 30, 90};
    const auto pose = pose_of_numbers(angles).pose;
    REQUIRE(pose);
    Eigen::Matrix3d yaw, pitch, roll;
    const double c = std::sqrt(0.75);
    yaw << 0, -1, 0, 1, 0, 0, 0, 0, 1;
    pitch << c, 0, 0.5, 0, 1, 0, -0.5, 0, c;
    roll << 1, 0, 0, 0, 0, -1, 0, 1, 0;
    CHECK(pose->rotation().matrix().isApprox(yaw * pitch * roll, 1e-12));
    CHECK(pose->translation() == Eigen::Vector3d(1, 2, 3));
    const Eigen::Quaterniond q = pose->rotation().quaternion();
    const Eigen::Matrix4d m = pose->matrix();
    std::vector<double> matrix;
    for (int row = 0; row < 4; ++row)
      for (int column = 0; column < 4; ++column) matrix.push_back(m(row, column));
    for (const std::vector<double>& numbers : {std::vector<double>{1, 2, 3, q.x(), q.y(), q.z(), q.w()}, matrix,
                                               std::vector<double>(matrix.begin(), matrix.begin() + 12)}) {
      const auto same = pose_of_numbers(numbers).pose;
      REQUIRE(same);
      CHECK(same->local(*pose).norm() < 1e-12);
    }
    // Three decimals, as people write them.
    CHECK(pose_of_numbers(std::array{0.0, 0.0, 0.0, 0.0, 0.0, 0.707, 0.707}).pose);
  }

  TEST_CASE("numbers that are no pose are told what they are") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const std::vector<std::pair<std::vector<double>, const char*>> wrong{
        {{}, "0 numbers, which are no pose"},
        {{1, 2, 3}, "3 numbers, which are no pose"},
        {{1, 2, 3, 0, 0, nan}, "not finite"},
        {{1, 2, 3, 0, 0, 0, 0}, "quaternion qx qy qz qw of length 0.0"},
        {{1, 2, 3, 0, 0, 90, 1}, "quaternion qx qy qz qw of length 90.0"},
        {{1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1, 0}, "left 3x3 part is no rotation"},
        {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0}, "left 3x3 part is no rotation"},
        {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2}, "last row is not 0 0 0 1"}};
    for (const auto& [numbers, problem] : wrong) {
      const PoseNumbers found = pose_of_numbers(numbers);
      CHECK(!found.pose);
      CHECK_MESSAGE(says(found.problem, problem), found.problem);
    }
  }

  TEST_CASE("a folder of clouds states it in T_body_lidar.txt or calib_imu_to_velo.txt; a given one comes first") {
    const TemporaryFolder folder;
    write_clouds(folder);
    const auto info = [&](const DatasetOptions& options = {}) { return open_dataset(folder.path(), options)->info(); };
    CHECK(info().T_body_lidar == SE3d());
    CHECK(any_says(info().warnings, "set dataset.T_body_lidar"));
    CHECK_FALSE(info().extrinsic_known);
    write_bytes(folder / "calib_imu_to_velo.txt", "R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n");
    CHECK(info().T_body_lidar.translation().isApprox(Eigen::Vector3d(0.8, -0.3, 0.8)));
    CHECK(any_says(info().notes, "T_body_lidar from calib_imu_to_velo.txt"));
    write_bytes(folder / "T_body_lidar.txt", "# on the mast\n0.5, 0, 1.25\n0 0 180\n");
    CHECK(info().T_body_lidar.translation() == Eigen::Vector3d(0.5, 0, 1.25));
    CHECK((info().T_body_lidar.rotation() * Eigen::Vector3d::UnitX()).isApprox(-Eigen::Vector3d::UnitX()));
    CHECK(any_says(info().notes, "T_body_lidar from T_body_lidar.txt"));
    CHECK(!any_says(info().warnings, "T_body_lidar"));
    CHECK(info().extrinsic_known);
    const DatasetInfo given = info({.T_body_lidar = SE3d(SO3d(), {7, 8, 9})});
    CHECK(given.T_body_lidar.translation() == Eigen::Vector3d(7, 8, 9));
    CHECK(any_says(given.notes, "as set by dataset.T_body_lidar; that of T_body_lidar.txt is not used"));
  }

  TEST_CASE("a file that holds no pose is named, with what it holds and what to write") {
    const TemporaryFolder folder;
    write_clouds(folder);
    const auto error = [&](const std::string& text) {
      write_bytes(folder / "T_body_lidar.txt", text);
      return io_error([&] { return open_dataset(folder.path())->info().name; });
    };
    for (const auto& [text, finding] :
         std::vector<std::pair<std::string, std::string>>{{"1 2 3\n", "3 numbers, which are no pose"},
                                                          {"", "0 numbers, which are no pose"},
                                                          {"0 0 0 1 1 1 1\n", "of length 2.0"},
                                                          {"# x\n0 0 zero 0 0 0\n", "line 2, field pose"}}) {
      const std::string found = error(text);
      CHECK_MESSAGE(says(found, finding), found);
      CHECK(says(found, "T_body_lidar.txt"));
    }
    CHECK(says(error("1 2 3\n"), "write x y z roll pitch yaw"));
  }
}

TEST_SUITE("datasets/imu_conversion") {
  TEST_CASE("given units count, and times are shifted before samples and scans are put in order") {
    const TemporaryFolder folder;
    write_clouds(folder);
    const auto samples = [&](const DatasetOptions& options) {
      std::vector<ImuSample> found;
      for (const Packet& packet : packets_of(*open_dataset(folder.path(), options)))
        if (const auto* sample = std::get_if<ImuSample>(&packet)) found.push_back(*sample);
      return found;
    };
    CHECK(samples({}).at(1).gyro.z() == 0.01);
    CHECK(samples({}).at(1).time == Timestamp::from_seconds(10));
    const auto converted = samples({.imu_units = ImuUnitsGiven::g_and_degrees});
    CHECK(converted.at(1).gyro.z() == doctest::Approx(0.01 * 3.14159265358979 / 180));
    CHECK(converted.at(1).accel.z() == doctest::Approx(9.8 * 9.80665));
    CHECK(samples({.imu_units = ImuUnitsGiven::degrees}).at(1).accel.z() == 9.8);
    CHECK(samples({.imu_units = ImuUnitsGiven::g}).at(1).gyro.z() == 0.01);
    CHECK(samples({.imu_time_offset = seconds(0.05)}).at(1).time == Timestamp::from_seconds(10.05));
    // 10.0 plus 0.05 lies behind the first scan.
    const auto packets = packets_of(*open_dataset(folder.path(), {.imu_time_offset = seconds(0.05)}));
    REQUIRE(packets.size() == 4);
    CHECK(packets[0].index() == 0);
    CHECK(packets[1].index() == 1);
    CHECK(packets[2].index() == 0);
  }

  TEST_CASE("a row of a time that is none, or far ahead, costs that row and no other") {
    const TemporaryFolder folder;
    write_clouds(folder);
    std::string table = "t,gx,gy,gz,ax,ay,az\n";
    for (int i = 0; i < 300; ++i) {
      const char* time = i == 50 ? "1e30" : i == 100 ? "99" : i == 200 ? "3" : nullptr;
      table += (time != nullptr ? time : std::to_string(9 + 0.005 * i)) + ",0,0,0.01,0,0,9.8\n";
    }
    write_bytes(folder / "imu.csv", table);
    const auto dataset = open_dataset(folder.path());
    CHECK(packets_of(*dataset).size() == 297 + 2);
    CHECK(any_says(dataset->info().warnings, "1 rows of imu.csv skipped that hold no number, or no time"));
    CHECK(any_says(dataset->info().warnings, "1 rows of imu.csv left out whose time is ahead of the next row's"));
    CHECK(any_says(dataset->info().warnings, "1 packets dropped that went back in time"));
  }

  TEST_CASE("spikes at a table's beginning do not hide its units") {
    const TemporaryFolder folder;
    write_clouds(folder);
    std::string table = "t,gx,gy,gz,ax,ay,az\n";
    for (int i = 0; i < 1000; ++i)
      table += std::to_string(9 + 0.01 * i) + (i % 100 == 7 ? ",1e30,0,0.1,0,-1e9,1\n" : ",0,0,0.1,0,0,1\n");
    write_bytes(folder / "imu.csv", table);
    CHECK(any_says(open_dataset(folder.path())->info().notes, "acceleration in g"));
  }
}

}  // namespace chainslam::test
