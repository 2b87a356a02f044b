#include "command_line.hpp"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "build_description.hpp"
#include "chainslam/core/error.hpp"
#include "exit_code.hpp"
#include "simulator/error_sources.hpp"
#include "simulator/lidar_model.hpp"
#include "support/nearest_name.hpp"
#include "verbs.hpp"

// The only file that includes CLI11, which is headers only: each file that includes it compiles all of it anew.
namespace chainslam::mapper {

namespace {

/// Checks that an option's value is one of several words; else says which was probably meant.
CLI::Validator one_of(const std::vector<std::string>& words) {
  return {[words](std::string& text) {
            if (std::ranges::find(words, text) != words.end()) return std::string();
            std::string list;
            for (const std::string& word : words) list += (list.empty() ? "" : "|") + word;
            return "'" + text + "' is none of " + list + support::suggestion(text, words);
          },
          ""};
}

void add_map(CLI::App& program, SessionWorkers* workers, int& exit_code) {
  const auto arguments = std::make_shared<MapArguments>();
  CLI::App* verb = program.add_subcommand("map", "map data sets as sessions, optionally on top of saved maps");
  verb->footer(
      "DIR contains map.cslam (the map; input of --load), report.html, map.ply, trajectory.tum and .kitti.txt,\n"
      "odometry.tum, graph.g2o, keyframes.csv, closures.csv, config.toml, summary.json and map.png; for several data\n"
      "sets, a trajectory each. Ctrl-C finishes the current scan and saves the map; a second Ctrl-C stops at once.\n"
      "After a crash or a power loss, `chainslam recover DIR.partial -o NEW` writes the map of everything that the\n"
      "progress line had shown; at most the last second of data is lost.\n"
      "`chainslam config --print` prints all settings.");
  verb->add_option("DATA", arguments->data,
                   "folders of data sets, one session each (see chainslam inspect), or "
                   "simulate:PRESET/SIZE/SESSION or simulate:FOLDER (see chainslam simulate)")
      ->required()
      ->option_text("...");
  verb->add_option("--load", arguments->maps, "maps to continue from: map.cslam of earlier runs")
      ->option_text("MAP...");
  verb->add_option("--out", arguments->out, "output folder")->required()->option_text("DIR");
  verb->add_flag("--overwrite", arguments->overwrite, "if DIR is not empty, keep it as DIR~1");
  verb->add_option("--config", arguments->config, "configuration file (TOML)")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a setting; can be repeated")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--truth", arguments->truths,
                   "ground-truth trajectories, one for each DATA; default: the data sets' own")
      ->option_text("FILE...");
  verb->add_option("--max-scans", arguments->max_scans, "process at most N scans of each data set")
      ->check(CLI::NonNegativeNumber)
      ->option_text("N");
  verb->add_option("--threads", arguments->threads, "number of threads; default: all cores; does not change the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->add_option(
          "--max-memory", arguments->max_memory,
          "memory limit, for example 6GB; beyond it, the map is saved and the exit code is 4; default: half of\n"
          "the machine's memory. Larger maps are refused by --load")
      ->transform(CLI::AsSizeValue(true).description(""))
      ->option_text("SIZE");
  verb->callback([arguments, workers, &exit_code] { exit_code = run(*arguments, workers); });
}

void add_odometry(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<OdometryArguments>();
  CLI::App* verb = program.add_subcommand("odometry", "run odometry only and record it as a data set");
  verb->footer(
      "SET contains Scans/*.pcd (with intensities if available), times.txt and odom_poses.txt of the keyframes, as\n"
      "other programs read keyframe sets; frames.csv (pose, covariance and health of every scan, specific force\n"
      "integrated since the scan before: dv_x, dv_y, dv_z), fixes.csv, truth.tum, odometry.json, config.toml and\n"
      "summary.json (times, memory, errors against the ground truth).\n"
      "`chainslam map SET --config SET/config.toml` gives a map that is bit-identical to that of DATA, within "
      "seconds:\n"
      "use it to tune closures, chain, merge and graph. Keyframes are recorded as set by keyframes.distance, angle "
      "and\n"
      "voxel_size: record with small values to try larger ones.");
  verb->add_option("DATA", arguments->data,
                   "folder of a data set (see chainslam inspect), simulate:PRESET/SIZE/SESSION or simulate:FOLDER")
      ->required()
      ->option_text(" ");
  verb->add_option("--out", arguments->out, "output folder")->required()->option_text("SET");
  verb->add_flag("--overwrite", arguments->overwrite, "if SET is not empty, keep it as SET~1");
  verb->add_option("--config", arguments->config, "configuration file (TOML)")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a setting; can be repeated")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--truth", arguments->truth, "ground-truth trajectory; default: the data set's own")
      ->option_text("FILE");
  verb->add_option("--max-scans", arguments->max_scans, "process at most N scans")
      ->check(CLI::NonNegativeNumber)
      ->option_text("N");
  verb->add_option("--threads", arguments->threads, "number of threads; default: all cores; does not change the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->add_option("--max-memory", arguments->max_memory,
                   "memory limit, for example 6GB; beyond it, the results so far are saved and the exit code is 4;\n"
                   "default: half of the machine's memory")
      ->transform(CLI::AsSizeValue(true).description(""))
      ->option_text("SIZE");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_localize(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<LocalizeArguments>();
  CLI::App* verb = program.add_subcommand("localize", "localize a data set in a saved map, from a cold start");
  verb->footer(
      "DIR contains localization.csv (every frame: status, pose in the map's frame, covariance; no pose while the\n"
      "place is sought or lost), localization.tum (the poses), config.toml and summary.json (time to the first fix,\n"
      "share lost, cold starts). Status: searching, tracking, uncertain (odometry alone for more than\n"
      "localize.max_distance) or lost. The map is not changed. No GNSS is needed. Exit code 5 if no place was found.\n"
      "Ctrl-C finishes the current scan and saves the poses so far.\n"
      "Places are drawn as set by localize.place_*: for a hand-held scanner in a courtyard, --set\n"
      "localize.place_length=10 --set localize.place_spacing=2 --set localize.place_cell_size=0.25");
  verb->add_option("DATA", arguments->data,
                   "folder of a data set or of recorded odometry, simulate:PRESET/SIZE/SESSION or simulate:FOLDER")
      ->required()
      ->option_text(" ");
  verb->add_option("--load", arguments->map, "map: map.cslam, or the folder that has it")
      ->required()
      ->option_text("MAP");
  verb->add_option("--out", arguments->out, "output folder")->required()->option_text("DIR");
  verb->add_flag("--overwrite", arguments->overwrite, "if DIR is not empty, keep it as DIR~1");
  verb->add_option("--config", arguments->config, "configuration file (TOML)")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a setting; can be repeated")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--truth", arguments->truth, "ground-truth trajectory; default: the data set's own")
      ->option_text("FILE");
  verb->add_option("--max-scans", arguments->max_scans, "process at most N scans")
      ->check(CLI::NonNegativeNumber)
      ->option_text("N");
  verb->add_option("--threads", arguments->threads, "number of threads; default: all cores; does not change the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->add_option("--max-memory", arguments->max_memory,
                   "memory limit, for example 6GB; beyond it, the poses so far are saved and the exit code is 4;\n"
                   "default: half of the machine's memory")
      ->transform(CLI::AsSizeValue(true).description(""))
      ->option_text("SIZE");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

/// A list as lines of about 100 characters.
std::string in_lines(std::string list) {
  constexpr std::size_t width = 100;
  for (std::size_t at = list.find(", ", width); at != std::string::npos; at = list.find(", ", at + width))
    list[at + 1] = '\n';
  return list;
}

/// What `simulate` takes for a recorded trajectory.
void add_recorded(CLI::App& verb, SimulateArguments& arguments) {
  const std::string group = "Along a recorded trajectory";
  verb.add_option("--trajectory", arguments.trajectory,
                  "instead of PRESET: trajectory file of TUM, EuRoC, NCLT or KITTI (12 numbers per row)")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--also", arguments.others,
                  "another drive in the same frame; the world is built along all drives; can be repeated. The same\n"
                  "drives give the same world in any order")
      ->option_text("FILE")
      ->allow_extra_args(false)
      ->group(group);
  verb.add_flag("--gnss", arguments.gnss, "simulate a GNSS receiver at the IMU for `chainslam map simulate:DIR`")
      ->group(group);
  verb.add_option("--times", arguments.times, "times of KITTI's rows: seconds, one per line")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--rate", arguments.rate, "or the rate of these rows")
      ->check(CLI::Range(0.5, 1000.0))
      ->option_text("HZ")
      ->group(group);
  verb.add_option("--frame", arguments.frame,
                  "frame of the poses: body (the IMU; default), lidar, or camera (default with --camera-lidar)")
      ->check(one_of({"body", "lidar", "camera"}))
      ->option_text("FRAME")
      ->group(group);
  verb.add_option(
          "--body-lidar", arguments.body_lidar,
          "T_body_lidar: rows of the matrix, KITTI's calib_imu_to_velo.txt, or the word kitti; default: NCLT's\n"
          "for NCLT's csv, else the identity")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--camera-lidar", arguments.camera_lidar,
                  "T_camera_lidar: rows of the matrix, KITTI's calib.txt, or the word kitti")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--imu", arguments.imu,
                  "IMU data recorded on the trajectory, used unchanged: rows timestamp,gx,gy,gz,ax,ay,az (s, rad/s,\n"
                  "m/s^2), or nominal_frame,... with KITTI's rows; default: simulated")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--imu-offset", arguments.imu_offset,
                  "offset that is added to the IMU times (default 0: a lag remains)")
      ->check(CLI::Range(-1e9, 1e9).description(""))
      ->option_text("SECONDS")
      ->group(group);
  verb.add_option(
          "--skip", arguments.skips,
          "leave out IMU rows from FROM to TO (s); at the start or end of the drive, cut it there; or a file of\n"
          "such rows; can be repeated")
      ->option_text("FROM:TO|FILE")
      ->allow_extra_args(false)
      ->group(group);
  verb.add_option("--lidar", arguments.lidar, "one of " + simulator::lidar_names() + " (default HDL-64E)")
      ->option_text("NAME")
      ->group(group);
  verb.add_option("--columns", arguments.columns, "approximate number of firings per revolution (default 1024)")
      ->check(CLI::Range(36, 8192))
      ->option_text("N")
      ->group(group);
  verb.add_option("--lidar-height", arguments.lidar_height, "height of the LiDAR above the road (default 1.73)")
      ->check(CLI::Range(0.2, 10.0))
      ->option_text("METRES")
      ->group(group);
  verb.add_flag("!--no-scans", arguments.scans, "write everything except scans, for `chainslam map simulate:DIR`")
      ->group(group);
}

void add_simulate(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<SimulateArguments>();
  CLI::App* verb = program.add_subcommand(
      "simulate", "simulate a data set: drives through a town or a campus, or along a recorded trajectory");
  verb->footer(
      "With --trajectory, the motion and the IMU data of --imu are real and only the scans are simulated, in a world\n"
      "that is built along the trajectory. DIR contains scans/*.pcd, times.txt, imu.csv, truth.tum, T_body_lidar.txt\n"
      "and README.txt. `chainslam map simulate:DIR` simulates the scans while mapping; --no-scans then saves disk "
      "space.\n"
      "KITTI: simulate --trajectory 07_truth_camera.txt --rate 9.615 --imu 07_imu.csv --body-lidar kitti \\\n"
      "       --camera-lidar kitti --skip filled.txt --out DIR");
  verb->add_option("PRESET", arguments->preset, "name of the preset: " + known_presets())->option_text(" ");
  verb->add_option("--out", arguments->out, "output folder")->required()->option_text("DIR");
  verb->add_option("--size", arguments->size,
                   "size of nclt-like, mars-like, nclt-hard and mars-hard: small, medium (default), large or full")
      ->check(one_of({"small", "medium", "large", "full"}))
      ->option_text("SIZE");
  verb->add_option("--sessions", arguments->sessions, "only the first N sessions of the preset")
      ->check(CLI::Range(1, 1000))
      ->option_text("N");
  verb->add_option("--errors", arguments->errors,
                   "enable only these error sources of the preset, separated by commas: all (default), or of\n" +
                       in_lines(simulator::error_source_names()))
      ->option_text("NAMES");
  verb->add_option("--without", arguments->without, "disable these error sources, separated by commas")
      ->option_text("NAMES");
  verb->add_option("--seed", arguments->seed, "random seed; the same seed gives identical files (default 1)")
      ->option_text("N");
  add_recorded(*verb, *arguments);
  verb->add_flag("--overwrite", arguments->overwrite, "if DIR is not empty, keep it as DIR~1");
  verb->add_option("--threads", arguments->threads, "number of threads; default: all cores; does not change the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_inspect(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<InspectArguments>();
  CLI::App* verb = program.add_subcommand("inspect", "print metadata and warnings of a data set, a file or a map");
  verb->footer(
      "Reads everything once. Data sets: see README.md. Files: .pcd, .ply, KITTI's .bin, .g2o, trajectories of TUM,\n"
      "KITTI, EuRoC and NCLT. Maps: map files (.cslam) and the folders that `chainslam map` writes.\n"
      "Lines that begin with ! are warnings.");
  verb->add_option("PATH", arguments->path, "data set, file or map")->required()->option_text(" ");
  verb->add_option("--config", arguments->config, "configuration file with settings of the reader")
      ->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a setting; can be repeated")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--imu-seconds", arguments->imu_seconds,
                   "length of the data from which the IMU's time offset and axes are estimated (default 60; 0: none).\n"
                   "Ctrl-C ends the estimation early")
      ->option_text("SECONDS")
      ->check(CLI::Range(0.0, 1e6).description(""));
  verb->add_flag("--closures", arguments->closures,
                 "also list a map's closures: why each was tried, and whether and why it was accepted, refused,\n"
                 "rejected or taken back");
  verb->add_flag("--json", arguments->json, "print JSON instead of tables; with --closures also the measured poses");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_check(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<CheckArguments>();
  CLI::App* verb = program.add_subcommand("check", "verify all checksums and invariants of a map file");
  verb->footer("Reads the whole file. Exit code 3 if anything is damaged or missing, with a list of what is intact.");
  verb->add_option("MAP", arguments->map, "map file (.cslam)")->required()->option_text(" ");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_recover(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<RecoverArguments>();
  CLI::App* verb = program.add_subcommand(
      "recover", "recover an interrupted run, or the intact part of a truncated or corrupted map file");
  verb->footer(
      "MAP is the folder DIR.partial of an interrupted `chainslam map --out DIR`. All keyframes that the progress "
      "line\n"
      "had shown are recovered except for at most the last second of data. Loop closure is repeated with the run's "
      "own\n"
      "configuration, so the map is the one that the run would have written; this takes as long as loop closure took.\n"
      "With --no-replay, only closures found so far are used. If another version of chainslam started the run, "
      "settings\n"
      "that this version does not have are listed and ignored.\n"
      "From a map file, everything up to the last readable commit is recovered; damaged scans are dropped, their\n"
      "keyframes stay. Keyframes after the last optimized poses are placed by odometry.\n"
      "MAP is not modified; NEW is read back and checked.");
  verb->add_option("MAP", arguments->map, "DIR.partial, or a map file (.cslam, .cslam.partial)")
      ->required()
      ->option_text(" ");
  verb->add_option("-o,--out", arguments->out, "output map file")->required()->option_text("NEW");
  verb->add_flag("--overwrite", arguments->overwrite, "if NEW exists, keep it as NEW~1");
  verb->add_flag("!--no-replay", arguments->replay, "for an interrupted run: use only closures found so far");
  verb->add_option("--threads", arguments->threads, "number of threads; default: all cores; does not change the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_undo(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<UndoArguments>();
  CLI::App* verb = program.add_subcommand("undo", "remove sessions, merges or closures with all that came of them");
  verb->footer(
      "What is removed takes with it what descended from it: chains of a closure, all places of a merge, and closures\n"
      "between two sessions that were found after merges had joined these and only these had. NEW has the exact\n"
      "optimum of what remains; sessions that nothing connects any more get frames of their own.\n"
      "With --replay, closures, merges and outliers are decided again from the saved scans with the map's own\n"
      "settings: without a session, NEW is the map that would have been made had that session never been there.\n"
      "A closure or merge that was undone is not found again. Sessions of --load maps are replayed in the same run.\n"
      "`chainslam inspect MAP --closures` lists the numbers. MAP is not modified.");
  verb->add_option("MAP", arguments->map, "map file (.cslam), or a folder that `chainslam map` wrote")
      ->required()
      ->option_text(" ");
  verb->add_option("--session", arguments->sessions, "remove this session, by number or name; can be repeated")
      ->option_text("ID")
      ->allow_extra_args(false);
  verb->add_option("--closure", arguments->closures, "remove this direct or chained closure; can be repeated")
      ->option_text("ID")
      ->allow_extra_args(false);
  verb->add_option("--merge", arguments->merges, "remove the merge that this closure is a place of; can be repeated")
      ->option_text("ID")
      ->allow_extra_args(false);
  verb->add_flag("--replay", arguments->replay, "decide again from the saved scans");
  verb->add_option("-o,--out", arguments->out, "output map file")->required()->option_text("NEW");
  verb->add_flag("--overwrite", arguments->overwrite, "if NEW exists, keep it as NEW~1");
  verb->add_option("--threads", arguments->threads, "number of threads; default: all cores; does not change the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->callback([arguments, &exit_code] {
    if (arguments->sessions.empty() && arguments->closures.empty() && arguments->merges.empty())
      throw CLI::ValidationError("undo", "nothing to undo: pass --session, --closure or --merge");
    exit_code = run(*arguments);
  });
}

void add_merge(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<MergeArguments>();
  CLI::App* verb = program.add_subcommand("merge", "merge saved maps into one");
  verb->footer(
      "The sessions of all maps but the first are mapped on top of that one from their saved scans, odometry and\n"
      "fixes: closures, chains, merges and outliers are decided as by `chainslam map DATA --load MAP`, without the\n"
      "data. The first map is the one with the earliest keyframe (then the one with most keyframes): any order of the\n"
      "arguments gives the same file. A recording that several maps have, such as maps that were saved from one\n"
      "another, is taken once, from the map with most of it. Sessions that match nothing stay in frames of their own;\n"
      "with --set goals.merged=true the exit code is then 5. Takes as long as loop closure took. The maps are not\n"
      "modified; Ctrl-C saves nothing.");
  verb->add_option("MAP", arguments->maps, "map files (.cslam), or folders that `chainslam map` wrote: at least two")
      ->required()
      ->option_text("MAP ...")
      ->expected(2, CLI::detail::expected_max_vector_size);
  verb->add_option("-o,--out", arguments->out, "output map file")->required()->option_text("NEW");
  verb->add_flag("--overwrite", arguments->overwrite, "if NEW exists, keep it as NEW~1");
  verb->add_option("--config", arguments->config, "configuration file (TOML); default: the settings of the first map")
      ->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a setting; can be repeated")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--threads", arguments->threads, "number of threads; default: all cores; does not change the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_report(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<ReportArguments>();
  CLI::App* verb = program.add_subcommand("report", "write the report of a map again, from the map alone");
  verb->footer(
      "DIR contains report.html, map.ply (one for each frame) and map.png, as `chainslam map` writes them. What only\n"
      "the run knew is left out: times, memory, IMU calibration, errors against a ground truth.\n"
      "`chainslam export` writes trajectories, graphs and clouds.");
  verb->add_option("MAP", arguments->map, "map file (.cslam), or a folder that `chainslam map` wrote")
      ->required()
      ->option_text(" ");
  verb->add_option("--out", arguments->out, "output folder")->required()->option_text("DIR");
  verb->add_flag("--overwrite", arguments->overwrite, "if DIR is not empty, keep it as DIR~1");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

/// The camera and where it sits, as `--camera` and `--body-camera` say. @throws CLI::ValidationError
void set_camera(const ExportArguments& arguments, ColmapExport& colmap) {
  if (const auto& c = arguments.camera; !c.empty()) {
    const auto is_size = [](double pixels) { return pixels >= 1 && pixels <= 1e5 && pixels == std::floor(pixels); };
    if (!is_size(c[0]) || !is_size(c[1])) throw CLI::ValidationError("--camera", "WIDTH and HEIGHT are whole numbers");
    if (!(c[2] > 0 && c[3] > 0)) throw CLI::ValidationError("--camera", "FX and FY are positive");
    for (const double value : c)
      if (!std::isfinite(value)) throw CLI::ValidationError("--camera", "a number that is not finite");
    colmap.camera = {static_cast<int>(c[0]), static_cast<int>(c[1]), c[2], c[3], c[4], c[5]};
  }
  if (const auto& p = arguments.T_body_camera; !p.empty()) {
    const Eigen::Quaterniond q(p[6], p[3], p[4], p[5]);
    const bool finite = std::ranges::all_of(p, [](double value) { return std::isfinite(value); });
    if (!finite || !(std::abs(q.norm() - 1) < 1e-3))
      throw CLI::ValidationError("--body-camera", "QX QY QZ QW is a unit quaternion");
    colmap.T_body_camera = SE3d(SO3d::from_quaternion(q), {p[0], p[1], p[2]});
  }
}

void add_export(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<ExportArguments>();
  CLI::App* verb = program.add_subcommand("export", "export a map to another format");
  verb->footer(
      "tum, kitti: PATH is a folder with a trajectory for each session and a joint one. g2o, ply, pcd, las: PATH is a\n"
      "file. las: LAS 1.4, UTM coordinates (WGS 84) where GNSS fixes put the map on the Earth, else those of the map;\n"
      "point source IDs are sessions. grid: an occupancy grid for the map server of ROS, PATH.yaml and PATH.pgm: rays\n"
      "from the LiDAR to its returns, at heights over the local ground where a robot drives.\n"
      "colmap: PATH is a folder with cameras.txt, images.txt and points3D.txt; a map has no images, so a camera is\n"
      "assumed at each keyframe, with the image SESSION/NANOSECONDS.png.\n"
      "Sessions that were not merged have separate frames: each gets its own joint trajectory, cloud or folder.");
  verb->add_option("MAP", arguments->map, "map file (.cslam)")->required()->option_text(" ");
  verb->add_option("--format", arguments->format, "tum, kitti, g2o, ply, pcd, las, grid or colmap")
      ->required()
      ->check(one_of({"tum", "kitti", "g2o", "ply", "pcd", "las", "grid", "colmap"}))
      ->option_text("FORMAT");
  verb->add_option("--out", arguments->out, "output folder or file")->required()->option_text("PATH");
  verb->add_option("--voxel", arguments->options.voxel_size, "voxel size of clouds, metres; 0: all points; default 0.2")
      ->check(CLI::Range(0.0, 10.0))
      ->option_text("SIZE");
  OccupancyGridOptions& grid = arguments->options.grid;
  verb->add_option("--resolution", grid.resolution, "cell size of grid, metres; default 0.1")
      ->check(CLI::Range(0.01, 10.0))
      ->option_text("SIZE");
  verb->add_option("--height", arguments->heights,
                   "heights above the local ground between which returns are obstacles for grid;\n"
                   "default 0.2 2.0")
      ->expected(2)
      ->option_text("MIN MAX");
  verb->add_option("--range", grid.max_range, "maximum length of rays for grid, metres; default 40")
      ->check(CLI::Range(1.0, 1000.0))
      ->option_text("METRES");
  verb->add_option("--camera", arguments->camera,
                   "camera of colmap: pixels, no distortion; default 1280 720 640 640 640 360, 90 degrees wide")
      ->expected(6)
      ->option_text("WIDTH HEIGHT FX FY CX CY");
  verb->add_option("--body-camera", arguments->T_body_camera,
                   "camera pose of colmap: T_body_camera, camera x right, y down, z forward;\n"
                   "default: at the body's origin, looking along its x axis")
      ->expected(7)
      ->option_text("X Y Z QX QY QZ QW");
  verb->add_flag("--overwrite", arguments->options.overwrite, "if PATH exists, keep it as PATH~1");
  verb->callback([arguments, &exit_code] {
    set_camera(*arguments, arguments->options.colmap);
    if (const auto& heights = arguments->heights; !heights.empty()) {
      if (!(heights[0] < heights[1])) throw CLI::ValidationError("--height", "MIN is less than MAX");
      arguments->options.grid.min_height = heights[0];
      arguments->options.grid.max_height = heights[1];
    }
    exit_code = run(*arguments);
  });
}

/// An option that takes one of several words.
template <class Value>
void add_choice(CLI::App& verb, const std::string& name, Value& member, const std::string& help,
                std::vector<std::pair<std::string, Value>> choices) {
  std::vector<std::string> words;
  std::string list;
  for (const auto& [word, value] : choices) {
    words.push_back(word);
    list += (list.empty() ? "" : "|") + word;
  }
  const auto assign = [choices, &member](const std::string& text) {
    member = std::ranges::find(choices, text, &std::pair<std::string, Value>::first)->second;
  };
  verb.add_option_function<std::string>(name, assign, help)->option_text(list)->check(one_of(words));
}

void add_eval(CLI::App& program, int& exit_code) {
  const auto options = std::make_shared<EvalArguments>();
  CLI::App* verb =
      program.add_subcommand("eval", "compute APE and RPE of trajectories as evo does, and KITTI's relative errors");
  verb->footer(
      "Formats are detected: TUM, KITTI poses, EuRoC csv, NCLT ground truth csv. Several pairs are sessions of one\n"
      "map: they share one alignment, and relative errors do not cross sessions. For paths longer than 100 m,\n"
      "KITTI's relative errors are printed as well; both trajectories must then be poses of the same sensor.\n"
      "Examples:\n"
      "  chainslam eval truth.tum map/trajectory.tum\n"
      "  chainslam eval KITTI_00_gt.txt KITTI_00_ORB.txt --align none --delta 10m\n"
      "  chainslam eval groundtruth_2012-01-08.csv map/trajectory.tum --nclt imu --associate interpolate\n"
      "  chainslam eval truth1.csv session1.tum truth2.csv session2.tum --max-difference 0.2 --project xy --json "
      "e.json");
  verb->add_option("files", options->files, "REFERENCE ESTIMATE, one pair per session")
      ->required()
      ->option_text("PATH PATH ...")
      ->expected(2, CLI::detail::expected_max_vector_size);
  add_choice<Alignment>(
      *verb, "--align", options->alignment.align,
      "alignment of the estimate to the reference: se3 (default), sim3 (with scale), origin (first poses\n"
      "agree), none",
      {{"none", Alignment::none}, {"origin", Alignment::origin}, {"se3", Alignment::se3}, {"sim3", Alignment::sim3}});
  add_choice<bool>(*verb, "--project", options->alignment.project_xy,
                   "xy: project poses to the xy-plane before alignment", {{"xy", true}, {"none", false}});
  add_choice<Associate>(
      *verb, "--associate", options->associate,
      "association of poses: time (nearest; default if both have times), index (default otherwise),\n"
      "interpolate (the reference is interpolated at the estimate's times)",
      {{"time", Associate::time}, {"index", Associate::index}, {"interpolate", Associate::interpolate}});
  verb->add_option(
          "--max-difference", options->max_difference,
          "maximum time difference of associated poses (default 0.01), or with interpolate the maximum gap in\n"
          "the reference (default 1)")
      ->option_text("SECONDS")
      ->check(CLI::Range(0.0, 1e9).description(""));
  verb->add_option("--delta", options->delta, "segment length of relative errors, for example 10m or 1frame (default)")
      ->option_text("DELTA")
      ->check(CLI::Validator(
          [](std::string& text) {
            return parse_delta(text) ? std::string{} : "'" + text + "' is no distance: write 10m or 1frame";
          },
          ""));
  add_choice<PairChoice>(*verb, "--pairs", options->pairs, "pairs of relative errors: consecutive (default) or all",
                         {{"consecutive", PairChoice::consecutive}, {"all", PairChoice::all}});
  verb->add_option(
          "--kitti-step", options->kitti_step,
          "number of poses between the starts of segments of KITTI's relative errors (default 10: one second at 10 Hz)")
      ->option_text("POSES")
      ->check(CLI::Range(1, 1'000'000).description(""));
  add_choice<NcltPoses>(
      *verb, "--nclt", options->nclt_poses,
      "frame of the poses in NCLT's csv: stated (z down; default) or imu (z up, as in this program's maps)",
      {{"stated", NcltPoses::stated}, {"imu", NcltPoses::imu}});
  verb->add_option("--json", options->json, "also write all figures to this file")->option_text("FILE");
  verb->add_flag("--overwrite", options->overwrite, "if FILE exists, keep it as FILE~1");
  verb->add_option("--max-ape", options->max_ape, "exit code 5 if the rms APE exceeds this")->option_text("METRES");
  verb->add_option("--max-rpe", options->max_rpe, "exit code 5 if the rms RPE exceeds this")->option_text("METRES");
  verb->callback([options, &exit_code] {
    if (options->files.size() % 2 != 0)
      throw CLI::ValidationError("files", "each REFERENCE needs its ESTIMATE: an even number of files");
    exit_code = run(*options);
  });
}

void add_optimize(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<OptimizeArguments>();
  CLI::App* verb = program.add_subcommand("optimize", "optimize a pose graph of a g2o file");
  verb->add_option("FILE", arguments->input, "pose graph")->required()->option_text(" ");
  verb->add_option("--out", arguments->out, "output file of the optimized graph")->option_text("FILE");
  verb->add_flag("--overwrite", arguments->overwrite, "if FILE exists, keep it as FILE~1");
  verb->add_option("--max-iterations", arguments->max_iterations, "maximum number of iterations; default 100")
      ->check(CLI::Range(1, 100000))
      ->option_text("N");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_config(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<ConfigArguments>();
  CLI::App* verb = program.add_subcommand("config", "print, check and describe settings");
  verb->add_flag("--print", arguments->print, "print all settings with descriptions, as a TOML file");
  verb->add_option("--config", arguments->file, "with --print: use the values of this file")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "with --print: override a setting; can be repeated")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--check", arguments->check, "check a configuration file without running anything")
      ->option_text("FILE");
  verb->add_option("--explain", arguments->explain, "describe a setting or a table of settings")->option_text("KEY");
  verb->require_option(1, 0);
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

/// What is wrong with the first option that a subcommand does not have, if there is one.
std::string unknown_option(const CLI::App& verb, const std::vector<std::string>& words) {
  std::vector<std::string> names;
  for (const CLI::Option* option : verb.get_options())
    for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
  for (const std::string& word : words) {
    const std::string name = word.substr(0, word.find('='));
    if (word.size() > 2 && word.starts_with("--") && std::ranges::find(names, name) == names.end())
      return "unknown option '" + name + "'" + support::suggestion(name, names);
  }
  return "";
}

/// What is wrong with the first word, if it is meant to be a subcommand and is none.
std::string unknown_verb(const CLI::App& program, const std::vector<std::string>& words) {
  if (words.empty() || words.front().size() < 2) return "";
  if (words.front().starts_with('-')) return unknown_option(program, {words.front()});
  std::vector<std::string> names;
  for (const CLI::App* verb : program.get_subcommands({})) names.push_back(verb->get_name());
  return "unknown subcommand '" + words.front() + "'" + support::suggestion(words.front(), names);
}

}  // namespace

int run_command_line(int argc, const char* const* argv, SessionWorkers* workers) {
  CLI::App program{"chainslam: multi-session LiDAR(-inertial) mapping with loop closure", "chainslam"};
  program.set_version_flag("--version", build_description());
  program.require_subcommand(1);
  program.footer(
      "chainslam SUBCOMMAND --help describes a subcommand.\n"
      "Exit codes: 0 success, 2 usage or configuration, 3 unusable input, 4 output or disk,\n"
      "5 finished, but a goal was missed, 70 internal error, 130 interrupted (map saved).");
  int exit_code = exit_good;
  add_map(program, workers, exit_code);
  add_odometry(program, exit_code);
  add_localize(program, exit_code);
  add_simulate(program, exit_code);
  add_inspect(program, exit_code);
  add_check(program, exit_code);
  add_recover(program, exit_code);
  add_undo(program, exit_code);
  add_merge(program, exit_code);
  add_report(program, exit_code);
  add_export(program, exit_code);
  add_eval(program, exit_code);
  add_optimize(program, exit_code);
  add_config(program, exit_code);
  const std::vector<std::string> words(argv + std::min(argc, 1), argv + argc);
  try {
    program.parse(argc, argv);
    return exit_code;
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return program.exit(error);
    const std::vector<CLI::App*> verbs = program.get_subcommands();
    const std::string verb = verbs.empty() ? "" : " " + verbs.front()->get_name();
    const std::string unknown = verbs.empty() ? unknown_verb(program, words) : unknown_option(*verbs.front(), words);
    std::fprintf(stderr, "error: chainslam%s\n  found: %s\n  do: `chainslam%s --help` says what it takes\n",
                 verb.c_str(), printable(unknown.empty() ? error.what() : unknown).c_str(), verb.c_str());
    return exit_usage;
  }
}

}  // namespace chainslam::mapper
