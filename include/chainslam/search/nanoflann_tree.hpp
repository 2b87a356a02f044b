#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <nanoflann.hpp>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/search_base.hpp"

namespace chainslam {

namespace detail {

/// The finite points of a cloud, as nanoflann reads them.
template <class Scalar>
struct NanoflannPoints {
  std::vector<Eigen::Matrix<Scalar, 3, 1>> positions;  ///< as in the cloud
  std::vector<Index> finite;                           ///< the points nanoflann sees

  [[nodiscard]] std::size_t kdtree_get_point_count() const { return finite.size(); }
  [[nodiscard]] Scalar kdtree_get_pt(std::size_t i, std::size_t axis) const {
    return positions[static_cast<std::size_t>(finite[i])][static_cast<Eigen::Index>(axis)];
  }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};

/// Hands what nanoflann finds to one of our collectors.
template <class Scalar, class Collector>
class NanoflannResult {
 public:
  using DistanceType = Scalar;

  NanoflannResult(Collector& found, const std::vector<Index>& finite) : found_(found), finite_(finite) {}
  [[nodiscard]] bool full() const { return true; }
  [[nodiscard]] Scalar worstDist() const { return found_.bound(); }
  bool addPoint(Scalar squared_distance, std::uint32_t i) {
    if (squared_distance < found_.bound()) found_.offer(finite_[i], squared_distance);
    return true;
  }

 private:
  Collector& found_;
  const std::vector<Index>& finite_;
};

}  // namespace detail

/// nanoflann's static k-d tree (Blanco and Rai 2014, BSD) behind `NearestNeighborSearch`: needs nanoflann 1.4 or newer.
template <class ScalarType = float>
class NanoflannTree : public SearchBase<NanoflannTree<ScalarType>, ScalarType, 3> {
  friend SearchBase<NanoflannTree, ScalarType, 3>;

 public:
  using Scalar = ScalarType;                    ///< number type
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;  ///< a point

  /// @param cloud  points in any frame, metres; NaN and infinite ones are left out and counted.
  template <Cloud Points>
  explicit NanoflannTree(const Points& cloud, std::size_t leaf_size = 10)
      : points_(copy(cloud)), tree_(std::make_unique<Tree>(3, *points_, leaf_size)) {}

  [[nodiscard]] std::size_t size() const { return points_->finite.size(); }  ///< points that can be found
  /// Points left out because a coordinate is NaN or infinite.
  [[nodiscard]] Index rejected() const { return static_cast<Index>(points_->positions.size() - size()); }
  /// Whether point i of the cloud is in the tree.
  [[nodiscard]] bool contains(Index i) const {
    return i >= 0 && static_cast<std::size_t>(i) < points_->positions.size() && is_finite(position(i));
  }
  /// Position of point i of the cloud, metres.
  [[nodiscard]] const Vector3& position(Index i) const { return points_->positions[static_cast<std::size_t>(i)]; }

 private:
  using Points = detail::NanoflannPoints<Scalar>;
  using Metric = nanoflann::L2_Simple_Adaptor<Scalar, Points, Scalar, std::uint32_t>;
  using Tree = nanoflann::KDTreeSingleIndexAdaptor<Metric, Points, 3, std::uint32_t>;

  template <Cloud Source>
  static std::unique_ptr<Points> copy(const Source& cloud) {
    auto points = std::make_unique<Points>();
    const Index count = to_index(cloud_size(cloud), "cloud");
    for (Index i = 0; i < count; ++i) {
      points->positions.push_back(chainslam::position(cloud, static_cast<std::size_t>(i)).template cast<Scalar>());
      if (is_finite(points->positions.back())) points->finite.push_back(i);
    }
    return points;
  }

  template <class Collector>
  void search(const Vector3& query, Collector& found) const {
    if (!is_finite(query)) return;
    detail::NanoflannResult<Scalar, Collector> result(found, points_->finite);
    tree_->findNeighbors(result, query.data(), nanoflann::SearchParams());
  }

  // On the heap: nanoflann's tree refers to the points by address, and this class may be moved.
  std::unique_ptr<Points> points_;
  std::unique_ptr<Tree> tree_;
};
static_assert(NearestNeighborSearch<NanoflannTree<float>>);

}  // namespace chainslam
