#include <doctest/doctest.h>

#include <limits>

#include "chainslam/io/trajectory_file.hpp"
#include "support/files.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {
namespace {

Trajectory tum(const std::string& text) {
  const TemporaryFolder folder;
  write_bytes(folder / "t.tum", text);
  return read_tum(folder / "t.tum");
}

std::string tum_error(const std::string& text) {
  return io_error([&] { return tum(text).size(); });
}

Trajectory kitti(const std::string& text) {
  const TemporaryFolder folder;
  write_bytes(folder / "k.txt", text);
  return read_kitti_poses(folder / "k.txt");
}

std::string kitti_error(const std::string& text) {
  return io_error([&] { return kitti(text).size(); });
}

}  // namespace

TEST_SUITE("io/tum") {
  TEST_CASE("seconds become nanoseconds digit by digit") {
    const auto nanoseconds = [](const char* text) { return detail::parse_seconds(text); };
    CHECK(nanoseconds("1403715524.907143168") == 1'403'715'524'907'143'168);
    CHECK(nanoseconds("1.305031102175300121e+09") == 1'305'031'102'175'300'121);
    CHECK(nanoseconds("0.1234567894") == 123'456'789);
    CHECK(nanoseconds("0.1234567895") == 123'456'790);
    CHECK(nanoseconds("-0.5") == -500'000'000);
    CHECK(nanoseconds("-1e-9") == -1);
    CHECK(nanoseconds("1e-10") == 0);
    CHECK(nanoseconds("6e-10") == 1);
    CHECK(nanoseconds("7.") == 7'000'000'000);
    CHECK(nanoseconds(".25") == 250'000'000);
    CHECK(nanoseconds("+3") == 3'000'000'000);
    CHECK(nanoseconds("4294967295.999999999") == 4'294'967'295'999'999'999);  // the last that ROS 1 can state, in 2106
    CHECK(nanoseconds("-4600000000") == -latest_nanoseconds);
    for (const char* wrong : {"", "-", ".", "1.2.3", "1,5", "nan", "inf", "0x10", "1e", "1e999", "1 ",
                              "4600000000.000000001", "9223372036.854775808", "1403715524907143168", "--1", "1e+-3"})
      CHECK_MESSAGE(!nanoseconds(wrong), wrong);
  }

  TEST_CASE("stamps are written with nine decimals, exactly") {
    const auto text = [](std::int64_t value) {
      std::string line;
      detail::append_seconds(line, Timestamp::from_nanoseconds(value));
      return line;
    };
    CHECK(text(0) == "0.000000000");
    CHECK(text(1'403'715'524'907'143'168) == "1403715524.907143168");
    CHECK(text(-1) == "-0.000000001");
    CHECK(text(-1'500'000'000) == "-1.500000000");
    CHECK(text(std::numeric_limits<std::int64_t>::min()) == "-9223372036.854775808");
  }

  TEST_CASE("comments, blank lines, tabs, CRLF and a byte order mark are accepted") {
    const Trajectory t = tum("\xEF\xBB\xBF# t x y z\r\n\r\n1.5 1 2 3\t0 0 0 1\r\n  2 -1e-3 +2.5 3 0 0 1 0");
    REQUIRE(t.size() == 2);
    CHECK(t.times[0].nanoseconds() == 1'500'000'000);
    CHECK(t.poses[0].translation() == Eigen::Vector3d(1, 2, 3));
    CHECK(t.poses[1].translation() == Eigen::Vector3d(-0.001, 2.5, 3));
    CHECK(t.poses[1].rotation().matrix().isApprox(Eigen::Vector3d(-1, -1, 1).asDiagonal().toDenseMatrix(), 1e-15));
  }

  TEST_CASE("an empty file, comments alone and one pose are trajectories") {
    CHECK(tum("").empty());
    CHECK(tum("# nothing\n").empty());
    CHECK(tum("0 0 0 0 0 0 0 1").size() == 1);
  }

  TEST_CASE("a round trip changes no bit of times and positions") {
    const TemporaryFolder folder;
    Trajectory t;
    for (int i = 0; i < 50; ++i) {
      t.times.push_back(Timestamp::from_nanoseconds(1'577'836'980'123'456'789 + i * 100'000'007LL));
      const Eigen::Quaterniond q(1.0, 0.1 * i, -0.3, 0.05 * i * i);
      t.poses.push_back(SE3d(SO3d::from_quaternion(q), {i / 3.0, 1e-300 * i, -1e15 / 7}));
    }
    write_tum(folder / "a.tum", t);
    const Trajectory back = read_tum(folder / "a.tum");
    REQUIRE(back.times == t.times);
    for (std::size_t i = 0; i < t.size(); ++i) {
      CHECK(back.poses[i].translation() == t.poses[i].translation());
      // Normalizing once more may change the last bit.
      CHECK((back.poses[i].rotation().matrix() - t.poses[i].rotation().matrix()).norm() < 1e-15);
    }
    CHECK_THROWS_AS(write_tum(folder / "b.tum", Trajectory{{}, t.poses}), std::invalid_argument);
    CHECK(folder.files() == 1);
  }

  TEST_CASE("errors name line and field and say what to do") {
    const std::string good = "1 0 0 0 0 0 0 1\n";
    const std::string order = tum_error(good + "# c\n0.5 0 0 0 0 0 0 1\n");
    CHECK(says(order, "t.tum, line 3, field t"));
    CHECK(says(order, "sort the lines"));
    CHECK(tum(good + good).size() == 2);
    CHECK(says(tum_error(good + "2 0 zero 0 0 0 0 1\n"), "line 2, field y\n  found: 'zero'"));
    CHECK(says(tum_error("1,5 0 0 0 0 0 0 1\n"), "decimals with a point"));
    CHECK(says(tum_error("1 0,5 0 0 0 0 0 1\n"), "decimals with a point"));
    CHECK(says(tum_error("1403715524907143168 0 0 0 0 0 0 1\n"), "nanoseconds"));
    CHECK(says(tum_error("1 0 0 0 0 0 0\n"), "field qw\n  found: the end of the line"));
    CHECK(says(tum_error("1 0 0 0 0 0 0 1 7\n"), "eight fields"));
    CHECK(says(tum_error("1 nan 0 0 0 0 0 1\n"), "field x\n  found: 'nan'"));
    CHECK(says(tum_error("1 0 0 inf 0 0 0 1\n"), "field z"));
    CHECK(says(tum_error("1 0 0 1e999 0 0 0 1\n"), "field z"));
    CHECK(says(tum_error("1 0 0 0 0 0 0 0\n"), "length 0.0"));
    CHECK(says(tum_error("1 0 0 0 0 0 0 1.002\n"), "unit quaternion"));
    CHECK(tum("1 0 0 1e-999 0 0 0 1.0009\n").size() == 1);
    CHECK(says(tum_error(std::string("PK\x03\x04\0\0\x01", 7)), "field t"));
    CHECK(says(tum_error(std::string((1 << 20) + 100, 'x')), "1 MiB"));
    CHECK(says(io_error([] { return read_tum("/nowhere/t.tum").size(); }), "no such file"));
    const TemporaryFolder folder;
    CHECK(says(io_error([&] { return read_tum(folder.path()).size(); }), "a folder"));
  }

  TEST_CASE("any truncation gives an error or whole poses") {
    const std::string text = "1.25 1 2 3 0 0 0 1\n2.25 4 5 6 0 0 0 1\n";
    for (std::size_t n = 0; n < text.size(); ++n) {
      Trajectory t;
      const std::string error = io_error([&] { return (t = tum(text.substr(0, n))).size(); });
      CHECK((!error.empty() || t.size() == (n >= 37 ? 2 : n >= 18 ? 1 : 0)));
      if (t.size() == 2) CHECK(t.poses[1].translation() == Eigen::Vector3d(4, 5, 6));
    }
  }

  TEST_CASE("real trajectories are read with their exact stamps") {
    if (const auto path = real_data("trajectories/evo/freiburg1_xyz-groundtruth.txt"))
      CHECK(read_tum(*path).size() == 3000);
    if (const auto path = real_data("kitti00_first101/kitti00_first101/poses_kitti_gt.tum"))
      CHECK(read_tum(*path).size() == 101);
  }
}

TEST_SUITE("io/kitti") {
  TEST_CASE("rows of twelve become poses without times") {
    const Trajectory t = kitti("1 0 0 4 0 1 0 5 0 0 1 6\n0 -1 0 1 1 0 0 2 0 0 1 3\r\n");
    REQUIRE(t.size() == 2);
    CHECK(!t.has_times());
    CHECK(t.poses[0].translation() == Eigen::Vector3d(4, 5, 6));
    CHECK((t.poses[1].rotation().matrix() * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm() < 1e-15);
  }

  TEST_CASE("six digits are accepted and made exact; mirrors, scales and odd rows are refused") {
    const Eigen::Matrix3d R = kitti("0.866025 -0.5 0 0 0.5 0.866025 0 0 0 0 1 0").poses[0].rotation().matrix();
    CHECK((R.transpose() * R - Eigen::Matrix3d::Identity()).norm() < 1e-15);
    CHECK(says(kitti_error("-1 0 0 0 0 1 0 0 0 0 1 0"), "no rotation"));
    CHECK(says(kitti_error("1 0 0 0 0 1 0 0 0 0 1.002 0"), "no rotation"));
    CHECK(says(kitti_error("0 0 0 0 0 0 0 0 0 0 0 0"), "no rotation"));
    CHECK(says(kitti_error("1 0 0 0 0 1 0 0 0 0 1"), "line 1, field z"));
    CHECK(says(kitti_error("1 0 0 0 0 1 0 0 0 0 1 0 0"), "twelve"));
    CHECK(says(kitti_error("1 0 0 nan 0 1 0 0 0 0 1 0"), "field x"));
  }

  TEST_CASE("poses survive a round trip") {
    const TemporaryFolder folder;
    Trajectory t;
    t.poses.push_back(SE3d(SO3d::from_quaternion(Eigen::Quaterniond(0.3, 0.1, -0.7, 0.2)), {1.1, -2e9, 3e-9}));
    write_kitti_poses(folder / "k.txt", t);
    const Trajectory back = read_kitti_poses(folder / "k.txt");
    REQUIRE(back.size() == 1);
    CHECK(back.poses[0].translation() == t.poses[0].translation());
    CHECK((back.poses[0].rotation().matrix() - t.poses[0].rotation().matrix()).norm() < 1e-14);
  }

  TEST_CASE("scans are four floats a point, whole or refused") {
    const TemporaryFolder folder;
    std::string bytes;
    for (const float value : {1.F, 2.F, 3.F, 0.5F, -1.F, std::numeric_limits<float>::quiet_NaN(), -3.F, 1.F})
      bytes += little(value);
    for (std::size_t n = 0; n <= bytes.size(); ++n) {
      write_bytes(folder / "s.bin", std::string_view(bytes).substr(0, n));
      std::size_t size = 99;
      const std::string error = io_error([&] { return size = read_kitti_bin(folder / "s.bin").size(); });
      if (n % 16 == 0)
        CHECK(size == n / 16);
      else
        CHECK(says(error, "byte " + std::to_string(n - n % 16)));
    }
    const PointCloud<float> cloud = read_kitti_bin(folder / "s.bin");
    CHECK(cloud.positions[0] == Eigen::Vector3f(1, 2, 3));
    CHECK(cloud.intensities == std::vector<float>{0.5F, 1});
    CHECK(std::isnan(cloud.positions[1].y()));
  }

  TEST_CASE("evo's KITTI files are read whole") {
    if (const auto path = real_data("trajectories/evo/KITTI_00_gt.txt")) {
      const Trajectory t = read_kitti_poses(*path);
      CHECK(t.size() == 4541);
      CHECK(path_length(t) == doctest::Approx(3724.187).epsilon(1e-6));  // evo_traj's figure for KITTI 00
    }
    if (const auto path = real_data("registration_pairs/kitti00_094_095"))
      for (const auto& entry : std::filesystem::recursive_directory_iterator(*path))
        if (entry.path().extension() == ".bin") CHECK(read_kitti_bin(entry.path()).size() > 100'000);
  }
}

TEST_SUITE("io/euroc_csv") {
  TEST_CASE("nanoseconds, w before x, fields after the pose skipped") {
    const TemporaryFolder folder;
    write_bytes(
        folder / "e.csv",
        "#timestamp, p_x, ...\r\n1403715524907143168,0.5, 2 ,1,0,0,0,1,9,oops\n1403715524912143104,1,2,3,1,0,0,0\n");
    const Trajectory t = read_euroc_csv(folder / "e.csv");
    REQUIRE(t.size() == 2);
    CHECK(t.times[0].nanoseconds() == 1'403'715'524'907'143'168);
    CHECK(t.poses[0].translation() == Eigen::Vector3d(0.5, 2, 1));
    CHECK((t.poses[0].rotation().matrix() - Eigen::Vector3d(-1, -1, 1).asDiagonal().toDenseMatrix()).norm() < 1e-15);
  }

  TEST_CASE("errors name line and field") {
    const TemporaryFolder folder;
    const auto error = [&](const std::string& text) {
      write_bytes(folder / "e.csv", text);
      return io_error([&] { return read_euroc_csv(folder / "e.csv").size(); });
    };
    CHECK(says(error("5,0,0,0,1,0,0,0\n4,0,0,0,1,0,0,0\n"), "line 2, field timestamp"));
    CHECK(says(error("1.5,0,0,0,1,0,0,0\n"), "whole number"));
    CHECK(says(error("1,0,0,0,1,0,0\n"), "field qz"));
    CHECK(says(error("1,0,,0,1,0,0,0\n"), "field y"));
    CHECK(says(error("1,0,0,0,0,0,0,0.5\n"), "w x y z"));
  }

  TEST_CASE("EuRoC V102's truth is read") {
    if (const auto path = real_data("trajectories/evo/V102_groundtruth.csv"))
      CHECK(read_euroc_csv(*path).size() == 16702);
  }
}

}  // namespace chainslam::test
