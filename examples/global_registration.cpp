// Registration without an initial guess: FPFH features are matched, the poses that most matches agree on are refined by
// ICP, and the clouds themselves decide whether to accept them.
// Usage: example_global_registration [SOURCE TARGET], each a .pcd, .ply or .bin file; else two scans of a hall.
#include <chainslam/core/thread_pool.hpp>
#include <chainslam/io/cloud_file.hpp>
#include <chainslam/registration/verified_registration.hpp>
#include <cstdio>

#include "generated/hall.hpp"

using namespace chainslam;

const char* name(GlobalAlignStatus status) {
  switch (status) {
    case GlobalAlignStatus::found:
      return "found";
    case GlobalAlignStatus::refused:
      return "refused";
    case GlobalAlignStatus::no_consensus:
      return "no consensus";
    default:
      return "too few points or matches";
  }
}

int main(int count, char** arguments) try {
  Rng rng(1);
  const bool given = count == 3;
  const SE3d T_hall_source = generated::upright(4, 2, 2.5), T_hall_target = generated::upright(-3, 3, 0);
  const PointCloud<float> source = given ? read_cloud(arguments[1]) : generated::scan(T_hall_source, rng);
  const PointCloud<float> target = given ? read_cloud(arguments[2]) : generated::scan(T_hall_target, rng);

  VerifiedRegistration<> registration;     // for scans, in voxels of 0.5 m; `for_submaps()` has what suits submaps
  registration.viewpoints = Viewpoints{};  // both clouds were seen from their origin: free space counts as evidence
  const ThreadPool threads(2);
  const DescribedCloud described_source = registration.describe(source, threads);
  const DescribedCloud described_target = registration.describe(target, threads);
  std::printf("features   %zu and %zu points with 33 numbers each\n", described_source.cloud.size(),
              described_target.cloud.size());
  for (const VerifiedPose& pose : registration.candidates(described_source, described_target, threads))
    std::printf("candidate  %d of %d matches agree, overlap %.2f: %s\n", pose.result.consensus, pose.result.matches,
                pose.result.fitness_source, pose.verification.accepted() ? "accepted" : "refused");

  const GlobalAlignResult result = registration.align(described_source, described_target, threads);
  const Eigen::Vector3d t = result.T_target_source.translation(), w = result.T_target_source.rotation().log();
  std::printf("%-10s t = %.3f %.3f %.3f m, w = %.4f %.4f %.4f rad, rmse %.3f m\n", name(result.status), t.x(), t.y(),
              t.z(), w.x(), w.y(), w.z(), result.inlier_rmse);
  if (!given) {
    const SE3d error = result.T_target_source.inverse() * T_hall_target.inverse() * T_hall_source;
    std::printf("error      %.3f m, %.4f rad\n", error.translation().norm(), error.rotation().log().norm());
  }
  return result.found() ? 0 : 1;
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
