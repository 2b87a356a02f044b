#include "slam/peers/map_closures.hpp"

#include <Eigen/Dense>
#include <GroundAlign.hpp>
#include <MapClosures.hpp>
#include <cmath>
#include <vector>

namespace chainslam::bench {

/// Its matching is protected, and its own queries only look at what was added before.
struct MapClosuresPlaces::Database : map_closures::MapClosures {
  static constexpr int query = -1;
  int count = 0;

  explicit Database(double cell_size) : MapClosures(map_closures::Config{static_cast<float>(cell_size), 0.05F, 50}) {}

  void add(const std::vector<Eigen::Vector3d>& points) {
    descriptor_matches_.clear();
    MatchAndAddToDatabase(count++, points);
  }
  PlaceMatch find(const std::vector<Eigen::Vector3d>& points) {
    descriptor_matches_.clear();
    Match(points);
    ground_alignments_[query] = map_closures::AlignToLocalGround(points, config_.density_map_resolution);
    PlaceMatch best{.place = -1, .T_place_query = {}, .inliers = 0};
    for (int place = 0; place < count; ++place) {
      const auto closure = ValidateClosure(place, query);
      const auto inliers = static_cast<Index>(closure.number_of_inliers);
      if (inliers <= best.inliers) continue;
      const Eigen::Matrix4d T_place_query = closure.pose.inverse();
      best = {.place = place,
              .T_place_query = SE2d(SO2d::from_angle(std::atan2(T_place_query(1, 0), T_place_query(0, 0))),
                                    T_place_query.topRightCorner<2, 1>()),
              .inliers = inliers};
    }
    return best;
  }
};

namespace {

std::vector<Eigen::Vector3d> in_doubles(std::span<const Eigen::Vector3f> points) {
  std::vector<Eigen::Vector3d> result;
  result.reserve(points.size());
  for (const Eigen::Vector3f& point : points) result.push_back(point.cast<double>());
  return result;
}

}  // namespace

MapClosuresPlaces::MapClosuresPlaces(double cell_size) : database_(std::make_unique<Database>(cell_size)) {}
MapClosuresPlaces::~MapClosuresPlaces() = default;
void MapClosuresPlaces::add(std::span<const Eigen::Vector3f> points) { database_->add(in_doubles(points)); }
PlaceMatch MapClosuresPlaces::find(std::span<const Eigen::Vector3f> points) {
  return database_->find(in_doubles(points));
}

}  // namespace chainslam::bench
