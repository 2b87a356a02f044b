#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>

#include "chainslam/lie/se2.hpp"
#include "chainslam/slam/place_index.hpp"

namespace chainslam::bench {

/// MapClosures (Gupta, Guadagnino, Mersch, Vizzo and Stachniss 2024), by path: its place for a local map, among those
/// that were added.
class MapClosuresPlaces {
 public:
  explicit MapClosuresPlaces(double cell_size);  ///< @param cell_size  of its density maps, metres
  ~MapClosuresPlaces();
  MapClosuresPlaces(const MapClosuresPlaces&) = delete;
  MapClosuresPlaces& operator=(const MapClosuresPlaces&) = delete;

  /// Adds the next place. @param points  of a local map, metres
  void add(std::span<const Eigen::Vector3f> points);
  /// The place with most inliers; `place` is -1 if there is none.
  [[nodiscard]] PlaceMatch find(std::span<const Eigen::Vector3f> points);

 private:
  struct Database;
  std::unique_ptr<Database> database_;
};

}  // namespace chainslam::bench
