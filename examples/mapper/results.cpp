#include "results.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <numbers>
#include <span>
#include <utility>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/g2o.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/association.hpp"
#include "chainslam/trajectory/kitti_errors.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "frame_table.hpp"
#include "placed_points.hpp"
#include "run_summary.hpp"
#include "support/report_data.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

const Duration truth_gap = seconds(2.0);  // over which the truth is interpolated

std::optional<TrajectoryErrors> errors_against(const Trajectory& truth, const Trajectory& estimate) {
  const InterpolatedMatch match = match_interpolated(truth, estimate, truth_gap);
  if (match.trajectories.estimate.size() < 3) return std::nullopt;
  const auto& [reference, estimated] = match.trajectories;
  TrajectoryErrors errors{ape(reference, estimated), kitti_errors(reference, estimated), match.estimate.total()};
  if (errors.ape.status != EvaluationStatus::evaluated) return std::nullopt;
  return errors;
}

/// Collects errors that were taken under several alignments.
class ErrorPool {
 public:
  void add(const AbsolutePoseErrors& errors, Index sessions) {
    translation_.insert(translation_.end(), errors.translation_errors.begin(), errors.translation_errors.end());
    rotation_.insert(rotation_.end(), errors.rotation_errors.begin(), errors.rotation_errors.end());
    sessions_ += sessions;
    ++alignments_;
  }

  void add(const KittiErrors& errors) {
    segments_.insert(segments_.end(), errors.segments.begin(), errors.segments.end());
  }

  [[nodiscard]] std::optional<JointErrors> joint() const {
    const auto translation = error_statistics(translation_), rotation = error_statistics(rotation_);
    if (!translation || !rotation) return std::nullopt;
    return JointErrors{*translation, *rotation, kitti_errors(segments_), sessions_, alignments_};
  }

 private:
  std::vector<double> translation_, rotation_;
  std::vector<KittiSegment> segments_;
  Index sessions_ = 0, alignments_ = 0;
};

const Session& session_of(const MappingResult& mapping, std::size_t run) {
  return mapping.map->sessions[static_cast<std::size_t>(mapping.sessions[run].id.value)];
}

std::span<const Keyframe> keyframes_of(const SlamMap& map, const Session& session) {
  return std::span(map.keyframes)
      .subspan(static_cast<std::size_t>(session.first_keyframe), static_cast<std::size_t>(session.keyframes));
}

/// Positions of the sessions with a truth, by the frame in which they can be compared.
std::map<SessionId, std::vector<std::size_t>> sessions_by_frame(const MappingResult& mapping) {
  std::map<SessionId, std::vector<std::size_t>> groups;
  for (std::size_t i = 0; i < mapping.sessions.size(); ++i) {
    if (!mapping.sessions[i].truth) continue;
    const Session& session = session_of(mapping, i);
    groups[mapping.truths_share_frame ? session.frame : session.id].push_back(i);
  }
  return groups;
}

/// The joint errors of sessions in one frame, and where that puts their truths.
void take_joint_errors(const std::vector<std::size_t>& group, RunOutcome& outcome, ErrorPool& pool) {
  std::vector<MatchedTrajectories> matched;
  for (const std::size_t i : group)
    matched.push_back(
        match_interpolated(*outcome.mapping.sessions[i].truth, outcome.sessions[i].trajectory, truth_gap).trajectories);
  const AlignedSessions aligned = align_sessions(matched);
  if (aligned.status != EvaluationStatus::evaluated) return;
  pool.add(ape(aligned), to_index(aligned.sessions.size()));
  const Sim3d& S = aligned.S_reference_estimate;
  for (const std::size_t i : group) outcome.sessions[i].T_map_truth = SE3d(S.rotation(), S.translation()).inverse();
}

/// Keyframes at the times that the truth states, the truth as reference.
MatchedTrajectories matched_keyframes(const RunOutcome& outcome, std::size_t run) {
  MatchedTrajectories matched;
  for (const Keyframe& keyframe : keyframes_of(*outcome.mapping.map, session_of(outcome.mapping, run)))
    if (const auto pose = pose_at(*outcome.mapping.sessions[run].truth, keyframe.time, truth_gap)) {
      matched.reference.poses.push_back(*pose);
      matched.estimate.poses.push_back(keyframe.T_map_body);
    }
  return matched;
}

void pool_inter_session_errors(const std::vector<std::size_t>& group, const RunOutcome& outcome,
                               RelativePoseErrors& pooled) {
  std::vector<MatchedTrajectories> matched;
  for (const std::size_t i : group) matched.push_back(matched_keyframes(outcome, i));
  const RelativePoseErrors errors = inter_session_errors(matched);
  const auto append = [](const std::vector<double>& more, std::vector<double>& all) {
    all.insert(all.end(), more.begin(), more.end());
  };
  append(errors.translation_errors, pooled.translation_errors);
  append(errors.rotation_errors, pooled.rotation_errors);
}

void take_errors(RunOutcome& outcome) {
  ErrorPool odometry, optimized;
  for (std::size_t i = 0; i < outcome.sessions.size(); ++i) {
    SessionRun& run = outcome.mapping.sessions[i];
    SessionOutcome& session = outcome.sessions[i];
    if (!run.truth) continue;
    session.odometry_errors = errors_against(*run.truth, run.odometry);
    session.optimized_errors = errors_against(*run.truth, session.trajectory);
    if (session.odometry_errors) odometry.add(session.odometry_errors->ape, 1);
    if (session.odometry_errors) odometry.add(session.odometry_errors->kitti);
    if (session.optimized_errors) optimized.add(session.optimized_errors->kitti);
    if (!session.optimized_errors)
      run.notes.emplace_back("the truth shares fewer than three poses with the run: no errors are taken of it alone");
  }
  RelativePoseErrors between;
  for (const auto& [frame, group] : sessions_by_frame(outcome.mapping)) {
    take_joint_errors(group, outcome, optimized);
    if (outcome.mapping.truths_share_frame) pool_inter_session_errors(group, outcome, between);
  }
  outcome.odometry_errors = odometry.joint();
  if (outcome.odometry_errors) outcome.optimized_errors = optimized.joint();
  if (between.translation_errors.empty()) return;
  between.status = EvaluationStatus::evaluated;
  between.translation = error_statistics(between.translation_errors).value_or(ErrorStatistics{});
  between.rotation = error_statistics(between.rotation_errors).value_or(ErrorStatistics{});
  outcome.inter_session_errors = std::move(between);
}

/// All scans of the sessions that lie in one frame: the first point of each voxel. They are counted first, and then
/// written one by one: those of fifty thousand keyframes take more memory than mapping does.
void write_map(const FileTarget& target, const SlamMap& map, SessionId frame, double voxel_size) {
  std::vector<SessionId> sessions;
  for (const Session& session : map.sessions)
    if (session.frame == frame) sessions.push_back(session.id);
  const auto for_each = [&](const auto& take) {
    for_each_placed_point(
        map, sessions, voxel_size,
        [&](const Keyframe&, const PointCloud<float>&, std::size_t, const Eigen::Vector3f& p) { take(p); });
  };
  std::size_t count = 0;
  for_each([&](const Eigen::Vector3f&) { ++count; });
  write_ply(target, count, for_each);
}

void write_graph(const FileTarget& target, const SlamMap& map) {
  G2oFile graph;
  const auto add_edge = [&](const auto& edge) {
    if (edge.sqrt_information.isZero(0)) return;  // no factor
    graph.spatial.edges.push_back({.from = edge.from.value,
                                   .to = edge.to.value,
                                   .measurement = edge.T_from_to,
                                   .information = edge.sqrt_information.transpose() * edge.sqrt_information});
  };
  for (const Keyframe& keyframe : map.keyframes)
    graph.spatial.vertices.push_back({keyframe.id.value, keyframe.T_map_body});
  for (const Session& session : map.sessions)
    if (session.keyframes > 0 && session.frame == session.id) graph.fixed.push_back(session.first_keyframe);
  for (const OdometryMeasurement& step : map.odometry) add_edge(step);
  for (const LoopClosure& closure : map.closures)
    if (closure.is_factor()) add_edge(closure);
  write_g2o(target, graph);
}

std::string pose_fields(const SE3d& T) {
  const auto q = T.rotation().quaternion();
  char text[256];
  std::snprintf(text, sizeof text, "%.9g,%.9g,%.9g,%.12g,%.12g,%.12g,%.12g", T.translation().x(), T.translation().y(),
                T.translation().z(), q.x(), q.y(), q.z(), q.w());
  return text;
}

void write_keyframes(const FileTarget& target, const SlamMap& map) {
  AtomicFile file(target);
  file.write(
      std::string_view("id,session,time_ns,x,y,z,qx,qy,qz,qw,odom_x,odom_y,odom_z,odom_qx,odom_qy,odom_qz,"
                       "odom_qw,points,ecef_x,ecef_y,ecef_z,frame\n"));
  for (const Keyframe& keyframe : map.keyframes) {
    detail::require_finite(target, "keyframe", keyframe.id.value, keyframe.T_map_body);
    detail::require_finite(target, "keyframe", keyframe.id.value, keyframe.T_odom_body);
    std::string line = std::to_string(keyframe.id.value) + ',' + std::to_string(keyframe.session.value) + ',' +
                       std::to_string(keyframe.time.nanoseconds()) + ',' + pose_fields(keyframe.T_map_body) + ',' +
                       pose_fields(keyframe.T_odom_body) + ',' + std::to_string(keyframe.cloud.size());
    char text[128] = ",,,";
    if (keyframe.gnss) {
      const Eigen::Vector3d& p = keyframe.gnss->position_ecef;
      std::snprintf(text, sizeof text, ",%.4f,%.4f,%.4f", p.x(), p.y(), p.z());
    }
    const SessionId frame = map.sessions[static_cast<std::size_t>(keyframe.session.value)].frame;
    file.write(line + text + ',' + std::to_string(frame.value) + '\n');
  }
  file.commit();
}

void write_closures(const FileTarget& target, const SlamMap& map) {
  AtomicFile file(target);
  file.write(
      std::string_view("from,to,kind,verdict,mean_squared_error_m2,inlier_ratio,x,y,z,qx,qy,qz,qw,"
                       "from_session,to_session,cause\n"));
  const auto session = [&](KeyframeId id) {
    return std::to_string(map.keyframes[static_cast<std::size_t>(id.value)].session.value);
  };
  for (const auto* closures : {&map.closures, &map.refusals}) {
    for (const LoopClosure& closure : *closures) {
      detail::require_finite(target, "closure to keyframe", closure.to.value, closure.T_from_to);
      char text[160];
      std::snprintf(text, sizeof text, "%d,%d,%s,%s,%.6g,%.4f,", closure.from.value, closure.to.value,
                    support::name_of(closure.kind).c_str(), support::name_of(closure.verdict).c_str(),
                    closure.mean_squared_error, closure.inlier_ratio);
      file.write(text + pose_fields(closure.T_from_to) + ',' + session(closure.from) + ',' + session(closure.to) + ',' +
                 std::to_string(closure.cause) + '\n');
    }
  }
  file.commit();
}

/// What tells the files of a run's sessions apart: nothing if there is one, else ".NAME", with what a file's name
/// should not hold replaced, and a number where two are alike.
std::vector<std::string> file_tags(const std::vector<SessionRun>& sessions) {
  if (sessions.size() < 2) return std::vector<std::string>(sessions.size());
  std::vector<std::string> tags;
  for (const SessionRun& session : sessions) {
    std::string name = session.name.empty() ? "session" : session.name;
    for (char& c : name)
      if (!(c >= '0' && c <= '9') && !(c >= 'A' && c <= 'Z') && !(c >= 'a' && c <= 'z') && c != '-' && c != '_')
        c = '_';
    std::string tag = "." + name;
    for (int i = 2; std::ranges::find(tags, tag) != tags.end(); ++i) tag = "." + name + "-" + std::to_string(i);
    tags.push_back(tag);
  }
  return tags;
}

/// The trajectories of all sessions one after the other, if they lie in one frame and no two overlap in time.
std::optional<Trajectory> joint_trajectory(const RunOutcome& outcome) {
  std::vector<std::size_t> order;
  for (std::size_t i = 0; i < outcome.sessions.size(); ++i)
    if (!outcome.sessions[i].trajectory.empty()) order.push_back(i);
  std::ranges::sort(order, {}, [&](std::size_t i) { return outcome.sessions[i].trajectory.times.front(); });
  Trajectory joint;
  for (const std::size_t i : order) {
    const Trajectory& next = outcome.sessions[i].trajectory;
    if (session_of(outcome.mapping, i).frame != session_of(outcome.mapping, order.front()).frame) return std::nullopt;
    if (!joint.empty() && next.times.front() <= joint.times.back()) return std::nullopt;
    joint.times.insert(joint.times.end(), next.times.begin(), next.times.end());
    joint.poses.insert(joint.poses.end(), next.poses.begin(), next.poses.end());
  }
  return joint;
}

}  // namespace

RunOutcome conclude(MappingResult mapping, const std::string& dataset, const MapperOptions& options) {
  RunOutcome outcome;
  outcome.mapping = std::move(mapping);
  for (std::size_t i = 0; i < outcome.mapping.sessions.size(); ++i) {
    const auto keyframes = keyframes_of(*outcome.mapping.map, session_of(outcome.mapping, i));
    outcome.sessions.emplace_back().trajectory = corrected_trajectory(outcome.mapping.sessions[i].odometry, keyframes);
  }
  take_errors(outcome);
  summarize(outcome, dataset, options.goals);
  return outcome;
}

void write_results(OutputFolder& folder, const RunOutcome& outcome, const MapperOptions& options) {
  const SlamMap& map = *outcome.mapping.map;
  const std::vector<std::string> tags = file_tags(outcome.mapping.sessions);
  const auto write_trajectory = [&](const std::string& name, const Trajectory& trajectory) {
    folder.file(name, [&](const FileTarget& target) { write_tum(target, trajectory); });
  };
  for (std::size_t i = 0; i < tags.size(); ++i) {
    const Trajectory& trajectory = outcome.sessions[i].trajectory;
    write_trajectory("trajectory" + tags[i] + ".tum", trajectory);
    folder.file("trajectory" + tags[i] + ".kitti.txt",
                [&](const FileTarget& target) { write_kitti_poses(target, trajectory); });
    write_trajectory("odometry" + tags[i] + ".tum", outcome.mapping.sessions[i].odometry);
  }
  if (tags.size() > 1)
    if (const auto joint = joint_trajectory(outcome)) write_trajectory("trajectory.tum", *joint);
  folder.file("keyframes.csv", [&](const FileTarget& target) { write_keyframes(target, map); });
  folder.file("frames.csv", [&](const FileTarget& target) { write_frames(target, map); });
  folder.file("closures.csv", [&](const FileTarget& target) { write_closures(target, map); });
  folder.file("graph.g2o", [&](const FileTarget& target) { write_graph(target, map); });
  write_map_clouds(folder, map, options.map_voxel);
}

void write_map_clouds(OutputFolder& folder, const SlamMap& map, double map_voxel) {
  for (const Session& session : map.sessions) {
    if (session.frame != session.id) continue;
    const std::string name = session.id.value == 0 ? "map.ply" : "map." + std::to_string(session.id.value) + ".ply";
    folder.file(name, [&](const FileTarget& target) { write_map(target, map, session.frame, map_voxel); });
  }
}

}  // namespace chainslam::mapper
