// Errors of a trajectory against a reference: absolute, relative, and KITTI's relative errors.
// Usage: example_evaluate_trajectory [REFERENCE.tum ESTIMATE.tum]; without files, a generated drive with drift.
#include <chainslam/core/random.hpp>
#include <chainslam/io/trajectory_file.hpp>
#include <chainslam/trajectory/association.hpp>
#include <chainslam/trajectory/kitti_errors.hpp>
#include <chainslam/trajectory/pose_errors.hpp>
#include <cstdio>

using namespace chainslam;

int main(int count, char** arguments) try {
  Trajectory reference, estimate;
  if (count == 3) {
    reference = read_tum(arguments[1]);
    estimate = read_tum(arguments[2]);
  } else {  // 600 m at 10 Hz; the estimate starts elsewhere, half as often, and drifts by 1 % of the way
    Rng rng(1);
    const SE3d T_estimate_reference(SO3d::exp({0, 0, 1.0}), {100, 20, 0});
    SE3d truth, odometry;
    for (int i = 0; i <= 600; ++i) {
      const Timestamp time = Timestamp::from_seconds(0.1 * i);
      reference.times.push_back(time);
      reference.poses.push_back(truth);
      if (i % 2 == 0) {
        estimate.times.push_back(time + std::chrono::milliseconds(2));
        estimate.poses.push_back(T_estimate_reference * odometry);
      }
      const SE3d step(SO3d::exp({0, 0, 0.01 * std::sin(0.05 * i)}), {1, 0, 0});
      truth = truth * step;
      odometry = odometry * step * SE3d(SO3d::exp({0, 0, rng.normal(0, 1e-4)}), {0.01, 0, 0});
    }
  }
  const Association association = associate_by_time(reference, estimate);
  const MatchedTrajectories pairs = matched(reference, estimate, association);
  std::printf("poses      %zu reference, %zu estimated, %zu matched\n", reference.size(), estimate.size(),
              association.matches.size());

  const AbsolutePoseErrors absolute = ape(pairs.reference, pairs.estimate);  // after the best rigid alignment
  const AbsolutePoseErrors scaled = ape(pairs.reference, pairs.estimate, {.align = Alignment::sim3});
  const RelativePoseErrors relative =
      rpe(pairs.reference, pairs.estimate, {.delta = 10, .unit = DeltaUnit::metres, .pairs = PairChoice::all});
  std::printf("ape        rmse %.3f m, largest %.3f m, %.4f rad\n", absolute.translation.rmse, absolute.translation.max,
              absolute.rotation.rmse);
  std::printf("           rmse %.3f m with scale %.4f\n", scaled.translation.rmse, scaled.S_reference_estimate.scale());
  std::printf("rpe        rmse %.3f m, %.4f rad over 10 m, %d pairs\n", relative.translation.rmse,
              relative.rotation.rmse, relative.translation.count);
  const KittiErrors kitti = kitti_errors(pairs.reference, pairs.estimate, {.step = 5});
  std::printf("kitti      %.3f %%, %.5f deg/m over %zu segments\n", 100 * kitti.translation,
              kitti.rotation * 180 / std::numbers::pi, kitti.segments.size());
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
