#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/registration/icp.hpp"
#include "chainslam/registration/metrics.hpp"
#include "chainslam/registration/rejectors.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "descriptor_table.hpp"
#include "place_descriptor.hpp"
#include "surface_planes.hpp"

namespace chainslam {

/// When a candidate is the place of the query. Defaults: LAMM's configuration for NCLT.
struct VerificationOptions {
  Index max_hypotheses = 50;       ///< matches whose pose is tried
  double corner_distance = 3.0;    ///< metres, of all corners of a match under a pose that it agrees with
  Index min_agreeing = 4;          ///< matches
  double normal_difference = 0.2;  ///< between the normals of two pieces of one plane, either sign
  double plane_distance = 0.5;     ///< metres from a piece's centre to the plane of the other
  double min_overlap = 0.6;        ///< share of the query's pieces that lie in planes of the place
  double refine_distance = 3.0;    ///< metres between the centres of two pieces that refinement pairs
};

/// A place that was recognized.
struct RecognizedPlace {
  Index place = 0;
  SE3d T_place_query{};
  double overlap = 0;                ///< share of the query's pieces of planes, before refinement
  Index agreeing = 0;                ///< matches
  double mean_squared_residual = 0;  ///< of the refinement, point to plane, m^2
};

namespace detail {

/// The corners of matched triangles, three after three.
struct MatchedCorners {
  std::vector<Eigen::Vector3d> query, place;

  [[nodiscard]] std::size_t size() const { return query.size() / 3; }
  [[nodiscard]] std::optional<SE3d> pose(std::size_t match) const {
    const auto fit = umeyama(std::span(query).subspan(3 * match, 3), std::span(place).subspan(3 * match, 3), false);
    if (!fit) return std::nullopt;
    return fit->rigid();
  }
  /// How many matches have all corners together under a pose.
  [[nodiscard]] Index agreeing(const SE3d& T_place_query, double distance) const {
    Index count = 0;
    for (std::size_t match = 0; match < size(); ++match) {
      bool agrees = true;
      for (std::size_t i = 3 * match; i < 3 * match + 3 && agrees; ++i)
        agrees = (T_place_query * query[i] - place[i]).squaredNorm() < distance * distance;
      count += agrees ? 1 : 0;
    }
    return count;
  }
};

[[nodiscard]] inline MatchedCorners matched_corners(const PlaceDescriptor& query, const PlaceDescriptor& place,
                                                    std::span<const TriangleMatch> matches) {
  MatchedCorners corners;
  for (const TriangleMatch& match : matches) {
    const Triangle& a = query.triangles[static_cast<std::size_t>(match.query)];
    const Triangle& b = place.triangles[static_cast<std::size_t>(match.place)];
    for (std::size_t k = 0; k < 3; ++k) {
      corners.query.push_back(query.keypoints[a.corners[k]].position.cast<double>());
      corners.place.push_back(place.keypoints[b.corners[k]].position.cast<double>());
    }
  }
  return corners;
}

}  // namespace detail

/// The pose of one match that most matches agree with.
/// @returns none if fewer agree than the options ask for.
[[nodiscard]] inline std::optional<RecognizedPlace> consensus_pose(const PlaceDescriptor& query,
                                                                   const PlaceDescriptor& place,
                                                                   const PlaceCandidate& candidate,
                                                                   const VerificationOptions& options = {}) {
  const detail::MatchedCorners corners = detail::matched_corners(query, place, candidate.matches);
  const std::size_t step = corners.size() / static_cast<std::size_t>(options.max_hypotheses) + 1;
  RecognizedPlace best{.place = candidate.place};
  for (std::size_t match = 0; match < corners.size(); match += step) {
    const std::optional<SE3d> pose = corners.pose(match);
    if (!pose) continue;
    const Index agreeing = corners.agreeing(*pose, options.corner_distance);
    if (agreeing > best.agreeing) best = {.place = candidate.place, .T_place_query = *pose, .agreeing = agreeing};
  }
  if (best.agreeing < options.min_agreeing) return std::nullopt;
  return best;
}

/// The share of the query's pieces of planes that lie, under a pose, in the plane of the place's piece nearest to them.
[[nodiscard]] inline double plane_overlap(const PointCloud<float>& query, const IndexedCloud<>& place,
                                          const SE3d& T_place_query, const VerificationOptions& options = {}) {
  if (query.empty() || place.size() == 0) return 0;
  Index matched = 0;
  for (std::size_t i = 0; i < query.size(); ++i) {
    const Eigen::Vector3d p = T_place_query * query.positions[i].cast<double>().eval();
    const Eigen::Vector3d n = T_place_query.rotation() * query.normals[i].cast<double>().eval();
    const auto nearest = place.knn<1>(p.cast<float>());
    if (nearest.count == 0) continue;
    const Index other = nearest.neighbors[0].index;
    const Eigen::Vector3d q = place.position(other).cast<double>(), m = place.normal(other).cast<double>();
    if (normal_difference(n, m) < options.normal_difference && std::abs(m.dot(p - q)) < options.plane_distance)
      ++matched;
  }
  return static_cast<double>(matched) / static_cast<double>(query.size());
}

/// Moves the query's pieces of planes onto those of the place, point to plane. Where that fails the pose stays.
[[nodiscard]] inline RecognizedPlace refined(RecognizedPlace found, const PointCloud<float>& query,
                                             const IndexedCloud<>& place, const VerificationOptions& options = {}) {
  const Icp<PointToPlane, Trivial, WithinAngle> icp{.max_distance = options.refine_distance,
                                                    .rejector = {.max_angle = options.normal_difference}};
  const AlignResult result = icp.align(query, place, found.T_place_query);
  if (result.status == AlignStatus::converged || result.status == AlignStatus::degenerate)
    found.T_place_query = result.T_target_source;
  found.mean_squared_residual = result.mean_squared_residual;
  return found;
}

/// Of a query's candidates the one whose planes overlap most, if they do enough; its pose refined.
[[nodiscard]] inline std::optional<RecognizedPlace> recognize(const PlaceDescriptor& query,
                                                              const DescriptorTable& table,
                                                              std::span<const PlaceCandidate> candidates,
                                                              const VerificationOptions& options = {}) {
  std::optional<RecognizedPlace> best;
  for (const PlaceCandidate& candidate : candidates) {
    const PlaceDescriptor& place = table.place(candidate.place);
    std::optional<RecognizedPlace> found = consensus_pose(query, place, candidate, options);
    if (!found) continue;
    found->overlap = plane_overlap(query.planes.cloud(), place.planes, found->T_place_query, options);
    if (found->overlap > options.min_overlap && (!best || found->overlap > best->overlap)) best = found;
  }
  if (best) best = refined(*best, query.planes.cloud(), table.place(best->place).planes, options);
  return best;
}

}  // namespace chainslam
