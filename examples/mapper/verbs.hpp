#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "chainslam/trajectory/alignment.hpp"
#include "chainslam/trajectory/kitti_errors.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "map_export.hpp"
#include "session_workers.hpp"
#include "trajectory_file.hpp"

namespace chainslam::simulator {
struct Preset;
}

namespace chainslam::mapper {

/// @name What the command line says to each verb of the program (see command_line.cpp).
/// @{
struct MapArguments {
  std::vector<std::filesystem::path> data, maps, truths;
  std::filesystem::path out, config;
  std::vector<std::string> overrides;
  bool overwrite = false;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  int max_scans = 0;
  std::uint64_t max_memory = 0;  ///< bytes; 0: half of the machine's
};

struct OdometryArguments {
  std::filesystem::path data, truth, out, config;
  std::vector<std::string> overrides;
  bool overwrite = false;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  int max_scans = 0;
  std::uint64_t max_memory = 0;  ///< bytes; 0: half of the machine's
};

struct LocalizeArguments {
  std::filesystem::path data, map, truth, out, config;
  std::vector<std::string> overrides;
  bool overwrite = false;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  int max_scans = 0;
  std::uint64_t max_memory = 0;  ///< bytes; 0: half of the machine's
};

struct SimulateArguments {
  std::string preset{};        ///< or a trajectory
  std::string errors = "all";  ///< the preset's error sources that are kept, separated by commas
  std::string without{};       ///< ... and those that are not
  std::filesystem::path out;
  /// @name Scans along a recorded trajectory.
  /// @{
  std::filesystem::path trajectory, times, imu;
  std::vector<std::filesystem::path> others{};  ///< trajectories in the same frame, whose world it is too
  bool gnss = false;                            ///< whether a receiver is simulated
  std::optional<double> rate{};                 ///< of the trajectory's rows, Hz
  std::string frame{};                          ///< whose poses they are: body, lidar or camera
  std::string body_lidar{}, camera_lidar{};     ///< files, or "kitti"
  double imu_offset = 0.0;                      ///< added to the IMU's times, seconds
  std::vector<std::string> skips{};             ///< "FROM:TO", or files
  std::string lidar = "HDL-64E";
  int columns = 1024;          ///< firings per revolution, about
  double lidar_height = 1.73;  ///< above the road, metres
  bool scans = true;           ///< whether they are written
  /// @}
  std::string size = "medium";
  std::optional<std::size_t> sessions;
  std::uint64_t seed = 1;
  bool overwrite = false;
  int threads = static_cast<int>(std::thread::hardware_concurrency());
};

struct InspectArguments {
  std::filesystem::path path, config;
  std::vector<std::string> overrides;
  bool closures = false;
  bool json = false;
  double imu_seconds = 60;  ///< of data in which IMU and scans are compared; 0: none
};

struct CheckArguments {
  std::filesystem::path map;
};

struct RecoverArguments {
  std::filesystem::path map, out;
  bool overwrite = false;
  bool replay = true;  ///< do the back end's work again where its inputs were kept
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
};

struct UndoArguments {
  std::filesystem::path map, out;
  std::vector<std::string> sessions{};  ///< numbers or names
  std::vector<int> closures{}, merges{};
  bool replay = false;  ///< decide again from the saved scans
  bool overwrite = false;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
};

struct MergeArguments {
  std::vector<std::filesystem::path> maps;
  std::filesystem::path out, config;
  std::vector<std::string> overrides{};
  bool overwrite = false;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
};

struct ReportArguments {
  std::filesystem::path map, out;
  bool overwrite = false;
};

struct ExportArguments {
  std::filesystem::path map, out;
  std::string format;
  ExportOptions options;
  std::vector<double> heights{};                  ///< of the grid, lowest and highest; or the defaults
  std::vector<double> camera{}, T_body_camera{};  ///< width height fx fy cx cy, and x y z qx qy qz qw; or the defaults
};

enum class Associate { automatic, time, index, interpolate };

struct EvalArguments {
  std::vector<std::filesystem::path> files;
  AlignmentOptions alignment;
  Associate associate = Associate::automatic;
  NcltPoses nclt_poses = NcltPoses::stated;
  std::optional<double> max_difference;  ///< seconds
  std::string delta = "1frame";
  PairChoice pairs = PairChoice::consecutive;
  int kitti_step = KittiOptions{}.step;
  std::filesystem::path json;
  bool overwrite = false;         ///< of `json`
  std::optional<double> max_ape;  ///< metres, of the rmse
  std::optional<double> max_rpe;  ///< metres, of the rmse
};

struct OptimizeArguments {
  std::filesystem::path input, out;
  bool overwrite = false;
  int max_iterations = 100;
};

struct ConfigArguments {
  std::filesystem::path file, check;
  std::vector<std::string> overrides;
  std::string explain;
  bool print = false;
};
/// @}

/// Each runs one verb. @returns what the program is to tell the shell (see exit_code.hpp), or throws.
/// @{
int run(const MapArguments& arguments, SessionWorkers* workers = nullptr);  ///< see `run_program`
int run(const OdometryArguments& arguments);
int run(const LocalizeArguments& arguments);
int run(const SimulateArguments& arguments);
int run(const InspectArguments& arguments);
int run(const CheckArguments& arguments);
int run(const RecoverArguments& arguments);
int run(const UndoArguments& arguments);
int run(const MergeArguments& arguments);
int run(const ReportArguments& arguments);
int run(const ExportArguments& arguments);
int run(const EvalArguments& arguments);
int run(const OptimizeArguments& arguments);
int run(const ConfigArguments& arguments);
/// @}

/// Reads "10m", "0.5m", "1frame", "5frames".
[[nodiscard]] std::optional<RpeOptions> parse_delta(const std::string& text);

/// What the simulator can make, as a list for people.
[[nodiscard]] std::string known_presets();

/// A preset with some of its error sources only, and without others; names separated by commas.
/// @throws support::ConfigError if a name is not known.
[[nodiscard]] simulator::Preset with_error_sources(const simulator::Preset& preset, const std::string& only,
                                                   const std::string& without);

}  // namespace chainslam::mapper
