#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "datasets/dataset.hpp"
#include "datasets/files.hpp"
#include "datasets/ground_check.hpp"
#include "datasets/inspect.hpp"
#include "datasets/png_image.hpp"
#include "datasets/ros_bytes.hpp"
#include "support/files.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {
namespace {

using namespace datasets;

/// A grey PNG by the book: rows without filter, in one stored block (RFC 1950, RFC 1951 section 3.2.4).
std::string png(std::uint32_t width, std::uint32_t height, int depth, const std::string& rows) {
  const auto crc = [](const std::string& bytes) {
    std::uint32_t value = 0xFFFFFFFFU;
    for (const char c : bytes) {
      value ^= static_cast<unsigned char>(c);
      for (int i = 0; i < 8; ++i) value = (value >> 1) ^ ((value & 1U) != 0 ? 0xEDB88320U : 0U);
    }
    return value ^ 0xFFFFFFFFU;
  };
  const auto chunk = [&](const std::string& type, const std::string& data) {
    return big(static_cast<std::uint32_t>(data.size())) + type + data + big(crc(type + data));
  };
  std::uint32_t a = 1, b = 0;
  for (const char c : rows) {
    a = (a + static_cast<unsigned char>(c)) % 65521;
    b = (b + a) % 65521;
  }
  const auto size = static_cast<std::uint16_t>(rows.size());
  const std::string stored = std::string("\x78\x01\x01", 3) + little(size) + little(static_cast<std::uint16_t>(~size)) +
                             rows + big(b << 16 | a);
  return "\x89PNG\r\n\x1A\n" +
         chunk("IHDR", big(width) + big(height) + static_cast<char>(depth) + std::string("\0\0\0\0", 4)) +
         chunk("IDAT", stored) + chunk("IEND", "");
}

/// 4 x 2 pixels: ranges 1, 2, 3, 4 m above and 0, 5, 6, 0 m below, in units of 2 mm.
std::string small_image() {
  const auto pixel = [](int metres) { return big(static_cast<std::uint16_t>(500 * metres)); };
  return png(4, 2, 16,
             std::string(1, '\0') + pixel(1) + pixel(2) + pixel(3) + pixel(4) + std::string(1, '\0') + pixel(0) +
                 pixel(5) + pixel(6) + pixel(0));
}

void write_range_images(const TemporaryFolder& folder) {
  write_bytes(folder / "r/data/0000000009.png", small_image());
  write_bytes(folder / "r/data/0000000010.png", small_image());
  write_bytes(folder / "r/velodyne_config.txt", "# made by hand\n500 4 2 180 -180 -30 0");
  write_bytes(folder / "r/timestamps_start.txt", "2011-07-14 13:52:31.000000001\n2011-07-14 13:52:31.100000001\n");
  write_bytes(folder / "r/timestamps_end.txt", "2011-07-14 13:52:31.100000001\n2011-07-14 13:52:31.200000001\n");
}

std::string open_error(const std::filesystem::path& path, const DatasetOptions& options = {}) {
  return io_error([&] {
    const auto dataset = open_dataset(path, options);
    while (dataset->next()) {
    }
    return 0;
  });
}

std::string ascii_pcd(const std::string& fields, const std::string& sizes, const std::string& types,
                      const std::vector<std::string>& points) {
  std::string text = "VERSION 0.7\nFIELDS " + fields + "\nSIZE " + sizes + "\nTYPE " + types + "\nWIDTH " +
                     std::to_string(points.size()) + "\nHEIGHT 1\nDATA ascii\n";
  for (const std::string& point : points) text += point + '\n';
  return text;
}

std::string one_point(const std::string& x) { return ascii_pcd("x y z", "4 4 4", "F F F", {x + " 0 0"}); }

}  // namespace

TEST_SUITE("datasets/files") {
  TEST_CASE("dates become nanoseconds since 1970") {
    CHECK(parse_date_time("1970-01-01 00:00:00")->nanoseconds() == 0);
    CHECK(parse_date_time("2011-07-14 13:52:31.400174941")->nanoseconds() == 1'310'651'551'400'174'941);
    CHECK(parse_date_time("2012-02-29T23:59:60.5")->nanoseconds() == 1'330'560'000'500'000'000);
    for (const char* wrong :
         {"", "2011-07-14", "2011-13-14 13:52:31", "2011-02-30 00:00:00", "2011-07-14 24:00:00", "2011-07-14 13:61:31",
          "2011-07-14 13:52:99", "2011/07/14 13:52:31", "2011-07-14 13:52:xx"})
      CHECK_MESSAGE(!parse_date_time(wrong), wrong);
  }

  TEST_CASE("names state times in the usual ways") {
    CHECK(time_of_name("1326030975000000")->nanoseconds() == 1'326'030'975'000'000'000);
    CHECK(time_of_name("1583836591182590976")->nanoseconds() == 1'583'836'591'182'590'976);
    CHECK(time_of_name("cloud_1583836591_182590976")->nanoseconds() == 1'583'836'591'182'590'976);
    CHECK(time_of_name("1583836591.182590976")->nanoseconds() == 1'583'836'591'182'590'976);
    for (const char* none : {"000042", "scan00001", "cloud", "", "cloud_12_34", "99999999999999999999999"})
      CHECK_MESSAGE(!time_of_name(none), none);
  }

  TEST_CASE("numbers in names sort as numbers") {
    const TemporaryFolder folder;
    for (const char* name : {"10.pcd", "2.pcd", "1.PCD", "a2b.pcd", "a10b.pcd", "note.txt"})
      write_bytes(folder / name, "");
    std::string order;
    for (const auto& file : files_in(folder.path(), {".pcd"})) order += file.filename().string() + ' ';
    CHECK(order == "1.PCD 2.pcd 10.pcd a2b.pcd a10b.pcd ");
    CHECK(files_in(folder / "none", {".pcd"}).empty());
  }
}

TEST_SUITE("datasets/range_image") {
  TEST_CASE("pixels become points by column and row, with the column's time") {
    const TemporaryFolder folder;
    write_range_images(folder);
    const auto dataset = open_dataset(folder / "r");
    CHECK(dataset->info().kind == DatasetKind::range_images);
    const auto scan = std::get<LidarScan>(*dataset->next());
    CHECK(scan.time.nanoseconds() == 1'310'651'551'000'000'001);
    CHECK(scan.end - scan.time == std::chrono::milliseconds(100));
    REQUIRE(scan.cloud.size() == 6);
    // Columns lie at 135, 45, -45 and -135 degrees; the upper row looks 30 degrees up.
    const auto at = [](double range, double azimuth_deg, double up_deg) {
      const double azimuth = azimuth_deg * std::numbers::pi / 180, up = up_deg * std::numbers::pi / 180;
      return Eigen::Vector3d(range * std::cos(up) * std::cos(azimuth), range * std::cos(up) * std::sin(azimuth),
                             range * std::sin(up))
          .cast<float>()
          .eval();
    };
    CHECK(scan.cloud.positions[0].isApprox(at(1, 135, 30)));
    CHECK(scan.cloud.positions[1].isApprox(at(2, 45, 30)));
    CHECK(scan.cloud.positions[2].isApprox(at(5, 45, 0)));
    CHECK(scan.cloud.positions[5].isApprox(at(4, -135, 30)));
    CHECK(scan.cloud.time_offsets[0] == doctest::Approx(0.0125));
    CHECK(scan.cloud.time_offsets[2] == doctest::Approx(0.0375));
    CHECK(scan.cloud.time_offsets[5] == doctest::Approx(0.0875));
    CHECK(dataset->next().has_value());
    CHECK(!dataset->next().has_value());
  }

  TEST_CASE("semicolons, a mask and an INS record: fixes come between the scans") {
    const TemporaryFolder folder;
    write_bytes(folder / "scan00000.png", small_image());
    write_bytes(folder / "scan00001.png", small_image());
    write_bytes(folder / "mask.png", png(4, 2, 8, std::string("\0\xFF\0\xFF\xFF\0\xFF\xFF\xFF\xFF", 10)));
    write_bytes(folder / "img.cfg", "# width; height; ...\n4; 2; 180; -180; -30; 0");
    write_bytes(folder / "imu.cfg",
                "scans - IMU File\n====\n\n;;GPS\ntimestamp;#sats;lat;long;alt\n"
                "2010-03-11 13:49:14.9;5;49.008875;8.4195549;98.9;0.3;2.0;\n2010-03-11 "
                "13:49:15.0;5;49.008875;8.4195548;99.0;0.3;2.0;\n");
    const auto dataset = open_dataset(folder.path());
    std::string kinds;
    while (const auto p = dataset->next()) {
      kinds += std::holds_alternative<GnssFix>(*p) ? 'g' : 'l';
      if (const auto* scan = std::get_if<LidarScan>(&*p)) {
        CHECK(scan->cloud.size() == 5);
        CHECK(scan->end - scan->time == std::chrono::milliseconds(100));
      }
      // Karlsruhe, by WGS 84's closed form.
      if (const auto* fix = std::get_if<GnssFix>(&*p))
        CHECK(fix->position_ecef.norm() == doctest::Approx(6366157).epsilon(1e-4));
    }
    CHECK(kinds == "glgl");
  }

  TEST_CASE("missing lines, wrong sizes, wrong and damaged images are named") {
    const TemporaryFolder folder;
    write_range_images(folder);
    write_bytes(folder / "r/timestamps_end.txt", "2011-07-14 13:52:31.1\n");
    CHECK(says(open_error(folder / "r"), "2 images, but 2 start and 1 end times"));
    write_range_images(folder);
    write_bytes(folder / "r/timestamps_start.txt", "2011-07-14 13:52:31.2\n2011-07-14 13:52:31.1\n");
    CHECK(says(open_error(folder / "r"), "timestamps_start.txt, line 2"));
    write_range_images(folder);
    write_bytes(folder / "r/velodyne_config.txt", "500 4 3 180 -180 -30 0 1 2\n");
    CHECK(says(open_error(folder / "r"), "9 numbers that are no geometry"));
    write_bytes(folder / "r/velodyne_config.txt", "500 5 2 180 -180 -30 0\n");
    CHECK(says(open_error(folder / "r"), "4 x 2 pixels"));
    write_range_images(folder);
    const std::vector<std::pair<std::string, std::string>> damaged{
        {"PNG?", "no PNG image"},
        {png(1, 1, 4, std::string("\0\0", 2)), "not grey of 8 or 16 bits"},
        {png(2048, 2048, 16, std::string("\0\0\0", 3)), "the file is too small for"},
        {png(16384, 16384, 16, std::string("\0\0\0", 3)), "16384 x 16384 pixels, where a range image has 2^22"}};
    for (const auto& [bytes, finding] : damaged) {
      write_bytes(folder / "r/data/0000000009.png", bytes);
      const auto dataset = open_dataset(folder / "r");
      CHECK(counts_of(packets_of(*dataset))[1] == 1);  // the other image
      REQUIRE(dataset->info().warnings.size() == 1);
      CHECK(says(dataset->info().warnings[0], "1 file cannot be read and is left out: "));
      CHECK(says(dataset->info().warnings[0], "0000000009.png, byte "));
      CHECK(says(dataset->info().warnings[0], finding));
    }
  }

  TEST_CASE("any truncation of an image is refused") {
    const TemporaryFolder folder;
    const std::string whole = small_image();
    for (std::size_t n = 0; n < whole.size(); ++n) {
      write_bytes(folder / "i.png", whole.substr(0, n));
      CHECK(!io_error([&] { return read_gray_png(folder / "i.png").width; }).empty());
    }
    write_bytes(folder / "i.png", whole);
    CHECK(read_gray_png(folder / "i.png").at(1, 2) == 3000);
  }
}

TEST_SUITE("datasets/keyframes") {
  TEST_CASE("frames carry odometry made exact, times and clouds; scans without lines are refused") {
    const TemporaryFolder folder;
    write_bytes(folder / "Scans/000000.pcd", one_point("1"));
    write_bytes(folder / "Scans/000001.pcd", one_point("2"));
    write_bytes(folder / "times.txt", "1577836980.0991046\n1577836987.3982084\n1577836988\n");
    write_bytes(folder / "odom_poses.txt",
                "1 0 0 0 0 1 0 0 0 0 1 0\n0.866025 -0.5 0 3 0.5 0.866025 0 4 0 0 1 5\n1 0 0 0 0 1 0 0 0 0 1 0\n");
    const auto dataset = open_dataset(folder.path());
    CHECK(dataset->info().has_odometry);
    CHECK(dataset->info().motion_corrected);
    CHECK(says(dataset->info().notes.at(0), "1 poses have no scan"));
    REQUIRE(dataset->next_frame().has_value());
    const auto frame = dataset->next_frame();
    REQUIRE(frame);
    CHECK(frame->time.nanoseconds() == 1'577'836'987'398'208'400);
    CHECK(frame->T_odom_body.translation() == Eigen::Vector3d(3, 4, 5));
    const Eigen::Matrix3d R = frame->T_odom_body.rotation().matrix();
    CHECK((R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-14);
    CHECK(frame->cloud.positions[0].x() == 2);
    CHECK(!dataset->next_frame());
    CHECK(std::get<LidarScan>(*open_dataset(folder.path())->next()).cloud.positions[0].x() == 1);
    write_bytes(folder / "times.txt", "1577836980.0991046\n");
    CHECK(says(open_error(folder.path()), "2 scans, 1 times, 3 poses"));
  }

  TEST_CASE("two recorded sessions of one square") {
    if (const auto path = real_data("hku_square_two_sessions/session1")) {
      const auto dataset = open_dataset(*path);
      CHECK(dataset->info().kind == DatasetKind::keyframes);
      CHECK(dataset->info().name == "session1");
      Trajectory trajectory;
      while (const auto frame = dataset->next_frame()) trajectory.poses.push_back(frame->T_odom_body);
      CHECK(trajectory.size() == 314);
      CHECK(path_length(trajectory) == doctest::Approx(64).epsilon(0.02));  // the collection's own figure
      CHECK(says(open_error(path->parent_path()), "name one of them: session1, session2"));
    }
  }
}

TEST_SUITE("datasets/clouds") {
  TEST_CASE("times come from a file, from names, or from a rate, which is said") {
    const TemporaryFolder folder;
    for (const char* name : {"9", "10"})
      write_bytes(folder / ("a/clouds/" + std::string(name) + ".pcd"), one_point(name));
    auto dataset = open_dataset(folder / "a", {.scan_rate = 2});
    REQUIRE(dataset->info().warnings.size() == 1);
    CHECK(says(dataset->info().warnings[0], "2 Hz assumed"));
    CHECK(std::get<LidarScan>(*dataset->next()).cloud.positions[0].x() == 9);
    CHECK(std::get<LidarScan>(*dataset->next()).time.nanoseconds() == 500'000'000);
    write_bytes(folder / "a/times.txt", "5.25\n6.5\n");
    dataset = open_dataset(folder / "a");
    CHECK(dataset->info().warnings.empty());
    CHECK(dataset->info().motion_corrected);
    CHECK(std::get<LidarScan>(*dataset->next()).time.nanoseconds() == 5'250'000'000);
    write_bytes(folder / "a/times.txt", "5.25\n");
    CHECK(says(open_error(folder / "a"), "1 times for 2 clouds"));
    write_bytes(folder / "b/1583836591182590976.pcd", one_point("1"));
    write_bytes(folder / "b/1583836591282590976.pcd", one_point("2"));
    CHECK(open_dataset(folder / "b")->info().start->nanoseconds() == 1'583'836'591'182'590'976);
    CHECK(says(open_error(folder / "c"), "no such file or folder"));
  }

  TEST_CASE("a time field is read by what its values mean") {
    const TemporaryFolder folder;
    std::vector<std::string> points;
    for (int i = 0; i <= 100; ++i) points.push_back("1 2 3 " + std::to_string(1'000'000 * i));
    write_bytes(folder / "0.pcd", ascii_pcd("x y z t", "4 4 4 4", "F F F U", points));
    write_bytes(folder / "times.txt", "1583836591\n");
    const auto dataset = open_dataset(folder.path());
    CHECK(!dataset->info().motion_corrected);
    const auto scan = std::get<LidarScan>(*dataset->next());
    CHECK(scan.end - scan.time == std::chrono::milliseconds(100));
    CHECK(scan.cloud.time_offsets[50] == doctest::Approx(0.05));
  }

  TEST_CASE("poses beside the clouds are their truth") {
    const TemporaryFolder folder;
    for (const char* name : {"0", "1"}) {
      write_bytes(folder / ("clouds/" + std::string(name) + ".pcd"), one_point(name));
      write_bytes(folder / ("poses/" + std::string(name) + ".txt"), "1 0 0 " + std::string(name) + " 0 1 0 0 0 0 1 0");
    }
    const auto truth = open_dataset(folder.path())->truth();
    REQUIRE(truth);
    CHECK(truth->poses.at(1).translation().x() == 1);
    CHECK(truth->times.at(1).nanoseconds() == 100'000'000);
  }
}

TEST_SUITE("datasets/open_dataset") {
  TEST_CASE("an unknown folder is answered with the known trees beside what was found") {
    const TemporaryFolder folder;
    write_bytes(folder / "holiday.jpg", "x");
    std::filesystem::create_directory(folder / "more");
    const std::string error = open_error(folder.path());
    CHECK(says(error, "found: holiday.jpg, more/"));
    for (const char* part : {"velodyne_sync/<utime>.bin", "timestamps_start.txt", "odom_poses.txt", "velodyne/"})
      CHECK_MESSAGE(says(error, part), part);
    CHECK(says(open_error(folder / "holiday.jpg"), "name the folder"));
    std::filesystem::create_directory(folder / "empty");
    CHECK(says(open_error(folder / "empty"), "found: nothing"));
  }
}

TEST_SUITE("datasets/ground_check") {
  TEST_CASE("a plane below, a plane above, and points all about") {
    PointCloud<float> cloud;
    for (int i = 0; i < 1000; ++i)
      cloud.positions.emplace_back(4.F + 0.02F * static_cast<float>(i), static_cast<float>(i % 7), -1.8F);
    CHECK(find_ground(cloud).side == GroundSide::below);
    CHECK(find_ground(cloud).height == doctest::Approx(-1.8));
    for (auto& p : cloud.positions) p.z() = 1.8F;
    CHECK(find_ground(cloud).side == GroundSide::above);
    for (std::size_t i = 0; i < cloud.size(); ++i) cloud.positions[i].z() = -4.9F + 0.0098F * static_cast<float>(i);
    CHECK(find_ground(cloud).side == GroundSide::unclear);
    CHECK(find_ground({}).side == GroundSide::unclear);
  }
}

TEST_SUITE("datasets/inspect") {
  TEST_CASE("single files are told apart by name and by their fields") {
    const TemporaryFolder folder;
    const auto text = [&](const char* name, const std::string& bytes) {
      write_bytes(folder / name, bytes);
      return to_text(inspect(folder / name));
    };
    CHECK(says(text("a.txt", "# c\n1 0 0 0 0 0 0 1\n2 3 4 0 0 0 0 1\n"), "TUM trajectory"));
    CHECK(says(text("a.tum", "1 0 0 0 0 0 0 1\n2 3 4 0 0 0 0 1\n"), "5 m, longest step 5 m"));
    CHECK(says(text("k.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n"), "KITTI trajectory"));
    CHECK(says(text("e.csv", "1,0,0,0,1,0,0,0\n"), "EuRoC"));
    CHECK(says(text("n.csv", "1326030975000000,0,0,0,0,0,0\n"), "NCLT ground truth"));
    CHECK(says(text("p.pcd", ascii_pcd("x y z", "4 4 4", "F F F", {"0 0 0", "nan 1 1", "1 2 3"})),
               "! 1 points that are NaN"));
    const std::string graph = text("g.g2o", "VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 4 0 0 0 1 0 0 1 0 1\nWHAT 1\n");
    CHECK(says(graph, "1 vertices, 1 edges, 1 of them not from one id to the next"));
    CHECK(says(graph, "! SE(2): 1 vertices are named by edges but not given"));
    CHECK(says(graph, "! 1 lines of the unknown kind WHAT"));
    CHECK(says(io_error([&] { return text("w.txt", "1 2 3\n"); }), "no known kind"));
  }

  TEST_CASE("a data set's scans, rates, gaps and warnings are told") {
    const TemporaryFolder folder;
    write_range_images(folder);
    const std::string text = to_text(inspect(folder / "r"));
    CHECK(says(text, "data set, range_images"));
    CHECK(says(text, "2, 0.1 s, usually 10 Hz"));
    CHECK(says(text, "12, of a scan 6 to 6, median 6; with times"));
  }

  TEST_CASE("a recorded crossing and a street are told as the collection describes them") {
    if (const auto path = real_data("durlacher_tor")) {
      const std::string text = to_text(inspect(*path));
      CHECK(says(text, "GNSS fixes"));
      CHECK(says(text, "within 15.9 m"));  // 15.9 m driven by the collection's own figure
      CHECK(says(text, "below the sensor"));
    }
    if (const auto path = real_data("nuscenes_scene")) {
      const std::string text = to_text(inspect(*path, {.scan_rate = 2}));
      CHECK(says(text, "39, 19 s, usually 2 Hz"));
      CHECK(says(text, "91.18 m"));
    }
  }
}

}  // namespace chainslam::test
