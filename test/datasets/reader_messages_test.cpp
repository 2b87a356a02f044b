#include <doctest/doctest.h>

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "datasets/dataset.hpp"
#include "datasets/inspect.hpp"
#include "datasets/png_image.hpp"
#include "datasets/recorded_rows.hpp"
#include "datasets/ros_bytes.hpp"
#include "datasets/ros_message.hpp"
#include "datasets/ros_recording.hpp"
#include "support/files.hpp"
#include "support/source_calls.hpp"

// The messages of the data sets' readers: what each is about, where, and what helps. A test below finds the places in
// the sources that none of these cases comes from.

namespace chainslam::test {
namespace {

using namespace datasets;
namespace fs = std::filesystem;

struct DatasetCase {
  std::map<std::string, std::string> files;
  std::string path;   ///< that the message names, in the folder
  std::string place;  ///< "" if the whole file is meant
  std::string found, remedy;
  std::string opened{};  ///< what is opened in the folder; "" is itself
  DatasetOptions options{};
};

const std::string floats(16, '\0');
const std::string pose_row = "1 0 0 0 0 1 0 0 0 0 1 0\n";
const std::string pcd_of_one_point = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 1\nDATA ascii\n1 2 3\n";

/// Files with some added, changed or, where their text is "-", left out.
std::map<std::string, std::string> with(std::map<std::string, std::string> files,
                                        const std::map<std::string, std::string>& changes) {
  for (const auto& [name, text] : changes)
    if (text == "-")
      files.erase(name);
    else
      files[name] = text;
  return files;
}

const std::map<std::string, std::string> clouds{{"0.bin", floats}, {"1.bin", floats}, {"times.txt", "1\n2\n"}};
const std::map<std::string, std::string> kitti{{"velodyne/0.bin", floats},
                                               {"times.txt", "1\n"},
                                               {"calib.txt", "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n"},
                                               {"poses.txt", pose_row}};
const std::map<std::string, std::string> raw{{"velodyne_points/timestamps_start.txt", "2011-09-26 13:02:25.0\n"},
                                             {"velodyne_points/timestamps_end.txt", "2011-09-26 13:02:25.1\n"},
                                             {"velodyne_points/data/0.bin", floats}};
const std::map<std::string, std::string> recorded{
    {"Scans/0.pcd", pcd_of_one_point},
    {"times.txt", "1\n"},
    {"odom_poses.txt", pose_row},
    {"odometry.json",
     R"({"format": "chainslam odometry", "version": 1, "session": "a", "odometry": "lidar", "source": "",
         "truth_frame": "", "scans": 1, "frames": 1, "lost_frames": 0, "notes": [],
         "keyframes": {"distance": 1, "angle": 1, "scan_voxel": 1, "scan_step": 1}})"}};

/// `recorded` with a table of one frame.
std::map<std::string, std::string> recorded_frame(const std::string& keyframe, const std::string& status = "good",
                                                  const std::string& variance = "1",
                                                  const std::string& delta_velocity = ",,") {
  std::string row = "1," + keyframe + "," + status + ",0,0,all,1,1,1,0.1,0,0,0,0,0,0,1";
  for (int i = 0; i < 21; ++i) row += "," + variance;
  return with(recorded, {{"frames.csv", frame_table_head() + row + "," + delta_velocity + "\n"}});
}

const std::map<std::string, std::string> nclt{{"velodyne_sync/1326030975000000.bin", std::string(8, '\0')}};
const std::map<std::string, std::string> images{{"data/0.png", "PNG"},
                                                {"velodyne_config.txt", "500 4 2 180 -180 -30 0\n"},
                                                {"timestamps_start.txt", "2011-07-14 13:52:31.1\n"},
                                                {"timestamps_end.txt", "2011-07-14 13:52:31.2\n"}};
const std::map<std::string, std::string> mars{
    {"v1.0/scene.json", R"([{"token": "s", "name": "a"}])"},
    {"v1.0/sample.json", R"([{"token": "m", "scene_token": "s", "timestamp": 1}])"},
    {"v1.0/sensor.json", R"([{"token": "L", "channel": "LIDAR_TOP", "modality": "lidar"}])"},
    {"v1.0/calibrated_sensor.json",
     R"([{"token": "c", "sensor_token": "L", "translation": [0, 0, 1], "rotation": [1, 0, 0, 0]}])"},
    {"v1.0/sample_data.json",
     R"([{"token": "d", "sample_token": "m", "ego_pose_token": "e", "calibrated_sensor_token": "c", "timestamp": 1,
          "filename": "sweeps/a.bin"}])"},
    {"v1.0/ego_pose.json", "[]"}};

std::vector<DatasetCase> dataset_cases() {
  const std::string again = "the file was cut short or damaged: copy it again";
  const auto changed = [](const std::string& text, const std::string& from, const std::string& to) {
    std::string result = text;
    return result.replace(result.find(from), from.size(), to);
  };
  const std::string inspva = "Inertial_data/inspva.csv", scan = "LiDAR/Ouster/1691936500000000000.bin";
  return {
      // Recorded odometry.
      {with(recorded_frame("0"), {{"odometry.json", "{\"format\": 7}"}}), "odometry.json", "",
       "no description of recorded odometry", "record it again with `chainslam odometry`; without this file"},
      {with(recorded_frame("0"), {{"odometry.json", "{}"}}), "odometry.json", "", "no description of recorded odometry",
       "record it again with `chainslam odometry`; without this file"},
      {with(recorded_frame("0"),
            {{"odometry.json", changed(recorded.at("odometry.json"), "version\": 1", "version\": 9")}}),
       "odometry.json", "version", "9", "this program reads version 1: record the odometry again"},
      {with(recorded_frame("0"),
            {{"odometry.json", changed(recorded.at("odometry.json"), "\"scans\": 1", "\"scans\": -1")}}),
       "odometry.json", "", "scans = -1", "the file was changed: record the odometry again"},
      {with(recorded_frame("0"), {{"frames.csv", "time\n"}}), "frames.csv", "line 1", "other columns",
       "record the odometry again: this table is not of this version"},
      {recorded_frame("1"), "frames.csv", "line 2, field keyframe", "1", "keyframes are numbered from 0 on"},
      {recorded_frame("-2"), "frames.csv", "line 2, field keyframe", "-2",
       "write a whole number from -1 to 2147483647"},
      {recorded_frame("0", "fine"), "frames.csv", "line 2, field status", "'fine'",
       "write one of good, degenerate, lost"},
      {recorded_frame("0", "good", "-1"), "frames.csv", "line 2, field covariance", "-1",
       "write a covariance: its diagonal is not negative"},
      {recorded_frame("0", "good", "1", "0.1,fast,9.8"), "frames.csv", "line 2, field delta velocity", "'fast'",
       "write three finite numbers, or leave all three empty"},
      {recorded_frame("0", "good", "1", "0.1,,9.8"), "frames.csv", "line 2, field delta velocity", "''",
       "write three finite numbers, or leave all three empty"},
      {recorded_frame("0", "good", "1", "1e39,0,0"), "frames.csv", "line 2, field delta velocity", "'1e39'",
       "write three finite numbers, or leave all three empty"},
      {recorded_frame("0", "good", "1", "0,0,9.8,1"), "frames.csv", "line 2, field after the last", "'1'",
       "each line holds 41 fields"},
      {with(recorded_frame("0"), {{"frames.csv", frame_table_head()}}), "frames.csv", "",
       "0 frames and 0 keyframes, not 1 and 1", "the recording was cut short or mixed with another: copy it again"},
      // What a path holds.
      {{}, "none", "", "no such file or folder", "check the path", "none"},
      {{{"a.xyz", "1"}},
       "a.xyz",
       "",
       "a file of no known kind of recording",
       "name the folder that holds the data set, or a recording (.bag, .mcap, .db3)",
       "a.xyz"},
      {{{"notes/a.xyz", "1"}}, "", "", "notes/", "give one of these kinds:"},
      {{{"a/0.bin", floats}, {"b/0.bin", floats}}, "", "", "2 data sets", "name one of them: a, b"},
      // Folders of clouds and their times.
      {{{"a.xyz", ""}},
       "",
       "",
       "a.xyz",
       "a folder of .pcd, .ply or .bin clouds is needed",
       "",
       {.kind = DatasetKind::clouds}},
      {{{"a_1326030975_2.bin", floats}, {"b_1326030975_1.bin", floats}, {"c_1326030974_9.bin", floats}},
       "",
       "",
       "names whose times are not in order",
       "name the files so that they sort by time",
       "",
       {.kind = DatasetKind::clouds}},
      {{{"a.bin", floats}},
       "",
       "",
       "no times of the clouds",
       "add times.txt with one time in seconds a line, or give a rate",
       "",
       {.scan_rate = 0}},
      {with(clouds, {{"times.txt", "1\n"}}), "times.txt", "", "1 times for 2 clouds", "give one line for each cloud"},
      {with(clouds, {{"times.txt", "2\n1\n"}}), "times.txt", "line 2", "a time that is earlier than the one before it",
       "scans come in the order of time"},
      {with(clouds, {{"times.txt", "1\nnoon\n"}}), "times.txt", "line 2", "'noon'",
       "write one time a line: seconds, or YYYY-MM-DD hh:mm:ss.nnn"},
      {with(clouds, {{"poses/0.txt", ""}, {"poses/1.txt", ""}}), "poses/0.txt", "", "no pose",
       "write a row-major 3x4 matrix into it"},
      {with(clouds, {{"T_body_lidar.txt", "1 2 3 0 0 0 2"}}), "T_body_lidar.txt", "",
       "a quaternion qx qy qz qw of length 2.000000 instead of 1", "write x y z roll pitch yaw"},
      {with(clouds, {{"imu.csv", "time,a,b\n"}}), "imu.csv", "line 1", "'time,a,b'",
       "name the columns: timestamp, gyro_x, gyro_y, gyro_z, acc_x, acc_y, acc_z"},
      {with(clouds, {{"imu.csv", "sec,nsec,gx,gy,gz,ax,ay,az\n1,1000000000,0,0,0,0,0,9.8\n"}}), "imu.csv",
       "line 2, field nanoseconds", "1000000000", "write what is beyond the whole second, below 1e9"},
      {with(clouds, {{"imu.csv", "time,gx,gy,gz,ax,ay,az\n1,0,0,0,0,0,9,8\n"}}), "imu.csv",
       "line 2, field after the last", "'8'",
       "each line holds as many fields as the header names, and decimals are written with a point"},
      // Keyframes.
      {{{"Scans/0.pcd", pcd_of_one_point},
        {"Scans/1.pcd", pcd_of_one_point},
        {"times.txt", "1\n2\n"},
        {"odom_poses.txt", pose_row}},
       "",
       "",
       "2 scans, 2 times, 1 poses",
       "give at least one line of times.txt and of odom_poses.txt for each scan"},
      {{{"Scans/0.pcd", pcd_of_one_point},
        {"times.txt", "1\n"},
        {"odom_poses.txt", pose_row},
        {"gnss.txt", "1 2 3 4 5\n"}},
       "gnss.txt",
       "line 1, field after the last",
       "'5'",
       "each line holds four fields: latitude longitude height deviation"},
      // KITTI.
      {with(kitti, {{"velodyne/1.bin", floats}}), "", "", "2 scans in velodyne, 1 lines in times.txt",
       "give one line of times.txt for each scan"},
      {with(kitti, {{"calib.txt", "P0: 1\n"}}), "calib.txt", "entry Tr", "no such line",
       "the file should hold a line `Tr:` with 12 numbers"},
      {with(kitti, {{"calib.txt", "Tr: 2 0 0 0 0 1 0 0 0 0 1 0\n"}}), "calib.txt", "entry Tr",
       "a matrix that is no rotation", "the file is damaged: copy it again"},
      {with(kitti, {{"poses.txt", pose_row + pose_row}}), "poses.txt", "", "2 poses for 1 times",
       "give the poses of this sequence"},
      {with(raw, {{"velodyne_points/data/7.bin", floats}}), "velodyne_points/data/7.bin", "",
       "no line of the stamps belongs to it, of which there are 1",
       "files are named by the number of their line, from 0"},
      {with(raw, {{"velodyne_points/timestamps_end.txt", "2011-09-26 13:02:24.1\n"}}), "velodyne_points", "",
       "starts and ends of sweeps that do not belong together",
       "copy timestamps_start.txt and timestamps_end.txt again"},
      {with(raw, {{"velodyne_points/data/0.bin", "-"}}), "velodyne_points/data", "", "no scans",
       "put the drive's scans there"},
      // NCLT.
      {{{"velodyne_data/a/velodyne_hits.bin", ""}, {"velodyne_data/b/velodyne_hits.bin", ""}},
       "velodyne_data",
       "",
       "2 sessions",
       "put the files of one session into a folder and name that"},
      {{{"velodyne_data/a/ms25.csv", ""}},
       "",
       "",
       "neither velodyne_hits.bin nor files in velodyne_sync",
       "put the session's LiDAR data beside its other files"},
      {{{"velodyne_sync/7.bin", ""}},
       "velodyne_sync/7.bin",
       "",
       "a name that is no time",
       "scans are named by microseconds since 1970"},
      {{{"velodyne_hits.bin", "abc"}},
       "velodyne_hits.bin",
       "byte 0",
       "the end of the file within a packet's header",
       "the file is damaged or was cut short: copy it again"},
      {{{"velodyne_hits.bin", std::string(24, 'x')}},
       "velodyne_hits.bin",
       "byte 0",
       "no packet (four times 44444 expected, found 30840)",
       "the file is damaged or was cut short: copy it again"},
      {with(nclt, {{"groundtruth.csv", "2,0,0,0,0,0,0\n1,0,0,0,0,0,0\n"}}), "groundtruth.csv", "utime 1",
       "a time that is earlier than the one before it", "sort the rows by time"},
      {with(nclt, {{"gps.csv", "9000000000000000,3,8,0,0,0,0,0\n"}}), "gps.csv", "line 1, field time",
       "9000000000000000", "write us since 1970"},
      // MulRan, HeLiPR, Newer College.
      {{{"Ouster/7.bin", floats}},
       "Ouster/7.bin",
       "",
       "a name that is no time",
       "scans are named by the time of their start"},
      {{{"Ouster/1561000444390857630.bin", floats},
        {"global_pose.csv", "2," + std::string("1,0,0,0,0,1,0,0,0,0,1,0\n1,") + "1,0,0,0,0,1,0,0,0,0,1,0\n"}},
       "global_pose.csv",
       "line 2, field time",
       "a time that is earlier than the one before it",
       "sort the lines by time"},
      {{{scan, ""}},
       "LiDAR",
       "",
       "no scans of Avia",
       "name a LiDAR that is there: Ouster/",
       "",
       {.lidar_topic = "Avia"}},
      {{{"raw_format/ouster_scan/cloud_1583836591_182590976.pcd", pcd_of_one_point},
        {"ground_truth/registered_poses.csv", "1,-5,0,0,0,0,0,0,1\n"}},
       "ground_truth/registered_poses.csv",
       "line 1, field nsec",
       "-5",
       "write what is beyond the whole second, below 1e9"},
      // Range images.
      {with(images, {{"data/0.png", "-"}, {"data/a.txt", ""}}), "", "", "no range images",
       "put them into the folder data"},
      {with(images, {{"timestamps_end.txt", ""}}), "", "", "1 images, but 1 start and 0 end times",
       "give one line of each time file for each image"},
      {with(images, {{"velodyne_config.txt", "500 4\n"}}), "velodyne_config.txt", "line 1",
       "2 numbers that are no geometry",
       "write: [multiplier] width height first_azimuth last_azimuth, then one angle for each row"},
      {with(images, {{"imu.cfg", "2011-07-14 13:52:31.1;8;49;8;110;0\nlater;8;49;8;110;0\n"}}), "imu.cfg",
       "line 2, field timestamp", "no date and time", "write YYYY-MM-DD hh:mm:ss.nnn"},
      {with(images, {{"imu.cfg", "2011-07-14 13:52:31.1;8;49;8;110;0\n2011-07-14 13:52:31.1;8;49;8;110;0\n"}}),
       "imu.cfg", "line 2, field timestamp", "a time that is not later than the one before it",
       "records come in the order of time"},
      {with(images, {{"imu.cfg", "2011-07-14 13:52:31.1;8;149;8;110;0\n"}}), "imu.cfg", "line 1, field lat",
       "a place that is not on the globe", "write degrees and metres"},
      // nuScenes and MARS.
      {with(mars, {{"v1.0/sample.json", "[{"}}), "v1.0/sample.json", "byte 3", "no JSON", again},
      {with(mars, {{"v1.0/sensor.json", "-"}}), "v1.0/sensor.json", "", "no file that can be read",
       "check the path and that you may read it"},
      {with(mars, {{"v1.0/scene.json", R"([{"token": "s", "name": "a"}, {"token": "t", "name": "b"}])"}}), "", "",
       "2 scenes: a, b", "name one of them as if it were a folder: "},
      {with(mars, {{"v1.0/sample.json", "[]"}}), "v1.0/sample_data.json", "", "no LiDAR scans of the scene a",
       "check that the tables are whole"},
      {with(mars, {{"v1.0/calibrated_sensor.json",
                    changed(mars.at("v1.0/calibrated_sensor.json"), "[1, 0, 0, 0]", "[2, 0, 0, 0]")}}),
       "v1.0/calibrated_sensor.json", "token c", "no rotation (w x y z, of length 1) or translation",
       "the table is damaged: copy it again"},
      {with(mars,
            {{"v1.0/sample_data.json", changed(mars.at("v1.0/sample_data.json"), "\"timestamp\": 1", "\"t\": 1")}}),
       "v1.0/sample_data.json", "token d", "no timestamp in microseconds", "the table is damaged: copy it again"},
      // ROS.
      {{{"a.bag", "#ROSBAG V1.2\n"}},
       "a.bag",
       "byte 0",
       "no line `#ROSBAG V2.0`",
       "only ROS 1 bags of version 2.0 are read: convert an older one with `rosbag fix`",
       "a.bag"},
      {{{"a.mcap", "MCAP"}},
       "a.mcap",
       "byte 0",
       "no MCAP magic number",
       "give an .mcap file that is neither packed nor damaged",
       "a.mcap"},
      {{{"a.db3", "no database"}},
       "a.db3",
       "",
       "no readable rosbag2 database: ",
       "copy it again, or repair it with `sqlite3 FILE .recover`",
       "a.db3"},
      {{{"a.bag", "#ROSBAG V2.0\n"}}, "a.bag", "", "a recording without messages", "record or copy it again", "a.bag"},
  };
}

/// A message that a decoder refuses, with what it says.
struct RefusedMessage {
  std::string bytes, found;
};

std::vector<RefusedMessage> refused_messages() {
  constexpr auto ros1 = MessageBytes::ros1;
  const auto cloud = [](const std::vector<FieldOf>& fields, std::uint32_t step, const std::string& data) {
    return point_cloud2(ros1, 1, 0, fields, step, data);
  };
  MessageBytes many(ros1), stamp(ros1), sizes(ros1);
  many.header(1, 0, "a") << std::uint32_t{1} << std::uint32_t{1} << std::uint32_t{300};
  stamp.header(1, 1'000'000'000, "a");
  sizes.header(1, 0, "a") << std::uint32_t{2} << std::uint32_t{9} << std::uint32_t{0} << std::uint8_t{0}
                          << std::uint32_t{12} << std::uint32_t{108} << std::uint32_t{24};
  const std::vector<FieldOf> xyz{{"x", 0, 7}, {"y", 4, 7}, {"z", 8, 7}};
  return {
      {many.raw(std::string(300 * 13, '\0')).str(), "300 fields; 256 are the most"},
      {cloud({{"x", 0, 11}}, 12, std::string(12, '\0')), "field x of the unknown datatype 11"},
      {cloud({{"x", 9, 7}}, 12, std::string(12, '\0')), "field x at byte 9 of points of 12 bytes"},
      {sizes.raw(std::string(24, '\0')).str(), "24 bytes of points for 2 rows of 9 points of 12 bytes"},
      {cloud({{"x", 0, 2}, {"y", 0, 2}, {"z", 0, 2}}, 1, std::string(5'000'000, '\0')),
       "1 rows of 5000000 points; 2^22 points are the most"},
      {stamp.str(), "a stamp of 1000000000 ns in a second"},
      {cloud(xyz, 12, std::string(24, '\0')).substr(0, 18), "the message ends after 2 of 5 bytes of header.frame_id"},
      {cloud(xyz, 12, std::string(24, '\0')).substr(0, 30) + std::string(10, '\xFF'), "the message promises "},
      {cloud({{"a", 0, 7}}, 12, std::string(12, '\0')), "no fields x, y and z among: a f32"}};
}

std::string refusal(const std::string& bytes, MessageEncoding encoding = MessageEncoding::ros1) {
  try {
    static_cast<void>(decode_point_cloud2(MessageReader(std::as_bytes(std::span(bytes)), encoding)));
  } catch (const MessageError& error) {
    return error.what();
  }
  return {};
}

}  // namespace

TEST_SUITE("datasets/messages of readers") {
  TEST_CASE("each message names its file, its place, what was found and what helps") {
    for (const DatasetCase& one : dataset_cases()) {
      CAPTURE(one.found);
      const TemporaryFolder folder;
      for (const auto& [name, bytes] : one.files) write_bytes(folder / name, bytes);
      const fs::path path = one.opened.empty() ? folder.path() : folder / one.opened;
      const std::string message = io_error([&] {
        const auto dataset = open_dataset(path, one.options);
        while (dataset->next()) {
        }
        return dataset->truth() ? 1 : 0;
      });
      const std::string named = one.path.empty() ? folder.path().string() : (folder / one.path).string();
      CHECK_MESSAGE(message.starts_with(named + (one.place.empty() ? "\n  found: " : ", " + one.place + "\n  found: ")),
                    message);
      CHECK_MESSAGE(says(message, "found: " + one.found), message);
      CHECK_MESSAGE(says(message, "\n  do: " + one.remedy), message);
    }
  }

  TEST_CASE("messages of a recording that do not fit together say why") {
    for (const RefusedMessage& one : refused_messages()) CHECK_MESSAGE(says(refusal(one.bytes), one.found), one.found);
    CHECK(refusal(std::string("\0\7\0\0", 4), MessageEncoding::cdr) == "encapsulation 7; plain CDR, 0 or 1, is read");
  }

  TEST_CASE("files that are asked for by name") {
    const TemporaryFolder folder;
    write_bytes(folder / "a.xyz", "1 2 3\n");
    CHECK(
        says(io_error([&] { return inspect(folder / "a.xyz").kind; }),
             "a.xyz\n  found: a file of no known kind\n  do: inspect reads .pcd, .ply, .bin, .tum, .csv, .g2o, rows"));
    CHECK(says(io_error([&] { return open_recording(folder / "a.xyz") != nullptr; }),
               "a.xyz\n  found: a file of no known kind of recording\n  do: name a .bag, .mcap or .db3"));
  }

  TEST_CASE("no place in the readers that fails is without a case") {
    // Of images and packets, and of damaged scans, which are warnings: folders_test, nclt_test and sequences_test.
    std::string all =
        "no PNG image: |a PNG image that is not grey of 8 or 16 bits| pixels, where a range image has 2^22 at most|"
        "a size that the file is too small for|a damaged PNG image: |give a grey PNG image of 8 or 16 bits| hits; 384 "
        "are "
        "the most|the file is damaged or of another kind|points of no time between the years 1678 and 2261|points of "
        "no "
        "time between the years 1824 and 2115|points that span |its configuration and its mask must have the same size|"
        "a table of topics that is larger than the file|the time |inspect reads .pcd|name a .bag, .mcap or .db3|"
        "encapsulation |a file of no known kind|an empty file|";
    for (const DatasetCase& one : dataset_cases()) all += one.place + '|' + one.found + '|' + one.remedy + '|';
    for (const RefusedMessage& one : refused_messages()) all += one.found + '|' + refusal(one.bytes) + '|';
    int sources = 0;
    for (const auto& entry : fs::directory_iterator(std::string(CHAINSLAM_SOURCE_DIR) + "/examples/datasets")) {
      const std::string source = read_bytes(entry.path());
      for (const char* name : {"fail(", "throw_input_error(", "MessageError("})
        for (const std::string& call : unsaid_calls(source, name, all))
          CHECK_MESSAGE(false, entry.path().filename().string() << ": " << call);
      ++sources;
    }
    CHECK(sources > 60);
  }
}

}  // namespace chainslam::test
