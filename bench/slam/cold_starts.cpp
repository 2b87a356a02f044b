// How often a drive is found in a map from a cold start, rightly, wrongly or not at all, and how well it is followed
// then, as a Markdown table: see bench/README.md.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/slam/localizer.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "datasets/dataset.hpp"

namespace chainslam::bench {
namespace {

struct Options {
  std::string map, data;
  std::vector<std::string> truths;
  std::uint64_t seed = 1;
  int starts = 200;
  double seconds = 10, near = 10, voxel = 0.4, right_translation = 1, right_rotation_deg = 5;
  bool elsewhere = false, true_map = false, verbose = false;
  LoopCloserOptions closures{};
  LocalizerOptions localizer{};
  PlaceCandidateOptions places = localizer_places();
};

/// The keyframes' true poses, in the frame that the drive's truth has, too.
class Judge {
 public:
  Judge(const SlamMap& map, const std::vector<std::string>& truths) : map_(map) {
    std::vector<Trajectory> read;
    for (const std::string& file : truths) read.push_back(read_tum(file));
    if (read.size() != map.sessions.size()) throw std::invalid_argument("one truth for each session of the map");
    for (const Keyframe& one : map.keyframes)
      truth_.push_back(pose_at(read[static_cast<std::size_t>(one.session.value)], one.time, seconds(1)).value());
  }
  /// Metres from the nearest keyframe of the map.
  [[nodiscard]] double away(const SE3d& truth) const {
    return (truth_[nearest(truth)].translation() - truth.translation()).norm();
  }
  /// Of a pose in the map by what is true of it and of the keyframes around: of their answers the one that is off by
  /// the median, so that neither the map's errors elsewhere count, nor those of single keyframes. Tangent of the
  /// estimate.
  [[nodiscard]] Vector6d error(const SE3d& T_map_body, const SE3d& truth) const {
    constexpr double around = 15;  // metres
    const SE3d T_truth_here = truth.inverse();
    std::vector<Vector6d> errors;
    const auto add = [&](std::size_t k) {
      errors.push_back((map_.keyframes[k].T_map_body * (T_truth_here * truth_[k]).inverse()).local(T_map_body));
    };
    for (std::size_t k = 0; k < truth_.size(); ++k)
      if ((truth_[k].translation() - truth.translation()).norm() <= around) add(k);
    if (errors.empty()) add(nearest(truth));
    const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
    std::ranges::nth_element(errors, middle, {}, [](const Vector6d& error) { return error.head<3>().norm(); });
    return *middle;
  }
  [[nodiscard]] const std::vector<SE3d>& truth() const { return truth_; }
  [[nodiscard]] std::size_t nearest(const SE3d& truth) const {
    std::size_t best = 0;
    for (std::size_t i = 0; i < truth_.size(); ++i)
      if ((truth_[i].translation() - truth.translation()).squaredNorm() <
          (truth_[best].translation() - truth.translation()).squaredNorm())
        best = i;
    return best;
  }

 private:
  const SlamMap& map_;
  std::vector<SE3d> truth_;
};

struct Drive {
  std::vector<Frame> frames;
  std::vector<SE3d> truth;  ///< of each frame
};

Drive read_drive(const Options& options) {
  const auto data = datasets::open_dataset(options.data);
  const std::optional<Trajectory> truth = data->truth();
  if (!data->info().has_odometry || !truth)
    throw std::invalid_argument(options.data + ": no recorded odometry or truth");
  Drive drive;
  while (std::optional<Frame> frame = data->next_frame()) {
    const std::optional<SE3d> pose = pose_at(*truth, frame->time, seconds(1));
    if (!pose) continue;
    if (!frame->cloud.empty()) frame->cloud = voxel_downsample(frame->cloud, options.voxel);
    drive.frames.push_back(std::move(*frame));
    drive.truth.push_back(*pose);
  }
  return drive;
}

double elapsed(std::chrono::steady_clock::time_point since) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - since).count();
}

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::ranges::sort(values);
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

double rms(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value * value;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

/// Scans from which on the drive stays where the map has keyframes near, for as long as a start may take.
std::vector<std::size_t> eligible_starts(const Drive& drive, const Judge* judge, const Options& options) {
  std::vector<std::size_t> starts;
  Timestamp known_until = drive.frames.back().time;
  for (std::size_t i = drive.frames.size(); i-- > 0;) {
    if (judge != nullptr && judge->away(drive.truth[i]) > options.near) known_until = drive.frames[i].time;
    if (!drive.frames[i].cloud.empty() && to_seconds(known_until - drive.frames[i].time) >= options.seconds)
      starts.push_back(i);
  }
  if (starts.empty()) throw std::invalid_argument("no scan of the drive lies near a keyframe of the map");
  return starts;
}

void measure_starts(Localizer<>& localizer, const Drive& drive, const Judge* judge, const Options& options,
                    const std::vector<std::size_t>& eligible) {
  Rng rng(options.seed);
  int right = 0, wrong = 0, scans = 0;
  double worst = 0, cost = 0;
  std::vector<double> times, errors;
  for (int k = 0; k < options.starts; ++k) {
    const std::size_t start = eligible[static_cast<std::size_t>(rng.uniform(0, static_cast<double>(eligible.size())))];
    localizer.restart();
    const auto begin = std::chrono::steady_clock::now();
    std::optional<Localization> found;
    std::size_t i = start;
    for (; i < drive.frames.size() && !found; ++i) {
      if (to_seconds(drive.frames[i].time - drive.frames[start].time) > options.seconds) break;
      scans += drive.frames[i].cloud.empty() ? 0 : 1;
      const Localization now = localizer.process(drive.frames[i]);
      if (now.T_map_body) found = now;
    }
    cost += elapsed(begin);
    const double time = to_seconds(drive.frames[i - 1].time - drive.frames[start].time);
    if (!found) {
      if (options.verbose) {
        std::fprintf(stderr, "start %zu: not found, %.1f m travelled;", start,
                     (drive.truth[i - 1].translation() - drive.truth[start].translation()).norm());
        for (const detail::StartHypothesis& one : localizer.hypotheses())
          std::fprintf(stderr, " [%d recognized, %d agree over %.1f m, %d refuse]", one.recognitions, one.agreeing,
                       one.last - one.first, one.refusing);
        std::fprintf(stderr, "\n");
      }
      continue;
    }
    const Vector6d error =
        judge == nullptr ? Vector6d(Vector6d::Constant(1e9)) : judge->error(*found->T_map_body, drive.truth[i - 1]);
    const double translation = error.head<3>().norm(), rotation_deg = error.tail<3>().norm() * 180 / 3.14159265358979;
    const bool is_right = translation <= options.right_translation && rotation_deg <= options.right_rotation_deg;
    (is_right ? right : wrong) += 1;
    worst = std::max(worst, translation);
    times.push_back(time);
    errors.push_back(translation);
    if (options.verbose || !is_right)
      std::fprintf(stderr, "start %zu: %s after %.1f s, %.2f m and %.2f deg off\n", start, is_right ? "right" : "WRONG",
                   time, translation, rotation_deg);
  }
  std::printf(
      "| starts | right | wrong | not found | time to the fix, median / 95 %% | error, median / largest | scans | CPU "
      "|\n"
      "|---|---|---|---|---|---|---|---|\n"
      "| %d | %d (%.1f %%) | %d | %d | %.1f / %.1f s | %.3f / %.3f m | %.1f | %.2f s |\n\n",
      options.starts, right, 100.0 * right / options.starts, wrong, options.starts - right - wrong,
      quantile(times, 0.5), quantile(times, 0.95), quantile(errors, 0.5), worst,
      static_cast<double>(scans) / options.starts, cost / options.starts);
}

void measure_tracking(Localizer<>& localizer, const Drive& drive, const Judge& judge, const Options& options) {
  localizer.restart();
  const LocalizerCounts before = localizer.counts();
  std::vector<double> local, along, across, rotation, nees;
  int known = 0, without = 0, after = 0, tracked = 0;
  double cost = 0;
  bool found = false;
  LocalizationStatus before_status = LocalizationStatus::searching;
  for (std::size_t i = 0; i < drive.frames.size(); ++i) {
    const auto begin = std::chrono::steady_clock::now();
    const Localization now = localizer.process(drive.frames[i]);
    cost += elapsed(begin);
    found |= now.T_map_body.has_value();
    if (options.verbose && now.status != before_status)
      std::fprintf(stderr, "frame %zu: status %d, %.1f m from the map\n", i, static_cast<int>(now.status),
                   judge.away(drive.truth[i]));
    before_status = now.status;
    if (!found) continue;
    ++after;
    tracked += now.status == LocalizationStatus::tracking ? 1 : 0;
    if (judge.away(drive.truth[i]) > options.near) continue;
    ++known;
    without += now.T_map_body ? 0 : 1;
    if (now.status != LocalizationStatus::tracking) continue;
    const Vector6d error = judge.error(*now.T_map_body, drive.truth[i]);
    local.push_back(error.head<3>().norm());
    along.push_back(error[0]);
    across.push_back(error.segment<2>(1).norm());
    rotation.push_back(error.tail<3>().norm() * 180 / 3.14159265358979);
    nees.push_back(std::sqrt(error.dot(now.covariance.inverse() * error) / 6));
    if (options.verbose && !drive.frames[i].cloud.empty())
      std::fprintf(stderr, "frame %zu: %.3f m %.2f deg, reference %d, sigma %.3f\n", i, local.back(), rotation.back(),
                   now.reference.value, std::sqrt(now.covariance(0, 0)));
  }
  const LocalizerCounts& counts = localizer.counts();
  const double data = to_seconds(drive.frames.back().time - drive.frames.front().time);
  std::printf(
      "| frames after the fix | tracked | where the map is: without a pose | rmse | along the path / across it | "
      "largest | rotation | normalized error (rms, 1) | registrations, refused | starts, losses | times "
      "real time |\n"
      "|---|---|---|---|---|---|---|---|---|---|---|\n"
      "| %d | %.2f %% | %.2f %% of %d | %.3f m | %.3f / %.3f m | %.3f m | %.2f deg | %.2f | %d, %d | %d, %d | %.1f |\n",
      after, 100.0 * tracked / after, 100.0 * without / std::max(known, 1), known, rms(local), rms(along), rms(across),
      quantile(local, 1), rms(rotation), rms(nees), counts.registrations - before.registrations,
      counts.refusals - before.refusals, counts.starts - before.starts, counts.losses - before.losses, data / cost);
}

void run(const Options& options) {
  SlamMap map = load_map(options.map).map;
  const Drive drive = read_drive(options);
  std::optional<Judge> judge;
  if (!options.elsewhere) judge.emplace(map, options.truths);
  if (options.true_map && judge)
    for (Keyframe& one : map.keyframes) one.T_map_body = judge->truth()[static_cast<std::size_t>(one.id.value)];
  const auto begin = std::chrono::steady_clock::now();
  Localizer<> localizer(map, options.localizer, LoopCloser<>(options.closures), PlaceCandidates(options.places));
  std::fprintf(stderr, "%zu keyframes in the map, taken in in %.1f s\n", map.keyframes.size(), elapsed(begin));
  const std::vector<std::size_t> eligible = eligible_starts(drive, judge ? &*judge : nullptr, options);
  std::fprintf(stderr, "%zu scans to start from\n", eligible.size());
  if (options.starts > 0) measure_starts(localizer, drive, judge ? &*judge : nullptr, options, eligible);
  if (judge) measure_tracking(localizer, drive, *judge, options);
}

}  // namespace
}  // namespace chainslam::bench

int main(int argc, char** argv) {
  chainslam::bench::Options options;
  CLI::App app("a drive localized in a map from cold starts, and followed");
  app.add_option("MAP", options.map, "map file")->required();
  app.add_option("DATA", options.data, "recorded odometry of the drive, with its truth")->required();
  app.add_option("--truths", options.truths, "TUM files, one for each session of the map, in the frame of the drive's");
  app.add_flag("--true-map", options.true_map, "keyframes of the map at their true poses: its own errors are none");
  app.add_flag("--elsewhere", options.elsewhere, "the drive is not in the map: whatever is found is wrong");
  app.add_option("--starts", options.starts, "from scans drawn at random")->capture_default_str();
  app.add_option("--seed", options.seed, "of the draw")->capture_default_str();
  app.add_option("--seconds", options.seconds, "of data that a start may take")->capture_default_str();
  app.add_option("--near", options.near, "metres from a keyframe of the map: places that it knows")
      ->capture_default_str();
  app.add_option("--evidence", options.localizer.start.min_evidence, "see StartOptions")->capture_default_str();
  app.add_option("--recognitions", options.localizer.start.min_recognitions, "see StartOptions")->capture_default_str();
  app.add_option("--scans", options.localizer.start.min_scans, "see StartOptions")->capture_default_str();
  app.add_option("--travel", options.localizer.start.min_travel, "see StartOptions")->capture_default_str();
  app.add_option("--shift", options.localizer.start.shift, "see StartOptions")->capture_default_str();
  app.add_option("--distance", options.localizer.scans.distance, "metres between scans")->capture_default_str();
  app.add_option("--period", options.localizer.min_period, "seconds between scans")->capture_default_str();
  app.add_option("--submap-length", options.closures.submap.max_length, "metres")->capture_default_str();
  app.add_option("--place-length", options.places.submap_length, "metres")->capture_default_str();
  app.add_option("--place-spacing", options.places.spacing, "metres")->capture_default_str();
  app.add_option("--place-inliers", options.places.index.min_inliers, "")->capture_default_str();
  app.add_flag("--verbose", options.verbose, "each start and scan");
  CLI11_PARSE(app, argc, argv);
  try {
    chainslam::bench::run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
  }
  return 0;
}
