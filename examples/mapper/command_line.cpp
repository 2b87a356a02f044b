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

#include "chainslam/core/printable.hpp"
#include "chainslam/core/version.hpp"
#include "exit_code.hpp"
#include "simulator/error_sources.hpp"
#include "simulator/lidar_model.hpp"
#include "verbs.hpp"

// The only file that includes CLI11, which is headers only: each file that includes it compiles all of it anew.
namespace chainslam::mapper {

namespace {

#define CHAINSLAM_TEXT_OF(x) #x
#define CHAINSLAM_TEXT(x) CHAINSLAM_TEXT_OF(x)
constexpr const char* version = CHAINSLAM_TEXT(CHAINSLAM_VERSION_MAJOR) "." CHAINSLAM_TEXT(
    CHAINSLAM_VERSION_MINOR) "." CHAINSLAM_TEXT(CHAINSLAM_VERSION_PATCH);

void add_map(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<MapArguments>();
  CLI::App* verb = program.add_subcommand("map", "map data sets, one after the other, alone or on top of saved maps");
  verb->footer(
      "DIR gets map.cslam (the map, to go on from with --load), report.html, map.ply, trajectory.tum and .kitti.txt,\n"
      "odometry.tum, graph.g2o, keyframes.csv, closures.csv, config.toml, summary.json and map.png; of several data\n"
      "sets a trajectory each. Ctrl-C finishes the scan at hand and saves what there is; a second Ctrl-C stops at "
      "once,\n"
      "and so may a crash or a loss of power: `chainslam recover DIR.partial -o NEW` then makes the map of all that "
      "the\n"
      "progress line had shown, but for at most the last second of data.\n"
      "`chainslam config --print` shows everything that can be configured.");
  verb->add_option("DATA", arguments->data,
                   "folders of data sets, one session each (see chainslam inspect), or "
                   "simulate:PRESET/SIZE/SESSION or simulate:FOLDER (see chainslam simulate)")
      ->required()
      ->option_text("...");
  verb->add_option("--load", arguments->maps, "maps to go on from: map.cslam of earlier runs")->option_text("MAP...");
  verb->add_option("--out", arguments->out, "folder to write")->required()->option_text("DIR");
  verb->add_flag("--overwrite", arguments->overwrite, "if DIR holds something, keep that as DIR~1");
  verb->add_option("--config", arguments->config, "configuration file (TOML)")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a key of it, may be given again")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--truth", arguments->truths, "true trajectories, one for each DATA; default: the data sets' own")
      ->option_text("FILE...");
  verb->add_option("--max-scans", arguments->max_scans, "stop after so many scans of each data set")
      ->check(CLI::NonNegativeNumber)
      ->option_text("N");
  verb->add_option("--threads", arguments->threads, "default: all cores; changes the time, not the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->add_option("--max-memory", arguments->max_memory,
                   "end the run, save the map and exit with 4 where it needs more, as in 6GB; default: half of the\n"
                   "machine's memory. Maps of --load that need more are refused")
      ->transform(CLI::AsSizeValue(true).description(""))
      ->option_text("SIZE");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_odometry(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<OdometryArguments>();
  CLI::App* verb = program.add_subcommand("odometry", "run odometry alone, and record it as a data set to map from");
  verb->footer(
      "SET gets Scans/*.pcd (with intensities if DATA have them), times.txt and odom_poses.txt of the keyframes, as\n"
      "other programs read keyframe sets; frames.csv (pose, covariance and health of every scan), fixes.csv,\n"
      "truth.tum, odometry.json, config.toml and summary.json (times, memory, errors against the truth).\n"
      "`chainslam map SET --config SET/config.toml` gives the same map, bit for bit, as mapping DATA; with other "
      "settings\n"
      "of closures, chain, merge and graph it takes seconds. Keyframes are kept as keyframes.distance, angle and\n"
      "voxel_size say: to try other values of these, record with smaller ones.");
  verb->add_option("DATA", arguments->data,
                   "folder of a data set (see chainslam inspect), simulate:PRESET/SIZE/SESSION or simulate:FOLDER")
      ->required()
      ->option_text(" ");
  verb->add_option("--out", arguments->out, "folder to write")->required()->option_text("SET");
  verb->add_flag("--overwrite", arguments->overwrite, "if SET holds something, keep that as SET~1");
  verb->add_option("--config", arguments->config, "configuration file (TOML)")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a key of it, may be given again")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--truth", arguments->truth, "true trajectory; default: the data set's own")->option_text("FILE");
  verb->add_option("--max-scans", arguments->max_scans, "stop after so many scans")
      ->check(CLI::NonNegativeNumber)
      ->option_text("N");
  verb->add_option("--threads", arguments->threads, "default: all cores; changes the time, not the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->add_option("--max-memory", arguments->max_memory,
                   "end the run, record what came before and exit with 4 where it needs more, as in 6GB; default:\n"
                   "half of the machine's memory")
      ->transform(CLI::AsSizeValue(true).description(""))
      ->option_text("SIZE");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

/// What `simulate` takes for a recorded trajectory.
/// A list as lines of about 100 characters.
std::string in_lines(std::string list) {
  constexpr std::size_t width = 100;
  for (std::size_t at = list.find(", ", width); at != std::string::npos; at = list.find(", ", at + width))
    list[at + 1] = '\n';
  return list;
}

void add_recorded(CLI::App& verb, SimulateArguments& arguments) {
  const std::string group = "Along a recorded trajectory";
  verb.add_option("--trajectory", arguments.trajectory,
                  "in place of PRESET: TUM's, EuRoC's or NCLT's trajectory, or KITTI's 12 numbers a row")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--also", arguments.others,
                  "another drive in the frame of the first, of which the world is built as well; may be given again.\n"
                  "The same drives make the same world, whichever is the first")
      ->option_text("FILE")
      ->allow_extra_args(false)
      ->group(group);
  verb.add_flag("--gnss", arguments.gnss,
                "simulate a receiver at the IMU, whose fixes `chainslam map simulate:DIR` hands on")
      ->group(group);
  verb.add_option("--times", arguments.times, "of KITTI's rows: seconds, one a line")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--rate", arguments.rate, "... or their number in a second")
      ->check(CLI::Range(0.5, 1000.0))
      ->option_text("HZ")
      ->group(group);
  verb.add_option("--frame", arguments.frame,
                  "whose poses they are: body (the IMU; default), lidar, or camera (default with --camera-lidar)")
      ->check(CLI::IsMember({"body", "lidar", "camera"}))
      ->option_text("FRAME")
      ->group(group);
  verb.add_option(
          "--body-lidar", arguments.body_lidar,
          "T_body_lidar: rows of the matrix, KITTI's calib_imu_to_velo.txt, or the word kitti; default: NCLT's\n"
          "for NCLT's csv, else no difference")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--camera-lidar", arguments.camera_lidar,
                  "T_camera_lidar: rows of the matrix, KITTI's calib.txt, or the word kitti")
      ->option_text("FILE")
      ->group(group);
  verb.add_option(
          "--imu", arguments.imu,
          "recorded on the trajectory, taken unchanged: rows timestamp,gx,gy,gz,ax,ay,az (s, rad/s, m/s^2), or\n"
          "nominal_frame,... with KITTI's rows; default: simulated")
      ->option_text("FILE")
      ->group(group);
  verb.add_option("--imu-offset", arguments.imu_offset, "added to the IMU's times (default 0: a lag stays)")
      ->check(CLI::Range(-1e9, 1e9).description(""))
      ->option_text("SECONDS")
      ->group(group);
  verb.add_option(
          "--skip", arguments.skips,
          "leave out IMU rows from FROM to TO (s); the drive is cut there if that is at its start or end; or a\n"
          "file of such rows; may be given again")
      ->option_text("FROM:TO|FILE")
      ->allow_extra_args(false)
      ->group(group);
  verb.add_option("--lidar", arguments.lidar, "one of " + simulator::lidar_names() + " (default HDL-64E)")
      ->option_text("NAME")
      ->group(group);
  verb.add_option("--columns", arguments.columns, "firings per revolution, about (default 1024)")
      ->check(CLI::Range(36, 8192))
      ->option_text("N")
      ->group(group);
  verb.add_option("--lidar-height", arguments.lidar_height, "of the LiDAR above the road (default 1.73)")
      ->check(CLI::Range(0.2, 10.0))
      ->option_text("METRES")
      ->group(group);
  verb.add_flag("!--no-scans", arguments.scans, "write all but the scans, for `chainslam map simulate:DIR`")
      ->group(group);
}

void add_simulate(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<SimulateArguments>();
  CLI::App* verb = program.add_subcommand(
      "simulate", "make a data set: drives through a town or a campus, or along a recorded trajectory");
  verb->footer(
      "With --trajectory the motion is real, and so is the IMU data of --imu: only the scans are simulated, in a "
      "world\n"
      "that is built along the trajectory. DIR gets scans/*.pcd, times.txt, imu.csv, truth.tum, T_body_lidar.txt and\n"
      "README.txt. `chainslam map simulate:DIR` makes the scans while it maps them; --no-scans then saves the disk.\n"
      "KITTI: simulate --trajectory 07_truth_camera.txt --rate 9.615 --imu 07_imu.csv --body-lidar kitti \\\n"
      "       --camera-lidar kitti --skip filled.txt --out DIR");
  verb->add_option("PRESET", arguments->preset, "what to make: " + known_presets())->option_text(" ");
  verb->add_option("--out", arguments->out, "folder to write")->required()->option_text("DIR");
  verb->add_option("--size", arguments->size,
                   "of nclt- and mars-like and -hard: small, medium (default), large or full")
      ->check(CLI::IsMember({"small", "medium", "large", "full"}))
      ->option_text("SIZE");
  verb->add_option("--sessions", arguments->sessions, "only the first N of the preset's")
      ->check(CLI::Range(1, 1000))
      ->option_text("N");
  verb->add_option("--errors", arguments->errors,
                   "keep only these of the preset's error sources, separated by commas: all (default), or of\n" +
                       in_lines(simulator::error_source_names()))
      ->option_text("NAMES");
  verb->add_option("--without", arguments->without, "leave these error sources out, separated by commas")
      ->option_text("NAMES");
  verb->add_option("--seed", arguments->seed, "the same seed gives the same bytes (default 1)")->option_text("N");
  add_recorded(*verb, *arguments);
  verb->add_flag("--overwrite", arguments->overwrite, "if DIR holds something, keep that as DIR~1");
  verb->add_option("--threads", arguments->threads, "default: all cores; changes the time, not the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_inspect(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<InspectArguments>();
  CLI::App* verb =
      program.add_subcommand("inspect", "say what a data set, a file or a map is, and what looks odd in it");
  verb->footer(
      "Reads everything once. Data sets: NCLT, folders of range images, of clouds, of keyframes with odometry. Files:\n"
      ".pcd, .ply, KITTI's .bin, .g2o, trajectories of TUM, KITTI, EuRoC and NCLT. Maps: map files (.cslam) and the\n"
      "folders that `chainslam map` writes.\n"
      "Lines that begin with ! are worth a look before the data are used.");
  verb->add_option("PATH", arguments->path, "data set, file or map")->required()->option_text(" ");
  verb->add_option("--config", arguments->config, "configuration file, for how the data set is read")
      ->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a key of it, may be given again")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--imu-seconds", arguments->imu_seconds,
                   "compare IMU and scans over the first so many seconds, for the IMU's clock and axes (default 60);\n"
                   "0: not at all. Ctrl-C ends it with what was found so far")
      ->option_text("SECONDS")
      ->check(CLI::Range(0.0, 1e6).description(""));
  verb->add_flag("--closures", arguments->closures, "list a map's closures as well");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_check(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<CheckArguments>();
  CLI::App* verb = program.add_subcommand("check", "check every checksum and every rule of a map file");
  verb->footer("Reads all of it. Exit code 3 if anything is damaged or missing, with an account of what is left.");
  verb->add_option("MAP", arguments->map, "map file (.cslam)")->required()->option_text(" ");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_recover(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<RecoverArguments>();
  CLI::App* verb = program.add_subcommand("recover", "save what is whole of a damaged or unfinished map in a new file");
  verb->footer(
      "MAP is what `chainslam map --out DIR` left when it was killed: the folder DIR.partial. Every keyframe that the\n"
      "progress line had shown is there, but for the last second of data, and loops are closed again with the run's "
      "own\n"
      "configuration: the map is the one that the run would have made of these data. That takes the time that closing\n"
      "loops took; with --no-replay it takes what the run had closed so far, at once. Of a run that another version "
      "of\n"
      "chainslam began, settings that this one does not have are named and left out.\n"
      "Of a map file, takes all up to the last commit that can be read; scans that are damaged are left out, their\n"
      "keyframes stay. Keyframes after the last optimised poses are placed by odometry.\n"
      "MAP is only read; NEW is read again to check it.");
  verb->add_option("MAP", arguments->map, "DIR.partial, or a map file (.cslam, .cslam.partial)")
      ->required()
      ->option_text(" ");
  verb->add_option("-o,--out", arguments->out, "map file to write")->required()->option_text("NEW");
  verb->add_flag("--overwrite", arguments->overwrite, "if NEW is there, keep that as NEW~1");
  verb->add_flag("!--no-replay", arguments->replay, "of an unfinished run: only what it had closed so far");
  verb->add_option("--threads", arguments->threads, "default: all cores; changes the time, not the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
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
  CLI::App* verb = program.add_subcommand("export", "write a map in another program's format");
  verb->footer(
      "tum, kitti: PATH is a folder, with a trajectory for each session and a joint one. g2o, ply, pcd: PATH is a "
      "file.\n"
      "colmap: PATH is a folder with cameras.txt, images.txt and points3D.txt; a map has no images, so that a camera "
      "is\n"
      "assumed at each keyframe, whose image is called SESSION/NANOSECONDS.png.\n"
      "Sessions that were not merged have frames of their own: each gets its own joint trajectory, cloud or folder.");
  verb->add_option("MAP", arguments->map, "map file (.cslam)")->required()->option_text(" ");
  verb->add_option("--format", arguments->format, "tum, kitti, g2o, ply, pcd or colmap")
      ->required()
      ->check(CLI::IsMember({"tum", "kitti", "g2o", "ply", "pcd", "colmap"}))
      ->option_text("FORMAT");
  verb->add_option("--out", arguments->out, "folder or file to write")->required()->option_text("PATH");
  verb->add_option("--voxel", arguments->options.voxel_size, "metres, of clouds; 0 keeps all points; default 0.2")
      ->check(CLI::Range(0.0, 10.0))
      ->option_text("SIZE");
  verb->add_option("--camera", arguments->camera,
                   "of colmap: pixels, no distortion; default 1280 720 640 640 640 360, 90 degrees wide")
      ->expected(6)
      ->option_text("WIDTH HEIGHT FX FY CX CY");
  verb->add_option("--body-camera", arguments->T_body_camera,
                   "of colmap: T_body_camera, camera x right, y down, z forward;\n"
                   "default: at the body's origin, looking along its x axis")
      ->expected(7)
      ->option_text("X Y Z QX QY QZ QW");
  verb->add_flag("--overwrite", arguments->options.overwrite, "if PATH is there, keep that as PATH~1");
  verb->callback([arguments, &exit_code] {
    set_camera(*arguments, arguments->options.colmap);
    exit_code = run(*arguments);
  });
}

/// An option that takes one of several words.
template <class Value>
void add_choice(CLI::App& verb, const std::string& name, Value& member, const std::string& help,
                std::vector<std::pair<std::string, Value>> choices) {
  std::string words;
  for (const auto& [word, value] : choices) words += (words.empty() ? "" : "|") + word;
  const auto assign = [name, words, choices, &member](const std::string& text) {
    const auto found =
        std::find_if(choices.begin(), choices.end(), [&](const auto& choice) { return choice.first == text; });
    if (found == choices.end()) throw CLI::ValidationError(name, "'" + text + "' is none of " + words);
    member = found->second;
  };
  verb.add_option_function<std::string>(name, assign, help)->option_text(words);
}

void add_eval(CLI::App& program, int& exit_code) {
  const auto options = std::make_shared<EvalArguments>();
  CLI::App* verb = program.add_subcommand("eval", "compare estimated trajectories with references, as evo does");
  verb->footer(
      "Formats are told by content: TUM, KITTI poses, EuRoC csv, NCLT ground truth csv. Several pairs are sessions of\n"
      "one map: they share one alignment, and relative errors do not reach from one into the next. Of paths longer "
      "than\n"
      "100 m, KITTI's relative errors are given as well: estimate and reference must then be poses of one sensor.\n"
      "Examples:\n"
      "  chainslam eval truth.tum map/trajectory.tum\n"
      "  chainslam eval KITTI_00_gt.txt KITTI_00_ORB.txt --align none --delta 10m\n"
      "  chainslam eval groundtruth_2012-01-08.csv map/trajectory.tum --nclt imu --associate interpolate\n"
      "  chainslam eval truth1.csv session1.tum truth2.csv session2.tum --max-difference 0.2 --project xy --json "
      "e.json");
  verb->add_option("files", options->files, "REFERENCE ESTIMATE, once for each session")
      ->required()
      ->option_text("PATH PATH ...")
      ->expected(2, CLI::detail::expected_max_vector_size);
  add_choice<Alignment>(
      *verb, "--align", options->alignment.align,
      "transform of the estimate that is fitted before errors are taken: se3 (default), sim3 (with scale),\n"
      "origin (the first poses agree), none",
      {{"none", Alignment::none}, {"origin", Alignment::origin}, {"se3", Alignment::se3}, {"sim3", Alignment::sim3}});
  add_choice<bool>(*verb, "--project", options->alignment.project_xy, "xy: lay poses flat before they are aligned",
                   {{"xy", true}, {"none", false}});
  add_choice<Associate>(
      *verb, "--associate", options->associate,
      "which poses belong together: time (nearest; default where both have times), index (default else),\n"
      "interpolate (the reference is interpolated to the estimate's times)",
      {{"time", Associate::time}, {"index", Associate::index}, {"interpolate", Associate::interpolate}});
  verb->add_option("--max-difference", options->max_difference,
                   "largest difference of the times of two poses that are joined (default 0.01), or with interpolate\n"
                   "the longest gap in the reference (default 1)")
      ->option_text("SECONDS")
      ->check(CLI::Range(0.0, 1e9).description(""));
  verb->add_option("--delta", options->delta, "distance of relative errors, as in 10m or 1frame (default)")
      ->option_text("DELTA")
      ->check(CLI::Validator(
          [](std::string& text) {
            return parse_delta(text) ? std::string{} : "'" + text + "' is no distance: write 10m or 1frame";
          },
          ""));
  add_choice<PairChoice>(*verb, "--pairs", options->pairs, "which pairs of that distance: consecutive (default) or all",
                         {{"consecutive", PairChoice::consecutive}, {"all", PairChoice::all}});
  verb->add_option("--kitti-step", options->kitti_step,
                   "KITTI's relative errors start a segment every so many poses: 10 (default) are a second at 10 Hz")
      ->option_text("POSES")
      ->check(CLI::Range(1, 1'000'000).description(""));
  add_choice<NcltPoses>(*verb, "--nclt", options->nclt_poses,
                        "what NCLT's csv gives: its poses as stated, z down (default), or imu: z up, of the inertial\n"
                        "unit, as this program's maps have them",
                        {{"stated", NcltPoses::stated}, {"imu", NcltPoses::imu}});
  verb->add_option("--json", options->json, "write all figures to this file as well")->option_text("FILE");
  verb->add_flag("--overwrite", options->overwrite, "if that file is there, keep it as FILE~1");
  verb->add_option("--max-ape", options->max_ape, "exit with 5 if the APE's rmse exceeds this")->option_text("METRES");
  verb->add_option("--max-rpe", options->max_rpe, "exit with 5 if the RPE's rmse exceeds this")->option_text("METRES");
  verb->callback([options, &exit_code] {
    if (options->files.size() % 2 != 0)
      throw CLI::ValidationError("files", "each REFERENCE needs its ESTIMATE: an even number of files");
    exit_code = run(*options);
  });
}

void add_optimize(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<OptimizeArguments>();
  CLI::App* verb = program.add_subcommand("optimize", "optimise a pose graph in g2o's format");
  verb->add_option("FILE", arguments->input, "pose graph")->required()->option_text(" ");
  verb->add_option("--out", arguments->out, "write the optimised graph here")->option_text("FILE");
  verb->add_flag("--overwrite", arguments->overwrite, "if that file is there, keep it as FILE~1");
  verb->add_option("--max-iterations", arguments->max_iterations, "default 100")
      ->check(CLI::Range(1, 100000))
      ->option_text("N");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

void add_config(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<ConfigArguments>();
  CLI::App* verb = program.add_subcommand("config", "print, check and explain the configuration");
  verb->add_flag("--print", arguments->print, "print all keys with comments, as a TOML file to start from");
  verb->add_option("--config", arguments->file, "with --print: the values of this file")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "with --print: override a key, may be given again")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--check", arguments->check, "check a file; nothing is run")->option_text("FILE");
  verb->add_option("--explain", arguments->explain, "say what a key or a table of keys means")->option_text("KEY");
  verb->require_option(1, 0);
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
}

}  // namespace

int run_command_line(int argc, const char* const* argv) {
  CLI::App program{"chainslam: maps from LiDAR sequences, with loop closures and a pose graph", "chainslam"};
  program.set_version_flag("--version", version);
  program.require_subcommand(1);
  program.footer(
      "chainslam VERB --help explains a verb.\n"
      "Exit codes: 0 good, 2 usage or configuration, 3 input unusable, 4 output or disk,\n"
      "5 finished but a stated goal was missed, 70 internal error, 130 interrupted (map saved).");
  int exit_code = exit_good;
  add_map(program, exit_code);
  add_odometry(program, exit_code);
  add_simulate(program, exit_code);
  add_inspect(program, exit_code);
  add_check(program, exit_code);
  add_recover(program, exit_code);
  add_export(program, exit_code);
  add_eval(program, exit_code);
  add_optimize(program, exit_code);
  add_config(program, exit_code);
  try {
    program.parse(argc, argv);
    return exit_code;
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return program.exit(error);
    const std::vector<CLI::App*> verbs = program.get_subcommands();
    const std::string verb = verbs.empty() ? "" : " " + verbs.front()->get_name();
    std::fprintf(stderr, "error: chainslam%s\n  found: %s\n  do: `chainslam%s --help` says what it takes\n",
                 verb.c_str(), printable(error.what()).c_str(), verb.c_str());
    return exit_usage;
  }
}

}  // namespace chainslam::mapper
