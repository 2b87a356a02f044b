#include "registration/peers/teaser.hpp"

#include <omp.h>

#include <teaser/registration.h>

namespace chainslam::bench {
namespace {

Eigen::Matrix3Xd columns(const Positions& points, const IndexPairs& matches, int IndexPairs::value_type::*side) {
  Eigen::Matrix3Xd result(3, static_cast<Eigen::Index>(matches.size()));
  for (std::size_t i = 0; i < matches.size(); ++i)
    result.col(static_cast<Eigen::Index>(i)) = points[static_cast<std::size_t>(matches[i].*side)].cast<double>();
  return result;
}

}  // namespace

PeerPose teaser_align(const Positions& source, const Positions& target, const IndexPairs& matches, double noise_bound) {
  omp_set_num_threads(1);
  teaser::RobustRegistrationSolver::Params parameters;
  parameters.noise_bound = noise_bound;
  parameters.cbar2 = 1;
  parameters.estimate_scaling = false;
  parameters.inlier_selection_mode = teaser::RobustRegistrationSolver::INLIER_SELECTION_MODE::PMC_HEU;
  parameters.max_clique_num_threads = 1;
  teaser::RobustRegistrationSolver solver(parameters);
  const teaser::RegistrationSolution solution = solver.solve(columns(source, matches, &IndexPairs::value_type::first),
                                                             columns(target, matches, &IndexPairs::value_type::second));
  PeerPose result;
  result.T_target_source.linear() = solution.rotation;
  result.T_target_source.translation() = solution.translation;
  result.converged = solution.valid;
  result.inliers = solver.getTranslationInliers().size();
  return result;
}

}  // namespace chainslam::bench
