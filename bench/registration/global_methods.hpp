#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/registration/feature_registration.hpp"
#include "chainslam/registration/graph_consensus.hpp"
#include "chainslam/registration/ransac.hpp"
#include "chainslam/registration/verified_registration.hpp"
#ifdef CHAINSLAM_PEER_KISS_MATCHER
#include "registration/peers/kiss_matcher.hpp"
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
#include "registration/peers/open3d.hpp"
#endif
#ifdef CHAINSLAM_PEER_PCL
#include "registration/peers/pcl.hpp"
#endif
#ifdef CHAINSLAM_PEER_TEASER
#include "registration/peers/teaser.hpp"
#endif

namespace chainslam::bench {

/// All use voxels of 0.5 m, normals within 1.5 m turned to the sensor, FPFH
/// within 2.5 m, inliers within 0.75 m.
inline constexpr double global_voxel = 0.5, global_normals = 1.5, global_features = 2.5, global_distance = 0.75;

/// A way to find T_target_source without a guess from two clouds as a LiDAR
/// gives them, each in its sensor's frame; nothing where it finds none. Another
/// program joins the recall protocol by an entry in `global_methods`.
struct GlobalMethod {
  std::string name;
  std::function<std::optional<SE3d>(const PointCloud<float>& source, const PointCloud<float>& target)> align;
};

template <class Estimator>
[[nodiscard]] FeatureRegistration<Estimator> feature_registration() {
  FeatureRegistration<Estimator> registration{.voxel_size = global_voxel,
                                              .normals = {.neighbors = 0, .radius = global_normals},
                                              .features = {.radius = global_features, .max_neighbors = 0}};
  registration.estimator.max_distance = global_distance;
  return registration;
}

[[nodiscard]] inline VerifiedRegistration<> verified_registration() {
  VerifiedRegistration<> registration;
  registration.viewpoints = Viewpoints{};  // a scan is seen from its origin
  return registration;
}

namespace detail {

template <class R>
[[nodiscard]] GlobalMethod own_method(std::string name, R registration) {
  return {std::move(name),
          [registration = std::move(registration)](const PointCloud<float>& source,
                                                   const PointCloud<float>& target) -> std::optional<SE3d> {
            const GlobalAlignResult result = registration.align(source, target);
            if (!result.found()) return std::nullopt;
            return result.T_target_source;
          }};
}

#if defined(CHAINSLAM_PEER_KISS_MATCHER) || defined(CHAINSLAM_PEER_OPEN3D) || defined(CHAINSLAM_PEER_PCL)
[[nodiscard]] inline std::optional<SE3d> pose_of(const PeerPose& answer) {
  if (!answer.converged) return std::nullopt;
  return SE3d::from_matrix(answer.T_target_source.matrix());
}
#endif

#ifdef CHAINSLAM_PEER_OPEN3D
[[nodiscard]] inline Open3dCloud open3d_described(const PointCloud<float>& cloud) {
  Open3dCloud described = Open3dCloud(cloud.positions).downsampled(global_voxel);
  described.estimate_normals(30, global_normals);
  described.estimate_fpfh(global_features);
  return described;
}
#endif

}  // namespace detail

/// Ours, and the peers of this build.
[[nodiscard]] inline std::vector<GlobalMethod> global_methods() {
  std::vector<GlobalMethod> methods{
      detail::own_method("chainslam verified", verified_registration()),
      detail::own_method("chainslam graph", feature_registration<GraphConsensus<>>()),
      detail::own_method("chainslam ransac", feature_registration<Ransac>()),
  };
#ifdef CHAINSLAM_PEER_KISS_MATCHER
  methods.push_back({"KISS-Matcher", [](const PointCloud<float>& source, const PointCloud<float>& target) {
                       return detail::pose_of(kiss_matcher_align(source.positions, target.positions, global_voxel));
                     }});
#endif
#ifdef CHAINSLAM_PEER_OPEN3D
  methods.push_back({"Open3D RANSAC", [](const PointCloud<float>& source, const PointCloud<float>& target) {
                       const Open3dCloud a = detail::open3d_described(source), b = detail::open3d_described(target);
                       return detail::pose_of(open3d_ransac(a, b, open3d_matches(a, b), global_distance));
                     }});
#endif
#if defined(CHAINSLAM_PEER_TEASER) && defined(CHAINSLAM_PEER_OPEN3D)
  methods.push_back(
      {"TEASER++, Open3D's features", [](const PointCloud<float>& source, const PointCloud<float>& target) {
         const Open3dCloud a = detail::open3d_described(source), b = detail::open3d_described(target);
         return detail::pose_of(teaser_align(a.positions(), b.positions(), open3d_matches(a, b), global_voxel));
       }});
#endif
  return methods;
}

}  // namespace chainslam::bench
