#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <type_traits>
#include <utility>

#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/bucketed_voxels.hpp"
#include "chainslam/search/detail/point_source.hpp"
#include "chainslam/search/detail/voxel_tiles.hpp"
#include "chainslam/search/downsampling.hpp"
#include "chainslam/search/search_base.hpp"

namespace chainslam {

/// A local map that grows by scans and is bounded by erasing: a hash of voxels. Nothing in it is ever rebuilt.
///
/// How it downsamples decides how it is kept:
/// - `FirstInVoxel`, `NearestToCenter` and `MeanOfVoxel` keep one point a voxel, in about 20 bytes; inserting into a
///   voxel that has one is little more than the test of a bit. Searching is exact at any distance.
/// - `VoxelMapOptions` keeps up to a number of points a voxel at a spacing, without regard to voxels' faces; `AtMost`
///   only the number. Searching is exact up to `max_search_radius()`, beyond which nothing is found.
///
/// Which points are kept depends on the history of changes alone, and so does the order of `for_each_point`. With
/// `VoxelMapOptions` and `AtMost`, indices and `position(i)` stay valid while points are inserted; with the others they
/// are good until the next change. Erasing frees indices, which are then used again.
/// Const calls may run on several threads, but not during a change.
template <class ScalarType = float, class Downsampling = VoxelMapOptions, int Dim = 3>
class VoxelMap : public IncrementalSearchBase<VoxelMap<ScalarType, Downsampling, Dim>, ScalarType, Dim> {
  static_assert(std::is_same_v<Downsampling, VoxelMapOptions> || VoxelPolicy<Downsampling>,
                "VoxelMap: Downsampling needs a voxel_size and its rule, as in NearestToCenter; to keep all points, "
                "take VoxelMapOptions; see chainslam/search/downsampling.hpp");
  static constexpr bool many_a_voxel =
      std::is_same_v<Downsampling, VoxelMapOptions> || std::is_same_v<Downsampling, AtMost>;
  using Base = IncrementalSearchBase<VoxelMap, ScalarType, Dim>;
  friend Base;
  friend SearchBase<VoxelMap, ScalarType, Dim>;

 public:
  using typename Base::Box;
  using typename Base::Scalar;
  using typename Base::Vector;

  /// @throws std::invalid_argument if an option is out of range.
  explicit VoxelMap(const Downsampling& options = {}) : options_(options), voxels_(storage_options(options)) {}

  /// A map of the points: `insert(points)` into an empty map.
  template <detail::PointSource<Dim> Points>
  explicit VoxelMap(const Points& points, const Downsampling& options = {}) : VoxelMap(options) {
    insert(points);
  }

  [[nodiscard]] const Downsampling& downsampling() const { return options_; }                  ///< how it downsamples
  [[nodiscard]] std::size_t size() const { return static_cast<std::size_t>(voxels_.size()); }  ///< number of points
  /// Points refused because a coordinate is NaN, infinite, or 2^31 or more voxels from the origin (where there may be
  /// many a voxel, blocks of four voxels).
  [[nodiscard]] Index rejected() const { return voxels_.rejected(); }
  /// Metres; neighbours within it are found exactly, none beyond it is found.
  [[nodiscard]] Scalar max_search_radius() const requires(many_a_voxel) { return voxels_.max_search_radius(); }
  /// Bytes held, the hash table and free capacity included.
  [[nodiscard]] std::size_t memory() const { return voxels_.memory(); }

  /// Inserts the points in their order. Returns by how much `size()` grew.
  template <detail::PointSource<Dim> Points>
  Index insert(const Points& points) {
    if constexpr (many_a_voxel) {
      return Base::insert(points);
    } else {
      const std::size_t before = size();
      voxels_.insert(detail::source_size<Dim>(points),
                     [&](Index i) -> Vector { return detail::source_position<Scalar, Dim>(points, i); });
      return static_cast<Index>(size() - before);
    }
  }
  /// Takes a point if the rule has it so. Returns whether it has become a point of the map.
  bool insert(const Vector& point) { return voxels_.insert(point); }

  /// Erases a point. Returns false if there is none with this index.
  bool erase(Index i) { return voxels_.erase(i); }
  /// Erases the points for which `leaves(index, position)` holds. Returns how many went.
  template <class Predicate>
  Index erase_if(Predicate&& leaves) {
    return voxels_.erase_if(std::forward<Predicate>(leaves));
  }
  void clear() { *this = VoxelMap(options_); }  ///< erases everything

  /// Whether i is the index of a point.
  [[nodiscard]] bool contains(Index i) const { return voxels_.contains(i); }
  /// Position of a point that a search has returned.
  [[nodiscard]] Vector position(Index i) const { return voxels_.position(i); }
  /// Calls `visit(index, position)` for every point, in an order that depends on the history of changes alone.
  template <class Visit>
  void for_each_point(Visit&& visit) const {
    voxels_.for_each_point(std::forward<Visit>(visit));
  }
  /// The smallest box that holds the points.
  [[nodiscard]] Box bounding_box() const { return voxels_.bounding_box(); }

 private:
  using Storage = std::conditional_t<many_a_voxel, detail::BucketedVoxels<Scalar, Dim>,
                                     detail::VoxelTiles<Scalar, Dim, Downsampling>>;

  [[nodiscard]] static auto storage_options(const Downsampling& options) {
    if constexpr (std::is_same_v<Downsampling, AtMost>) {
      require_valid(options);
      return VoxelMapOptions{
          .voxel_size = options.voxel_size, .max_points_per_voxel = options.count, .min_spacing = 0, .reach = 2};
    } else {
      return options;
    }
  }

  template <class Collector>
  void search(const Vector& query, Collector& found) const {
    voxels_.search(query, found);
  }
  template <class Region>
  Index erase_region(const Region& region) {
    return voxels_.erase_region(region);
  }
  template <class Region, class Visit>
  void visit_region(const Region& region, Visit&& visit) const {
    voxels_.visit_region(region, std::forward<Visit>(visit));
  }

  Downsampling options_;
  Storage voxels_;
};
static_assert(IncrementalSearch<VoxelMap<>> && SeededSearch<VoxelMap<>> && FixedSizeSearch<VoxelMap<>>);

}  // namespace chainslam
