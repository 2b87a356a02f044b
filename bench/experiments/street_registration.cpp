// How clouds of single streets, put together by a map's poses, lie on those put together by the true ones: see
// README.md beside this file.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/transform.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/error.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/evaluation/alignment.hpp"
#include "chainslam/io/tum.hpp"
#include "chainslam/trajectory/interpolation.hpp"
#include "datasets/dataset.hpp"
#include "streets/cloud_errors.hpp"
#include "streets/streets.hpp"
#include "table_file.hpp"

namespace chainslam::experiments {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr double voxel_size = 0.3;  ///< metres, of both clouds
constexpr double reach = 25.0;      ///< metres around a street within which points count

struct Arguments {
  std::vector<std::vector<std::string>> sessions;  ///< recording, trajectory, number of the frame
  fs::path out;
  int threads = 1;
};

/// A session's keyframes with true and estimated poses.
struct MappedSession {
  int frame = 0;
  Trajectory truth, estimate;
  std::vector<PointCloud<float>> clouds;  ///< of the body, thinned
};

MappedSession read_session(const std::vector<std::string>& words) {
  const fs::path set = words[0];
  const auto dataset = datasets::open_dataset(set, {});
  const std::optional<Trajectory> truth = dataset->truth();
  if (!truth) throw_input_error(set.string(), "", "no truth", "give recordings of data with truth");
  const Trajectory mapped = read_tum(words[1]);
  MappedSession session;
  session.frame = std::stoi(words[2]);
  while (const auto frame = dataset->next_frame()) {
    if (frame->cloud.empty()) continue;
    const auto T_truth = pose_at(*truth, frame->time, seconds(2.0)), T_map = pose_at(mapped, frame->time, seconds(2.0));
    if (!T_truth || !T_map) continue;
    for (Trajectory* trajectory : {&session.truth, &session.estimate}) trajectory->times.push_back(frame->time);
    session.truth.poses.push_back(*T_truth);
    session.estimate.poses.push_back(*T_map);
    session.clouds.push_back(voxel_downsample(frame->cloud, voxel_size));
  }
  return session;
}

/// All scans from a street, by poses that one of the members has.
PointCloud<float> cloud_of(std::span<const MappedSession* const> sessions, const Street& street,
                           Trajectory MappedSession::*poses, double gate) {
  PointCloud<float> cloud;
  for (const MappedSession* session : sessions)
    for (std::size_t i = 0; i < session->clouds.size(); ++i) {
      const SE3d& T_truth = session->truth.poses[i];
      if (!is_on(street, T_truth.translation(), gate)) continue;
      // Which points count is decided by the truth, so that it does not depend on the map.
      PointCloud<float> near;
      for (const Eigen::Vector3f& point : session->clouds[i].positions)
        if (const OnStreet at = on_street(street, T_truth * point.cast<double>());
            at.beside <= reach && at.along >= -reach && at.along <= length_of(street) + reach)
          near.positions.push_back(point);
      const PointCloud<float> placed = transformed(near, (session->*poses).poses[i]);
      cloud.positions.insert(cloud.positions.end(), placed.positions.begin(), placed.positions.end());
    }
  return voxel_downsample(cloud, voxel_size);
}

/// Where the truth puts the frame of these sessions.
std::optional<SE3d> alignment_of(std::span<const MappedSession* const> sessions) {
  std::vector<MatchedTrajectories> matched;
  for (const MappedSession* session : sessions) matched.push_back({session->truth, session->estimate});
  const AlignedSessions aligned = align_sessions(matched);
  if (aligned.status != EvaluationStatus::evaluated) return std::nullopt;
  return SE3d(aligned.S_reference_estimate.rotation(), aligned.S_reference_estimate.translation());
}

json figures_of(const CloudErrors& errors) {
  const auto or_null = [](double value) { return std::isnan(value) ? json() : json(value); };
  return {{"aligned_m", or_null(errors.as_aligned)},
          {"ransac_m", or_null(errors.after_ransac)},
          {"icp_m", or_null(errors.after_icp)},
          {"thickness_m", or_null(errors.thickness)},
          {"points", errors.points}};
}

/// Sessions that lie in one frame make one cloud; those in others make others, each of which counts.
json run(const Arguments& arguments) {
  const ThreadPool threads(to_index(arguments.threads));
  std::vector<MappedSession> sessions;
  std::vector<Trajectory> truths;
  for (const auto& words : arguments.sessions) {
    sessions.push_back(read_session(words));
    truths.push_back(sessions.back().truth);
  }
  std::map<int, std::vector<const MappedSession*>> frames;
  std::vector<const MappedSession*> all;
  for (const MappedSession& session : sessions) {
    frames[session.frame].push_back(&session);
    all.push_back(&session);
  }
  const StreetOptions options;
  json result = json::array();
  for (const Street& street : chosen_streets(truths, options)) {
    const PointCloud<float> reference = cloud_of(all, street, &MappedSession::truth, options.gate);
    json clouds = json::array();
    for (const auto& [frame, of_frame] : frames) {
      const PointCloud<float> cloud = cloud_of(of_frame, street, &MappedSession::estimate, options.gate);
      if (cloud.empty()) continue;
      const SE3d T = alignment_of(of_frame).value_or(SE3d());
      clouds.push_back(figures_of(cloud_errors(cloud, reference, T, threads)));
    }
    result.push_back({{"begin", {street.begin.x(), street.begin.y()}},
                      {"end", {street.end.x(), street.end.y()}},
                      {"sessions", street.sessions},
                      {"true_thickness_m", thickness_of(reference, KdTree<float>(reference), 4)},
                      {"clouds", clouds}});
  }
  return {{"streets", result}};
}

}  // namespace
}  // namespace chainslam::experiments

int main(int count, char** words) {
  using namespace chainslam;
  experiments::Arguments arguments;
  CLI::App app("How clouds of single streets lie on those by true poses");
  app.add_option("--session", arguments.sessions,
                 "recording, its trajectory in the map, number of the frame it lies in")
      ->required()
      ->expected(3)
      ->option_text("SET FILE FRAME");
  app.add_option("--out", arguments.out, "JSON file to write")->required();
  app.add_option("--threads", arguments.threads, "changes the time, not the result")->check(CLI::Range(1, 1024));
  CLI11_PARSE(app, count, words);
  return bench::write_table("street_registration", arguments.out,
                            [&] { return experiments::run(arguments).dump(1) + "\n"; });
}
