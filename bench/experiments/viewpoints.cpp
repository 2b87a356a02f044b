// How views rendered from a map, at the estimated poses of keyframes that are not in it, agree with what was scanned
// there: see README.md in this folder.

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/error.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/io/tum.hpp"
#include "chainslam/trajectory/interpolation.hpp"
#include "datasets/dataset.hpp"
#include "table_file.hpp"
#include "viewpoints/panorama.hpp"

namespace chainslam::experiments {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::size_t every = 10;      ///< one keyframe in so many is held out ...
constexpr std::size_t first_held = 5;  ///< ... from this one of each session on
constexpr double voxel_size = 0.2;     ///< metres, of the map's scans

struct Arguments {
  std::vector<std::vector<std::string>> sessions;  ///< recording, trajectory, number of the frame
  fs::path out;
  int threads = 1;
};

struct MappedKeyframe {
  std::size_t session = 0;
  int frame = 0;
  bool held_out = false;
  Timestamp time;
  SE3d T_map_body;
  PointCloud<float> cloud;  ///< of the body; thinned if it is in the map
};

void read_session(const std::vector<std::string>& words, std::size_t session, std::vector<MappedKeyframe>& keyframes) {
  const auto dataset = datasets::open_dataset(words[0], {});
  const Trajectory mapped = read_tum(words[1]);
  std::size_t number = 0;
  while (auto frame = dataset->next_frame()) {
    if (frame->cloud.empty()) continue;
    const bool held_out = number++ % every == first_held;
    const auto T = pose_at(mapped, frame->time, seconds(2.0));
    if (!T) continue;
    keyframes.push_back({.session = session,
                         .frame = std::stoi(words[2]),
                         .held_out = held_out,
                         .time = frame->time,
                         .T_map_body = *T,
                         .cloud = held_out ? std::move(frame->cloud) : voxel_downsample(frame->cloud, voxel_size)});
  }
}

/// A view that was compared.
struct View {
  const MappedKeyframe* keyframe;
  Panorama scan, rendered;
  ViewErrors errors;
};

View view_of(const MappedKeyframe& held, const std::vector<MappedKeyframe>& keyframes, const PanoramaOptions& options) {
  View view{&held, Panorama(options), Panorama(options), {}};
  draw(view.scan, options, held.cloud, SE3d(), 0.0);
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
  view.rendered = layers.nearest_surfaces();
  view.errors = compare(view.scan, view.rendered);
  return view;
}

/// Values as bytes, -1 for none.
json pixels_of(const Panorama& image) {
  json pixels = json::array();
  for (const float value : image.values)
    pixels.push_back(std::isnan(value) ? -1 : static_cast<int>(std::lround(255.0F * value)));
  return pixels;
}

/// For a picture: the scan's points as large as the map's.
json shown(const View& view, const PanoramaOptions& options) {
  Panorama scan(options);
  draw(scan, options, view.keyframe->cloud, SE3d(), options.point_size);
  return {{"session", view.keyframe->session + 1},
          {"time_ns", view.keyframe->time.nanoseconds()},
          {"rows", view.scan.rows},
          {"columns", view.scan.columns},
          {"scan", pixels_of(scan)},
          {"rendered", pixels_of(view.rendered)}};
}

json run(const Arguments& arguments) {
  const ThreadPool threads(to_index(arguments.threads));
  const PanoramaOptions options;
  std::vector<MappedKeyframe> keyframes;
  for (std::size_t i = 0; i < arguments.sessions.size(); ++i) read_session(arguments.sessions[i], i, keyframes);
  std::vector<const MappedKeyframe*> held;
  for (const MappedKeyframe& keyframe : keyframes)
    if (keyframe.held_out) held.push_back(&keyframe);
  std::vector<std::optional<View>> views(held.size());
  threads.for_chunks(to_index(held.size()), 1, [&](Index begin, Index end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i)
      views[i] = view_of(*held[i], keyframes, options);
  });
  double psnr = 0, loss = 0, uncovered = 0, count = 0;
  for (const auto& view : views) {
    if (view->errors.pixels == 0) continue;
    psnr += view->errors.psnr;
    loss += view->errors.loss;
    uncovered += view->errors.uncovered;
    ++count;
  }
  json result{{"views", count}};
  if (count == 0) return result;
  result["psnr_db"] = psnr / count;
  result["loss"] = loss / count;
  result["uncovered"] = uncovered / count;
  // The one in the middle of those of the last session: the same for every map of a recording.
  std::vector<std::size_t> last;
  for (std::size_t i = 0; i < views.size(); ++i)
    if (views[i]->keyframe->session == views.back()->keyframe->session) last.push_back(i);
  result["shown"] = shown(*views[last[last.size() / 2]], options);
  return result;
}

}  // namespace
}  // namespace chainslam::experiments

int main(int count, char** words) {
  using namespace chainslam;
  experiments::Arguments arguments;
  CLI::App app("How views rendered from a map agree with scans that are not in it");
  app.add_option("--session", arguments.sessions,
                 "recording, its trajectory in the map, number of the frame it lies in")
      ->required()
      ->expected(3)
      ->option_text("SET FILE FRAME");
  app.add_option("--out", arguments.out, "JSON file to write")->required();
  app.add_option("--threads", arguments.threads, "changes the time, not the result")->check(CLI::Range(1, 1024));
  CLI11_PARSE(app, count, words);
  return bench::write_table("viewpoints", arguments.out, [&] { return experiments::run(arguments).dump() + "\n"; });
}
