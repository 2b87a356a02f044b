// Two sessions merged into one map, with chained loop closures: each starts at an origin of its own, GNSS says that
// they meet, submaps are matched, and two places that agree confirm the transform between them. Usage:
// example_two_sessions [MAP.cslam...]: takes the keyframes of map files, a session each, as they were recorded.
#include <chainslam/io/map_archive.hpp>
#include <chainslam/slam/back_end.hpp>
#include <cstdio>

#include "generated/hall_drive.hpp"

using namespace chainslam;

int main(int count, char** arguments) try {
  std::vector<std::vector<Keyframe>> sessions;
  for (int i = 1; i < count; ++i) sessions.push_back(load_map(arguments[i]).map.keyframes);
  if (count == 1) sessions = {generated::hall_drive(2.0, 0.002, 1), generated::hall_drive(-3.5, -0.002, 2)};

  BackEnd<> back_end({}, LoopCloser<>({.min_travel = 2.0}));
  for (std::size_t i = 0; i < sessions.size(); ++i) {
    back_end.begin_session("session " + std::to_string(i + 1));
    for (Keyframe keyframe : sessions[i]) back_end.add(std::move(keyframe));
  }
  const std::shared_ptr<const SlamMap> map = back_end.finish();

  for (const Session& session : map->sessions)
    std::printf("%-10s %d keyframes, in the frame of session %d\n", session.name.c_str(), session.keyframes,
                session.frame.value + 1);
  const auto of_kind = [&](ClosureKind kind) {
    return static_cast<int>(std::ranges::count_if(
        map->closures, [&](const LoopClosure& one) { return one.kind == kind && one.is_factor(); }));
  };
  std::printf("closures   %d direct, %d chained, %d merge\n", of_kind(ClosureKind::direct),
              of_kind(ClosureKind::chained), of_kind(ClosureKind::merge));
  std::printf("merges     %d, tried and refused %zu\n", back_end.counts().merges, map->refusals.size());
  if (count == 1) {  // both start at x = -10.5 m of the hall, looking along it, 5.5 m apart
    const SE3d T_first_second = map->keyframes[0].T_map_body.inverse() * map->keyframes[44].T_map_body;
    std::printf("error      %.3f m between the sessions' starts\n",
                (T_first_second.translation() - Eigen::Vector3d(0, -5.5, 0)).norm());
  }
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
