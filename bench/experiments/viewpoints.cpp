// How views rendered from a map, at the estimated poses of keyframes that are not in it, agree with what was scanned
// there: see README.md in this folder.

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "datasets/dataset.hpp"
#include "session_arguments.hpp"
#include "viewpoints/panorama.hpp"

namespace chainslam::experiments {
namespace {

using nlohmann::json;

constexpr std::size_t every = 10;      ///< one keyframe in so many is held out ...
constexpr std::size_t first_held = 5;  ///< ... from this one of each session on
constexpr double voxel_size = 0.2;     ///< metres, of the map's scans

struct MappedKeyframe {
  std::size_t session = 0;
  int frame = 0;
  bool held_out = false;
  Timestamp time;
  SE3d T_map_body;
  PointCloud<float> cloud;  ///< of the body; thinned if it is in the map
};

void read_session(const MapSession& files, std::size_t session, std::vector<MappedKeyframe>& keyframes) {
  const auto dataset = datasets::open_dataset(files.recording, {.recorded_intensities = true});
  const Trajectory mapped = read_tum(files.trajectory);
  std::size_t number = 0;
  while (auto frame = dataset->next_frame()) {
    if (frame->cloud.empty()) continue;
    const bool held_out = number++ % every == first_held;
    const auto T = pose_at(mapped, frame->time, seconds(2.0));
    if (!T) continue;
    keyframes.push_back({.session = session,
                         .frame = files.frame,
                         .held_out = held_out,
                         .time = frame->time,
                         .T_map_body = *T,
                         .cloud = held_out ? std::move(frame->cloud) : voxel_downsample(frame->cloud, voxel_size)});
  }
}

/// The keyframes of all sessions. They have intensities if those of every session have.
std::vector<MappedKeyframe> read_keyframes(const SessionArguments& arguments) {
  std::vector<MappedKeyframe> keyframes;
  for (std::size_t i = 0; i < arguments.sessions.size(); ++i) read_session(arguments.sessions[i], i, keyframes);
  const auto has_intensities = [](const MappedKeyframe& keyframe) { return keyframe.cloud.has_intensities(); };
  if (!std::ranges::all_of(keyframes, has_intensities))
    for (MappedKeyframe& keyframe : keyframes) keyframe.cloud.intensities.clear();
  return keyframes;
}

/// What the map without its held-out keyframes shows at the pose that it has for one of them.
Panorama rendered_at(const MappedKeyframe& held, const std::vector<MappedKeyframe>& keyframes,
                     const PanoramaOptions& options) {
  const SE3d T_body_map = held.T_map_body.inverse();
  Layers layers(options);
  for (const MappedKeyframe& other : keyframes) {
    if (other.held_out || other.frame != held.frame) continue;
    const SE3d T = T_body_map * other.T_map_body;
    constexpr double reach = 150.0;  // metres: farther than any of its points that is within the view's range
    if (T.translation().norm() > options.most_range + reach) continue;
    Panorama one(options);
    draw(one, options, other.cloud, T, options.point_size);
    layers.add(one);
  }
  return layers.nearest_surfaces();
}

/// What was scanned at a keyframe, and what the map shows there.
struct View {
  const MappedKeyframe* keyframe;
  Panorama scan, rendered;
  std::optional<float> full;  ///< intensity of the value 1, if there are intensities
};

View view_of(const MappedKeyframe& held, const std::vector<MappedKeyframe>& keyframes, const PanoramaOptions& options) {
  View view{&held, Panorama(options), rendered_at(held, keyframes, options), {}};
  draw(view.scan, options, held.cloud, SE3d(), 0.0);
  view.full = full_intensity(view.scan.intensities, options);
  return view;
}

/// How the two differ.
struct PanoramaErrors {
  ViewErrors ranges;
  ViewErrors intensities;  ///< of no pixels if there are none
};

PanoramaErrors errors_of(const View& view) {
  PanoramaErrors errors{.ranges = compare(view.scan.ranges, view.rendered.ranges, 1.0F), .intensities = {}};
  if (view.full)
    errors.intensities =
        compare(scaled(view.scan.intensities, *view.full), scaled(view.rendered.intensities, *view.full), 0.0F);
  return errors;
}

/// Means over the views that have pixels to compare.
struct MeanErrors {
  double psnr = 0, loss = 0, uncovered = 0, views = 0;

  MeanErrors(const std::vector<PanoramaErrors>& all, ViewErrors PanoramaErrors::*of) {
    for (const PanoramaErrors& both : all) {
      const ViewErrors& errors = both.*of;
      if (errors.pixels == 0) continue;
      psnr += errors.psnr;
      loss += errors.loss;
      uncovered += errors.uncovered;
      ++views;
    }
    for (double* figure : {&psnr, &loss, &uncovered}) *figure /= views;
  }
};

/// Values as bytes, -1 for none.
json pixels_of(const Image& image) {
  json pixels = json::array();
  for (const float value : image.values)
    pixels.push_back(std::isnan(value) ? -1 : static_cast<int>(std::lround(255.0F * value)));
  return pixels;
}

/// For a picture: the scan's points as large as the map's.
json shown(const View& view, const PanoramaOptions& options) {
  Panorama scan(options);
  draw(scan, options, view.keyframe->cloud, SE3d(), options.point_size);
  json result{{"session", view.keyframe->session + 1},
              {"time_ns", view.keyframe->time.nanoseconds()},
              {"rows", scan.ranges.rows},
              {"columns", scan.ranges.columns},
              {"scan", pixels_of(scan.ranges)},
              {"rendered", pixels_of(view.rendered.ranges)}};
  if (view.full) {
    result["scan_intensities"] = pixels_of(scaled(scan.intensities, *view.full));
    result["rendered_intensities"] = pixels_of(scaled(view.rendered.intensities, *view.full));
  }
  return result;
}

/// The one in the middle of those of the last session: the same for every map of a recording.
const MappedKeyframe& shown_of(const std::vector<const MappedKeyframe*>& held) {
  const auto first = std::ranges::find(held, held.back()->session, &MappedKeyframe::session);
  return *first[(held.end() - first) / 2];
}

json run(const SessionArguments& arguments) {
  const ThreadPool threads(to_index(arguments.threads));
  const PanoramaOptions options;
  const std::vector<MappedKeyframe> keyframes = read_keyframes(arguments);
  std::vector<const MappedKeyframe*> held;
  for (const MappedKeyframe& keyframe : keyframes)
    if (keyframe.held_out) held.push_back(&keyframe);
  std::vector<PanoramaErrors> errors(held.size());
  threads.for_chunks(to_index(held.size()), 1, [&](Index begin, Index end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i)
      errors[i] = errors_of(view_of(*held[i], keyframes, options));
  });
  const MeanErrors ranges(errors, &PanoramaErrors::ranges), intensities(errors, &PanoramaErrors::intensities);
  json result{{"views", ranges.views}};
  if (ranges.views == 0) return result;
  result["psnr_db"] = ranges.psnr;
  result["loss"] = ranges.loss;
  result["uncovered"] = ranges.uncovered;
  if (intensities.views > 0) {
    result["intensity_psnr_db"] = intensities.psnr;
    result["intensity_loss"] = intensities.loss;
  }
  result["shown"] = shown(view_of(shown_of(held), keyframes, options), options);
  return result;
}

}  // namespace
}  // namespace chainslam::experiments

int main(int count, char** words) {
  using namespace chainslam::experiments;
  return run_on_sessions(count, words, "viewpoints",
                         "How views rendered from a map agree with scans that are not in it",
                         [](const SessionArguments& arguments) { return run(arguments).dump() + "\n"; });
}
