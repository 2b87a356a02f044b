#include <cstdio>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "program/faults.hpp"
#include "program/keyframe_data.hpp"
#include "support/source_calls.hpp"

#include <doctest/doctest.h>

// The program's own messages: each verb's, of its options, configuration, inputs and results. Readers of data sets and
// of single files have tables of their own, beside their tests.

namespace {

using namespace chainslam;
using namespace chainslam::test;

struct ProgramMessage {
  std::string arguments;  ///< in the folder of the files; `@` is that folder
  int exit_code;
  std::string place;  ///< what the first line names after "error: "
  std::string found, remedy;
  std::map<std::string, std::string> files{};
  std::string prefix{};  ///< as `run_program`
};

std::string straight(int poses, double step = 0.5) {
  std::string text;
  for (int i = 0; i < poses; ++i)
    text += std::to_string(10 + 0.1 * i) + ' ' + std::to_string(step * i) + " 0 0 0 0 0 1\n";
  return text;
}

std::string kitti_rows(int poses) {
  std::string text;
  for (int i = 0; i < poses; ++i) text += "1 0 0 " + std::to_string(0.5 * i) + " 0 1 0 0 0 0 1 0\n";
  return text;
}

std::string imu_rows(double from, int rows, const std::string& accel = "0,0,9.81") {
  std::string text = "timestamp,gx,gy,gz,ax,ay,az\n";
  for (int i = 0; i < rows; ++i) text += std::to_string(from + 0.01 * i) + ",0,0,0," + accel + "\n";
  return text;
}

/// A simulation's options, with something in place of something else.
std::string options_json(const std::string& from = "", const std::string& to = "") {
  std::string text = R"({"lidar": "HDL-64E", "columns": 1024, "lidar_height": 1.73, "seed": 1, "recorded_imu": false,)"
                     R"( "T_body_lidar": [0, 0, 0, 0, 0, 0, 1]})";
  if (const std::size_t at = text.find(from); !from.empty() && at != text.npos) text.replace(at, from.size(), to);
  return text;
}

/// Options and configuration: 2.
void add_usage(std::vector<ProgramMessage>& cases) {
  const auto config = [&](const std::string& text, const std::string& place, const std::string& found,
                          const std::string& remedy) {
    cases.push_back({"config --print --config @/a.toml", 2, place, found, remedy, {{"a.toml", text}}});
  };
  config("[odometry\n", "a.toml, line 1", "", "correct the line; `chainslam config --print` shows a whole file");
  config("[odometry]\nvoxel_sise = 1\n", "a.toml, line 2, column 1: unknown key 'odometry.voxel_sise'",
         "did you mean 'odometry.voxel_size'", "correct the name; `chainslam config --explain");
  config("zzzzqqqq = 1\n", "a.toml, line 1, column 1: unknown key 'zzzzqqqq'", "no key with a similar name",
         "remove it");
  config("odometry = 1\n", "a.toml, line 1, column 1: 'odometry' is a table", "a value", "write");
  config("[odometry]\nvoxel_size = \"wide\"\n",
         "line 2, column 14: 'odometry.voxel_size' has a value of the wrong type", "\"wide\"", "write a number");
  config("[odometry]\nvoxel_size = nan\n", "'odometry.voxel_size' is not a finite number", "nan", "write a number");
  config("[odometry]\nvoxel_size = -5.0\n", "'odometry.voxel_size' is out of range", "-5", "write a number");
  config("[odometry]\nsource = \"lidat\"\n", "'odometry.source' has no such choice", "did you mean \"lidar\"", "write");
  config("a" + std::string(200, '.') + "b = 1\n", "a.toml, line 1: nested too deeply", "levels",
         "write table.key = value");
  config("[dataset]\nT_body_lidar = [1, 2]\n", "'dataset.T_body_lidar' is", "[1, 2]", "write");
  config("[dataset]\nT_body_lidar = [1979-05-27]\n", "'dataset.T_body_lidar' has a value of the wrong type", "",
         "write");
  config("[keyframes]\ndistance = true\n", "'keyframes.distance' has a value of the wrong type", "true",
         "write a number");
  cases.push_back({"config --print --config @/none.toml", 2, "none.toml: cannot be read", "No such file",
                   "give the name of a TOML file"});
  cases.push_back({"config --print --config @/big.toml",
                   2,
                   "big.toml: is too large for a configuration",
                   "1048578 bytes",
                   "at most 1 MiB",
                   {{"big.toml", std::string(1048578, '\n')}}});
  cases.push_back(
      {"config --print --set voxel", 2, "--set voxel: no assignment", "\"voxel\"", "write --set table.key=value"});
  cases.push_back({"config --print --set odometry.voxel_sise=1", 2, "--set odometry.voxel_sise=1: unknown key",
                   "did you mean", "correct the name"});
  cases.push_back({"config --print --set odometry.min_range=50 --set odometry.max_range=10", 2, "'odometry.m",
                   "odometry.m", "change one of them; `chainslam config --explain"});
  cases.push_back({"config --explain odometrie", 2, "--explain: unknown key 'odometrie'", "", ""});
  cases.push_back({"", 2, "chainslam", "A subcommand is required", "`chainslam --help` says what it takes"});
  cases.push_back({"mpa @/x", 2, "chainslam", "", "`chainslam --help` says what it takes"});
  cases.push_back({"map @/x --out", 2, "chainslam map", "--out", "`chainslam map --help` says what it takes"});
  cases.push_back({"map @/x --out @/out --threads 0", 2, "chainslam map", "--threads: Value 0 not in range",
                   "`chainslam map --help`"});
  cases.push_back({"eval @/a @/b @/c", 2, "chainslam eval",
                   "each REFERENCE needs its ESTIMATE: an even number of files", "`chainslam eval --help`"});
  cases.push_back({"eval @/a @/b --align round", 2, "chainslam eval", "'round' is none of none|origin|se3|sim3",
                   "`chainslam eval --help`"});
  cases.push_back({"eval @/a @/b --delta 3miles", 2, "chainslam eval", "'3miles' is no distance: write 10m or 1frame",
                   "`chainslam eval --help`"});
  cases.push_back({"map @/data --out @/out --truth @/a @/b", 2, "--truth: each data set needs one, or none has any",
                   "2 files for 1 data sets", "give one for each, in their order"});
  cases.push_back({"map simulate:town --out @/out", 2, "map: that names no simulated session", "simulate:town",
                   "write simulate:PRESET/SIZE/SESSION"});
  cases.push_back({"map simulate:nclt-like/huge/1 --out @/out", 2, "map: there is no such size",
                   "simulate:nclt-like/huge/1", "write simulate:PRESET"});
  cases.push_back({"map simulate:tawn/small/1 --out @/out", 2, "map: there is no such preset", "simulate:tawn/small/1",
                   "write simulate:PRESET"});
  cases.push_back({"map simulate:nclt-like/small/99 --out @/out", 2, "map: the preset has no such session", "99",
                   "write simulate:PRESET"});
  cases.push_back(
      {"map simulate:nclt-like/small/1/x --out @/out", 2, "map: the seed is no number", "/x", "write simulate:PRESET"});
  cases.push_back(
      {"simulate --out @/out", 2, "simulate: a preset or a trajectory is needed", "neither", "name a preset (town"});
  cases.push_back({"simulate town --trajectory @/a --out @/out", 2, "simulate: a preset or a trajectory is needed",
                   "both", "name a preset (town"});
  cases.push_back({"simulate tawn --out @/out", 2, "simulate: there is no such preset", "tawn", "take one of: town"});
  cases.push_back({"simulate town --without rust --out @/out", 2, "simulate: an error source has no such name", "rust",
                   "there are: laser-angles, "});
  cases.push_back({"map simulate:nclt-like/small/1/errors=rust --out @/out", 2,
                   "simulate: an error source has no such name", "rust", "there are: laser-angles, "});
  cases.push_back(
      {"simulate town --sessions 9 --out @/out", 2, "simulate: the preset has fewer sessions", "9", "take at most 1"});
}

/// `simulate --trajectory`.
void add_recorded(std::vector<ProgramMessage>& cases) {
  const auto simulate = [&](const std::string& options, int code, const std::string& place, const std::string& found,
                            const std::string& remedy, std::map<std::string, std::string> files) {
    cases.push_back({"simulate --no-scans --out @/out --trajectory @/a.tum " + options, code, place, found, remedy,
                     std::move(files)});
  };
  const std::string good = straight(60);
  simulate("--also @/b.txt", 2, "b.txt: a trajectory without times", "rows of 12 numbers",
           "give one of TUM's, EuRoC's or NCLT's format", {{"a.tum", good}, {"b.txt", kitti_rows(60)}});
  simulate("", 3, "a.tum, pose 3", "a time that is not later", "sort the poses by time",
           {{"a.tum", kitti_rows(30)}, {"t", ""}});
  cases.pop_back();  // times of KITTI's rows cannot go back, and TUM's reader says so by line
  simulate("", 3, "a.tum, line 2", "", "sort", {{"a.tum", "2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n"}});
  simulate("", 3, "a.tum, pose 2", "a gap of 9 s before it", "give the part before or after it",
           {{"a.tum", "1 0 0 0 0 0 0 1\n10 0 0 0 0 0 0 1\n"}});
  simulate("", 3, "a.tum, pose 2", "a jump of 100 m and 0 rad within 0.1 s", "check the times and the units",
           {{"a.tum", straight(30, 100)}});
  simulate("", 3, "a.tum", "5 poses, 0.4 s, 2 m", "give a trajectory of at least 10 poses, 2 s and 5 m",
           {{"a.tum", straight(5)}});
  simulate("--rate 10 --skip @/skip", 3, "a.tum", "1 poses, 0 s, 0 m", "give a trajectory of at least 10 poses",
           {{"a.tum", kitti_rows(1)}, {"skip", "a.tum 0 1\n"}});
  simulate("", 2, "simulate: the trajectory's rows have no times", "a.tum",
           "give --times FILE with a line for each row, or --rate HZ", {{"a.tum", kitti_rows(30)}});
  simulate("--times @/t", 3, "t", "2 times for 30 poses", "give one line for each pose",
           {{"a.tum", kitti_rows(30)}, {"t", "1\n2\n"}});
  simulate("--frame camera", 2, "simulate: a camera's trajectory needs the camera's place", "no --camera-lidar",
           "give KITTI's calib.txt", {{"a.tum", good}});
  simulate("--body-lidar @/T", 3, "T", "3 numbers", "write the 3 or 4 rows of a pose matrix",
           {{"a.tum", good}, {"T", "1 2 3\n"}});
  simulate("--body-lidar @/T", 3, "T", "a matrix that is no rotation", "write the pose as [R | t]",
           {{"a.tum", good}, {"T", "2 0 0 0\n0 1 0 0\n0 0 1 0\n"}});
  simulate("--skip sometimes", 2, "--skip: neither an interval nor a file", "sometimes", "write FROM:TO in seconds",
           {{"a.tum", good}});
  simulate("--skip @/skip", 3, "skip, line 1", "frames of a trajectory that has times of its own",
           "write rows `FROM TO` in seconds", {{"a.tum", good}, {"skip", "a.tum 0 1\n"}});
  simulate("--imu @/i", 3, "i, line 1", "a header that begins with time",
           "write the header timestamp,gx,gy,gz,ax,ay,az", {{"a.tum", good}, {"i", "time,x\n"}});
  simulate("--imu @/i", 3, "i, line 1", "an empty file", "write the header timestamp,gx,gy,gz,ax,ay,az",
           {{"a.tum", good}, {"i", ""}});
  simulate("--imu @/i", 3, "i, line 1", "nominal_frame, beside a trajectory with times of its own",
           "give the frames' poses as KITTI's rows", {{"a.tum", good}, {"i", "nominal_frame,gx\n"}});
  simulate("--imu @/i", 3, "i, line 3", "a time that is not later than the one before it", "sort the rows by time",
           {{"a.tum", good}, {"i", "timestamp,gx,gy,gz,ax,ay,az\n12,0,0,0,0,0,9.8\n12,0,0,0,0,0,9.8\n"}});
  simulate("--imu @/i", 3, "i", "no rows at the time of the trajectory",
           "give both on one clock, or the difference as --imu-offset SECONDS",
           {{"a.tum", good}, {"i", imu_rows(1000, 5)}});
  simulate("--imu @/i", 2, "the IMU does not suit the trajectory",
           "specific forces that, turned into its frame, have a mean of",
           "check units, times, and whose poses they are", {{"a.tum", good}, {"i", imu_rows(10, 300, "0,0,1")}});
  simulate("--lidar HDL-65E", 2, "--lidar: there is no such LiDAR", "HDL-65E", "take one of: ", {{"a.tum", good}});
  const auto again = [&](const std::string& options, const std::string& trajectory, const std::string& place,
                         const std::string& found, const std::string& remedy) {
    cases.push_back({"map simulate:@/sim --out @/out",
                     3,
                     place,
                     found,
                     remedy,
                     {{"sim/simulation/options.json", options}, {"sim/simulation/trajectory.tum", trajectory}}});
  };
  again("{", good, "options.json", "parse error", "simulate the drive again");
  again("{}", good, "options.json", "T_body_lidar", "simulate the drive again");
  again(options_json("1024", "2000000000"), good, "options.json", "columns = 2000000000", "simulate the drive again");
  again(options_json("1.73", "-1e99"), good, "options.json", "lidar_height = ", "simulate the drive again");
  again(options_json("\"seed\": 1", "\"seed\": -1"), good, "options.json", "seed = -1", "simulate the drive again");
  again(options_json("HDL-64E", "HDL-65E"), good, "options.json", "lidar = HDL-65E", "simulate the drive again");
  again(options_json("0, 1]", "0, 0]"), good, "options.json", "T_body_lidar is no pose", "simulate the drive again");
  again(options_json(), straight(3), "trajectory.tum", "3 poses", "give a trajectory of at least 10 poses");
}

/// Verbs on maps, trajectories and graphs. `@/map.cslam` is a map, `@/data` a keyframe set.
void add_verbs(std::vector<ProgramMessage>& cases) {
  cases.push_back(
      {"inspect @/maps", 3, "maps/summary.json", "no JSON text", "make the map again", {{"maps/summary.json", "{"}}});
  std::string deep;
  for (int i = 0; i < 200'000; ++i) deep += "{\"a\":";
  cases.push_back({"inspect @/maps",
                   3,
                   "maps/summary.json",
                   "more than 16 levels",
                   "the file was changed: make the map again",
                   {{"maps/summary.json", deep + "1" + std::string(200'000, '}')}}});
  cases.push_back({"inspect @/data --closures", 3, "data", "no map, so no closures",
                   "give a map file (.cslam), or a folder that `chainslam map` wrote"});
  cases.push_back({"inspect @/none", 3, "none", "", ""});
  cases.push_back({"check @/none", 3, "none", "no such file", "check the path, and that you may read it"});
  cases.push_back({"check @/data", 3, "data", "not a plain file (a folder, a pipe or a device)", "name a map file"});
  cases.push_back({"check @/poem", 3, "poem", "", "", {{"poem", "shall I compare thee\n"}}});
  cases.push_back({"localize @/data --load @/bare.cslam --out @/out", 3, "bare.cslam", "a map without scans",
                   "make a map of data with scans"});
  cases.push_back({"odometry @/data --out @/out", 3, "data", "a keyframe set, which has odometry",
                   "map it: `chainslam map` takes the odometry that it has"});
  cases.push_back({"odometry @/blank --out @/out",
                   3,
                   "blank",
                   "2 scans, none of which could be used",
                   "run `chainslam inspect` on it",
                   {{"blank/0.bin", ""}, {"blank/1.bin", ""}, {"blank/times.txt", "1\n2\n"}}});
  cases.push_back({"map @/blank --out @/out",
                   3,
                   "blank",
                   "2 scans, none of which could be used",
                   "compare odometry.min_range and max_range",
                   {{"blank/0.bin", ""}, {"blank/1.bin", ""}, {"blank/times.txt", "1\n2\n"}}});
  cases.push_back({"map @/nowhere --out @/out", 3, "nowhere", "", ""});
  cases.push_back({"map @/data --load @/none --out @/out", 3, "none", "no such file", "check the path"});
  cases.push_back({"map @/data --load @/map.cslam --max-memory 1KB --out @/out", 3, "map.cslam", "are allowed", ""});
  cases.push_back({"map @/data --max-memory 1MB --out @/out", 4, "memory", "more than 1 MB in use (--max-memory)",
                   "allow more, or load smaller maps"});
  cases.push_back(
      {"map @/data --out @/taken", 4, "taken", "something is there already", "--overwrite", {{"taken/mine", "mine"}}});
  cases.push_back({"map @/data --out @/file/out", 4, "file", "", "", {{"file", "mine"}}});
  cases.push_back({"map @/data --out @/out",
                   4,
                   "out.partial",
                   "No space left on device",
                   "choose a folder that you may write to",
                   {},
                   with_fault("mkdir:out.partial:28:0")});
  cases.push_back({"map @/data --out @/results/out",
                   4,
                   "out.partial, making the disk keep the folder's entry",
                   "Input/output error",
                   "check the disk, or choose another one",
                   {{"results/mine", ""}},
                   with_fault("sync:/results$:5:0")});
  cases.push_back({"map @/data --out @/full",
                   4,
                   "full",
                   "No space left on device",
                   "rename that by hand",
                   {},
                   with_fault("rename:/full$:28:0:stay")});
  cases.push_back({"map @/data --out @/kept/out",
                   4,
                   "out, making the disk keep the folder's entry",
                   "Input/output error",
                   "a power cut now could undo that: check the disk",
                   {{"kept/mine", ""}},
                   with_fault("sync:/kept$:5:1")});
  cases.push_back({"recover @/none --out @/out", 3, "none", "no such file", "check the path"});
  cases.push_back({"recover @/map.cslam --out @/map.cslam --overwrite", 4, "map.cslam",
                   "the map that is to be recovered itself",
                   "choose another name: nothing is ever recovered in place"});
  cases.push_back({"recover @/map.cslam --out @/taken",
                   4,
                   "taken",
                   "something is there already",
                   "--overwrite",
                   {{"taken/mine", "mine"}}});
  cases.push_back({"recover @/loaded.partial --out @/out", 3, "input.cslam.partial", "which is not there any more",
                   "put that map back, or pass --no-replay"});
  cases.push_back({"recover @/foreign.partial --out @/out", 3, "input.cslam.partial",
                   "a configuration that this version cannot use: parameters, line 1",
                   "recover with the version of chainslam that began the run, or pass --no-replay"});
  cases.push_back({"recover @/foreign.partial --no-replay --out @/out", 3, "map.cslam.partial",
                   "nothing that the run had closed", "recover without --no-replay"});
  cases.push_back({"undo @/none --session 0 --out @/out", 3, "none", "no such file", "check the path"});
  cases.push_back({"undo @/map.cslam --session nobody --out @/out", 2,
                   "--session: a session's number, or a name that only one has", "nobody, where the map has sessions",
                   "--closures` lists sessions and closures with their numbers"});
  cases.push_back({"undo @/map.cslam --closure -1 --out @/out", 2, "--closure: the number of a closure",
                   "-1, where the map has", "lists sessions and closures with their numbers"});
  cases.push_back({"undo @/map.cslam --session 0 --out @/map.cslam --overwrite", 4, "map.cslam", "the map itself",
                   "choose another name: a map is never changed"});
  cases.push_back({"undo @/map.cslam --out @/out", 2, "chainslam undo",
                   "nothing to undo: pass --session, --closure or --merge", "`chainslam undo --help`"});
  cases.push_back({"undo @/loose.cslam --closure 0 --out @/out", 3, "loose.cslam",
                   "measurements that do not hold all keyframes without what was to be undone",
                   "pass --replay: that decides again from the scans"});
  cases.push_back({"undo @/loose.cslam --closure 0 --replay --out @/out", 3, "loose.cslam",
                   "no scans, without which nothing can be decided again",
                   "undo without --replay, or give the map that has them"});
  cases.push_back({"merge @/none @/map.cslam --out @/out", 3, "none", "no such file", "check the path"});
  cases.push_back(
      {"merge @/map.cslam --out @/out", 2, "chainslam merge", "At least 2 required", "`chainslam merge --help`"});
  cases.push_back(
      {"merge @/map.cslam @/empty.cslam --out @/out", 3, "empty.cslam", "a map without keyframes", "leave it out"});
  cases.push_back({"merge @/map.cslam @/loose.cslam --out @/out", 3, "loose.cslam",
                   "no scans, without which its sessions match nothing", "give the map that has them"});
  cases.push_back({"merge @/map.cslam @/bare.cslam --out @/bare.cslam --overwrite", 4, "bare.cslam",
                   "one of the maps that are merged", "choose another name: a map is never changed"});
  cases.push_back({"merge @/strange.cslam @/strange.cslam --out @/out", 3, "strange.cslam",
                   "a configuration that this version cannot use: parameters, line 1",
                   "merge with the version of chainslam that made the map, or pass --config"});
  cases.push_back({"merge @/map.cslam @/bare.cslam --out @/out --set chane.enabled=false", 2,
                   "--set chane.enabled=false: unknown key", "did you mean", "correct the name"});
  cases.push_back(
      {"report @/empty.cslam --out @/out", 3, "empty.cslam", "a map without keyframes", "give a map that has some"});
  cases.push_back({"report @/none --out @/out", 3, "none", "no such file", "check the path"});
  cases.push_back({"export @/wide.cslam --format grid --out @/out", 2, "--resolution: the grid would be too large",
                   "more than 1000000000 cells", "choose larger cells, or a shorter --range"});
  cases.push_back({"export @/wide.cslam --format grid --height 2 1 --out @/out", 2, "chainslam export",
                   "--height: MIN is less than MAX", "`chainslam export --help`"});
  cases.push_back({"export @/wide.cslam --format las --out @/out", 4, "out, keyframe ",
                   "a point more than 2147 km from the middle of the map",
                   "export the map as PLY, which holds any coordinates"});
  cases.push_back({"export @/none --format tum --out @/out", 3, "none", "no such file", "check the path"});
  cases.push_back(
      {"export @/map.cslam --format e57 --out @/out", 2, "chainslam export", "e57", "`chainslam export --help`"});
  const auto camera = [&](const std::string& options, const std::string& found) {
    cases.push_back({"export @/map.cslam --format colmap --out @/out " + options, 2, "chainslam export", found,
                     "`chainslam export --help`"});
  };
  camera("--camera 640.5 480 500 500 320 240", "WIDTH and HEIGHT are whole numbers");
  camera("--camera 640 480 500 0 320 240", "FX and FY are positive");
  camera("--camera 640 480 500 500 320 inf", "a number that is not finite");
  camera("--body-camera 0 0 0 1 1 0 0", "QX QY QZ QW is a unit quaternion");
  const auto eval = [&](const std::string& options, const std::string& a, const std::string& b,
                        const std::string& place, const std::string& found, const std::string& remedy) {
    cases.push_back({"eval @/a.txt @/b.txt " + options, 3, place, found, remedy, {{"a.txt", a}, {"b.txt", b}}});
  };
  const std::string square = "1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n3 1 1 0 0 0 0 1\n4 0 1 1 0 0 0 1\n";
  eval("", "", square, "a.txt", "no pose", "check that this is the right file; give TUM's");
  eval("", "1 2 3\n", square, "a.txt, line 1", "a row of 3 fields, which is no trajectory that is known", "give TUM's");
  eval("", "1,2,3\n", square, "a.txt, line 1", "a row of 3 fields with commas, which is no trajectory that is known",
       "give TUM's");
  eval("", "2,0,0,0,0,0,0\n1,0,0,0,0,0,0\n", square, "a.txt, line 2, field utime",
       "a stamp that is earlier than the one before it", "sort the lines by time");
  eval("", "2,nan,0,0,0,0,0\n", square, "a.txt", "no pose with finite numbers", "check that this is the right file");
  eval("", square, "1001 0 0 0 0 0 0 1\n1002 1 0 0 0 0 0 1\n", "b.txt, compared with",
       "none within 0.01 s of the reference's", "use --associate index");
  eval("--associate time", square, kitti_rows(4), "b.txt", "no times (KITTI poses)",
       "use --associate index, or give a file with times");
  eval("--associate index", square, kitti_rows(3), "b.txt, compared with", "3 poses, where the reference has 4",
       "give files with times, or cut one");
  eval("", straight(4, 0), straight(4, 0), "b.txt", "4 matched poses that lie in one place or on one line",
       "use --align origin or --align none");
  cases.push_back({"eval @/a.txt @/a.txt --json @/taken",
                   4,
                   "taken",
                   "something is there already",
                   "--overwrite",
                   {{"a.txt", square}, {"taken/mine", "mine"}}});
  const auto optimize = [&](const std::string& graph, const std::string& place, const std::string& found,
                            const std::string& remedy) {
    cases.push_back({"optimize @/a.g2o --out @/out", 3, place, found, remedy, {{"a.g2o", graph}}});
  };
  const std::string edge = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n";
  optimize("VERTEX_SE2 0 0 0 0\n", "a.g2o", "no edges", "give a file with EDGE_SE2 or with EDGE_SE3:QUAT lines");
  optimize(edge + "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n", "a.g2o",
           "edges in the plane and in space in one file", "give a file with EDGE_SE2");
  optimize(edge + "EDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n", "a.g2o, vertex 5", "no pose and no edge to a known vertex",
           "add a VERTEX line, or the edge that is missing");
  optimize("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 1 0 0\n" + edge, "a.g2o",
           "parts of the graph are not connected with the first vertex", "check the edges of the vertices named above");
  optimize("EDGE_SE2 0 1 1 0 0 0 0 0 0 0 0\n", "a.g2o", "", "check the edges of the vertices named above");
  cases.push_back({"optimize @/a.g2o --out @/taken",
                   4,
                   "taken",
                   "something is there already",
                   "--overwrite",
                   {{"a.g2o", edge}, {"taken/mine", "mine"}}});
  cases.push_back({"optimize @/a.g2o --out @/no/such/folder",
                   4,
                   "no/such/folder",
                   "No such file or directory",
                   "create the folder",
                   {{"a.g2o", edge}}});
  cases.push_back({"inspect @/map.cslam",
                   4,
                   "standard output",
                   "No space left on device",
                   "free space where the output goes",
                   {},
                   "CHAINSLAM_OUTPUT=full"});
}

std::vector<ProgramMessage> program_messages() {
  std::vector<ProgramMessage> cases;
  add_usage(cases);
  add_recorded(cases);
  add_verbs(cases);
  return cases;
}

std::string placed(std::string text, const fs::path& root) {
  for (std::size_t at = text.find('@'); at != std::string::npos; at = text.find('@', at + 1))
    text.replace(at, 1, root.string());
  return text;
}

}  // namespace

TEST_SUITE("program/messages") {
  TEST_CASE("each message of the program names the place, what was found and what helps; nothing is left behind") {
    const ScratchFolder scratch("messages");
    const fs::path root = scratch.path() / "in";
    fs::create_directories(root);
    write_keyframes(root / "data", 3, false, 5, 20);
    save_map(root / "map.cslam", random_map(1, 5));
    save_map(root / "earlier.cslam", random_map(1, 5));
    save_map(root / "strange.cslam", random_map(1, 5), {.parameters = "<settings/>\n"});
    SlamMap bare = random_map(1, 5);
    for (Keyframe& one : bare.keyframes) one.cloud = std::make_shared<const PointCloud<float>>();
    save_map(root / "bare.cslam", bare);
    save_map(root / "empty.cslam", SlamMap());
    SlamMap wide = random_map(1, 5);
    wide.keyframes.front().T_map_body = SE3d(SO3d(), {1e7, 1e7, 0});
    save_map(root / "wide.cslam", wide);
    SlamMap loose = random_map(1, 20);  // without scans, and held by nothing
    for (Keyframe& keyframe : loose.keyframes) keyframe.cloud.reset();
    for (Session& session : loose.sessions) session.prior_sqrt_information.setZero();
    save_map(root / "loose.cslam", loose);
    static_cast<void>(run_program(scratch.path(),
                                  "map " + quoted(root / "data") + " --load " + quoted(root / "earlier.cslam") +
                                      " --out " + quoted(root / "loaded"),
                                  with_fault("sync:input.cslam:-1:1")));
    fs::remove(root / "earlier.cslam");
    fs::create_directories(root / "foreign.partial");
    {
      InputJournal journal(root / "foreign.partial/input.cslam", "<settings/>\n");
      journal.append(SessionStart{"one"});
      journal.append(random_map(1, 1).keyframes.front());
      journal.commit();
    }
    const std::set<std::string> before = names_in(root);
    std::string all;
    const std::vector<ProgramMessage> cases = program_messages();
    for (const ProgramMessage& one : cases) {
      CAPTURE(one.arguments);
      for (const auto& [name, text] : one.files) {
        fs::create_directories((root / name).parent_path());
        write_text(root / name, text);
      }
      const bool full_output = one.prefix == "CHAINSLAM_OUTPUT=full";
      ProgramResult result;
      if (full_output) {
        const std::string command = CHAINSLAM_PROGRAM " " + placed(one.arguments, root) + " >/dev/full 2>" +
                                    quoted(scratch.path() / "stderr.txt");
        result.exit_code = WEXITSTATUS(std::system(command.c_str()));
        result.errors = read_text(scratch.path() / "stderr.txt");
      } else {
        result = run_program(scratch.path(), placed(one.arguments, root), one.prefix);
      }
      CAPTURE(result.errors);
      CHECK(result.exit_code == one.exit_code);
      const std::size_t error = result.errors.rfind("error: ");
      REQUIRE(error != std::string::npos);
      const std::size_t found = result.errors.find("\n  found: ", error),
                        remedy = result.errors.find("\n  do: ", error);
      REQUIRE(remedy != std::string::npos);
      REQUIRE(found < remedy);
      CHECK_MESSAGE(contains(result.errors.substr(error, found - error), one.place), one.place);
      CHECK_MESSAGE(contains(result.errors.substr(found, remedy - found), one.found), one.found);
      CHECK_MESSAGE(contains(result.errors.substr(remedy), one.remedy), one.remedy);
      CHECK(remedy + 8 < result.errors.size());
      all += result.errors;
      // Whole results whose name or entry alone failed stay; all else that came is the case's own files.
      for (const auto& [name, text] : one.files) fs::remove_all(root / *fs::path(name).begin());
      for (const std::string& name : names_in(root))
        if (!before.contains(name)) {
          CHECK_MESSAGE((name == "full.partial" && fs::exists(root / name / "map.cslam")), name);
          fs::remove_all(root / name);
        }
    }
    std::printf("FIGURE messages of the program that were triggered: %zu\n", cases.size());

    // Messages that other tests trigger, and a program's own mistakes, which no input can.
    all +=
        "an allocation failed|a fault of the program's own|is another map now|another map than was written|"
        "no three.js there, which the report's 3-D view needs|' in it, which would end the page's script|the other "
        "results are whole; run again with more memory|"
        "a failure of the file|write a number below 2^31|write a number that is not negative|";
    int sources = 0;
    for (const char* folder : {"mapper", "support"})
      for (const auto& entry : fs::directory_iterator(std::string(CHAINSLAM_SOURCE_DIR) + "/examples/" + folder)) {
        const std::string source = read_text(entry.path());
        for (const char* name :
             {"fail(", "throw_input_error(", "throw_output_error(", "ConfigError(", "ValidationError("})
          for (const std::string& call : unsaid_calls(source, name, all))
            CHECK_MESSAGE(false, entry.path().filename().string() << ": " << call);
        ++sources;
      }
    CHECK(sources > 80);
  }
}
