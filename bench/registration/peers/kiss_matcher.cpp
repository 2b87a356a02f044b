#include "registration/peers/kiss_matcher.hpp"

#include <omp.h>
#include <tbb/global_control.h>

#include <algorithm>

#include <kiss_matcher/FasterPFH.hpp>
#include <kiss_matcher/KISSMatcher.hpp>
#include <kiss_matcher/ROBINMatching.hpp>

namespace chainslam::bench {
namespace {

/// Keeps its two pools of threads from starting, for as long as it lives.
class OneThread {
 public:
  OneThread() { omp_set_num_threads(1); }

 private:
  tbb::global_control control_{tbb::global_control::max_allowed_parallelism, 1};
};

std::vector<Eigen::VectorXf> dynamic(const PeerFeatures& features) {
  std::vector<Eigen::VectorXf> result;
  result.reserve(features.size());
  for (const std::array<float, 33>& feature : features)
    result.emplace_back(Eigen::Map<const Eigen::Matrix<float, 33, 1>>(feature.data()));
  return result;
}

}  // namespace

KissMatcherFeatures kiss_matcher_features(const Positions& points, double voxel) {
  const OneThread one_thread;
  const kiss_matcher::KISSMatcherConfig config(static_cast<float>(voxel));
  kiss_matcher::FasterPFH describer(config.normal_radius_, config.fpfh_radius_, config.thr_linearity_);
  describer.setInputCloud(points);
  KissMatcherFeatures result;
  std::vector<Eigen::VectorXf> descriptors;
  describer.ComputeFeature(result.positions, descriptors);
  for (const Eigen::VectorXf& descriptor : descriptors)
    std::copy_n(descriptor.data(), 33, result.features.emplace_back().data());
  return result;
}

IndexPairs kiss_matcher_matches(const KissMatcherFeatures& source, const KissMatcherFeatures& target, bool ratio_test) {
  const OneThread one_thread;
  const kiss_matcher::KISSMatcherConfig config;
  kiss_matcher::ROBINMatching matching(config.robin_noise_bound_, config.num_max_corr_, config.tuple_scale_);
  Positions from = source.positions, to = target.positions;  // which it takes as mutable
  std::vector<Eigen::VectorXf> from_features = dynamic(source.features), to_features = dynamic(target.features);
  (void)matching.establishCorrespondences(from, to, from_features, to_features,
                                          "matches alone",  // no mode of its: it prunes nothing
                                          config.tuple_scale_, ratio_test);
  return matching.getCrossCheckedCorrespondences();
}

PeerPose kiss_matcher_align(const Positions& source, const Positions& target, double voxel) {
  const OneThread one_thread;
  kiss_matcher::KISSMatcher matcher{kiss_matcher::KISSMatcherConfig(static_cast<float>(voxel))};
  const kiss_matcher::RegistrationSolution solution = matcher.estimate(source, target);
  PeerPose result;
  result.T_target_source.linear() = solution.rotation;
  result.T_target_source.translation() = solution.translation;
  result.converged = solution.valid;
  result.inliers = matcher.getNumFinalInliers();
  return result;
}

}  // namespace chainslam::bench
