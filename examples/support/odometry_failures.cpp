#include "support/odometry_failures.hpp"

#include "chainslam/factor_graph/noise_model.hpp"

namespace chainslam::support {

std::vector<OdometryFailure> odometry_failures(const SlamMap& map, const Session& session, double threshold) {
  std::vector<OdometryFailure> failures;
  const auto keyframe = [&](KeyframeId id) -> const Keyframe& {
    return map.keyframes[static_cast<std::size_t>(id.value)];
  };
  for (const OdometryMeasurement& step : map.odometry) {
    const Keyframe &from = keyframe(step.from), &to = keyframe(step.to);
    if (from.session != session.id) continue;
    const SE3d T_from_to = from.T_map_body.inverse() * to.T_map_body;
    const Vector6d error = step.T_from_to.local(T_from_to);
    const double squared = whitened(step.sqrt_information, error).squaredNorm();
    if (!(squared > threshold)) continue;
    const Timestamp first = map.keyframes[static_cast<std::size_t>(session.first_keyframe)].time;
    failures.push_back({.begin = to_seconds(from.time - first),
                        .end = to_seconds(to.time - first),
                        .distance = step.T_from_to.translation().norm(),
                        .off = (T_from_to.translation() - step.T_from_to.translation()).norm(),
                        .turned = error.tail<3>().norm(),
                        .squared_error = squared});
  }
  return failures;
}

}  // namespace chainslam::support
