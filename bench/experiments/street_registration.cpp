// How clouds of single streets, put together by a map's poses, lie on those put together by the true ones: see
// README.md beside this file.

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/error.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/trajectory/alignment.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "datasets/dataset.hpp"
#include "session_arguments.hpp"
#include "streets/cloud_errors.hpp"
#include "streets/streets.hpp"

namespace chainslam::experiments {
namespace {

using nlohmann::json;

constexpr double voxel_size = 0.3;  ///< metres, of both clouds
constexpr double reach = 25.0;      ///< metres around a street within which points count

/// A session's keyframes with true and estimated poses.
struct MappedSession {
  int frame = 0;
  Trajectory truth, estimate;
  std::vector<PointCloud<float>> clouds;  ///< of the body, thinned
};

MappedSession read_session(const MapSession& files) {
  const auto dataset = datasets::open_dataset(files.recording);
  const std::optional<Trajectory> truth = dataset->truth();
  if (!truth) throw_input_error(files.recording.string(), "", "no truth", "give recordings of data with truth");
  const Trajectory mapped = read_tum(files.trajectory);
  MappedSession session;
  session.frame = files.frame;
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
json run(const SessionArguments& arguments) {
  const ThreadPool threads(to_index(arguments.threads));
  std::vector<MappedSession> sessions;
  std::vector<Trajectory> truths;
  for (const MapSession& files : arguments.sessions) {
    sessions.push_back(read_session(files));
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
  using namespace chainslam::experiments;
  return run_on_sessions(count, words, "street_registration", "How clouds of single streets lie on those by true poses",
                         [](const SessionArguments& arguments) { return run(arguments).dump(1) + "\n"; });
}
