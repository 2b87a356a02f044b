#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "binary_keypoints.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "surface_planes.hpp"
#include "triangle_descriptors.hpp"

namespace chainslam {

struct PlaceDescriptorOptions {
  SurfacePlaneOptions planes{};
  BinaryKeypointOptions keypoints{};
  TriangleOptions triangles{};
};

/// What a place is recognized and verified by, in the frame of the cloud that it was made of.
struct PlaceDescriptor {
  std::vector<BinaryKeypoint> keypoints;
  std::vector<Triangle> triangles;
  IndexedCloud<> planes;  ///< centres of flat pieces of surface, and their normals, whose sign is not defined
};

/// Describes a cloud: its flat pieces, the keypoints above the largest plane, their triangles.
/// @param cloud  metres, near the origin. Without any flat piece the keypoints stand above the horizontal plane through
///   the origin.
[[nodiscard]] inline PlaceDescriptor describe_place(const PointCloud<float>& cloud,
                                                    const PlaceDescriptorOptions& options = {}) {
  const std::vector<SurfacePlane> pieces = surface_planes(cloud, options.planes);
  PlaceDescriptor place;
  place.keypoints =
      binary_keypoints(cloud, largest_plane(pieces, options.planes).value_or(SurfacePlane{}), options.keypoints);
  place.triangles = triangles_of(place.keypoints, options.triangles);
  PointCloud<float> planes;
  for (const SurfacePlane& piece : pieces) {
    planes.positions.push_back(piece.center.cast<float>());
    planes.normals.push_back(piece.normal.cast<float>());
  }
  place.planes = IndexedCloud<>(std::move(planes));
  return place;
}

}  // namespace chainslam
