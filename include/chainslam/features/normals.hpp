#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <type_traits>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/compiled.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/detail/plane_lanes.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "chainslam/search/leaf_neighbors.hpp"

namespace chainslam {

/// Which neighbours a point's normal is taken from: the `neighbors` nearest, the point itself counted, of those within
/// `radius`.
struct NormalOptions {
  Index neighbors = 20;                                     ///< 0: all within `radius`
  double radius = std::numeric_limits<double>::infinity();  ///< metres
  Index min_neighbors = 5;                                  ///< with fewer, a point gets no normal
  bool covariances = false;                                 ///< whether to give them, too
};

/// What `estimate_normals` learned besides the normals, for each point.
struct NormalEstimates {
  std::vector<float> planarity;  ///< (l1 - l0) / l2 in [0, 1], see `PlaneFit`; 0 without a normal
  std::vector<float> curvature;  ///< l0 / (l0 + l1 + l2) in [0, 1/3]; 0 without a normal
  /// Of the neighbours about their mean: xx, xy, xz, yy, yz, zz, m^2; zeros without a normal. Empty unless asked for.
  std::vector<std::array<float, 6>> covariances;
  Index without_normal = 0;  ///< points that got none: isolated, on a line, NaN
};

namespace detail {

inline void check(const NormalOptions& options) {
  if (options.neighbors < 0 || !(options.radius > 0) || (options.neighbors == 0 && !is_finite(options.radius)))
    throw std::invalid_argument("estimate_normals: set neighbors > 0, or a finite radius > 0");
}

/// The normal of a surface at `p`, on the side that is seen from the viewpoint.
[[nodiscard]] inline Eigen::Vector3f turned_towards(const Eigen::Vector3d& viewpoint, const Eigen::Vector3d& p,
                                                    const Eigen::Vector3d& n) {
  const double towards = n[0] * (viewpoint[0] - p[0]) + n[1] * (viewpoint[1] - p[1]) + n[2] * (viewpoint[2] - p[2]);
  const double sign = towards < 0 ? -1.0 : 1.0;
  return {static_cast<float>(sign * n[0]), static_cast<float>(sign * n[1]), static_cast<float>(sign * n[2])};
}

/// Takes a cloud's normals off: what is known before the first is estimated.
[[nodiscard]] [[gnu::cold]] inline NormalEstimates no_normals(PointCloud<float>& cloud, const NormalOptions& options) {
  NormalEstimates estimates;
  cloud.normals = std::vector<Eigen::Vector3f>(cloud.size(), Eigen::Vector3f::Zero());
  estimates.planarity = std::vector<float>(cloud.size());
  estimates.curvature = std::vector<float>(cloud.size());
  if (options.covariances) estimates.covariances.resize(cloud.size());
  return estimates;
}

/// Where normals and what goes with them are written; of the estimates, those with buffers.
struct NormalWriter {
  PointCloud<float>& cloud;
  NormalEstimates& estimates;
  const NormalOptions& options;
  Eigen::Vector3d viewpoint;

  /// Fits the planes of the neighbourhoods at hand, which are then forgotten. Returns how many points got no normal.
  template <class Scalar>
  Index write(PlaneLanes<Scalar>& lanes) const {
    constexpr double line_ratio = 1e-8;  // as in fit_plane
    SymmetricLanes covariances;
    LeastEigenLanes eigen;
    lanes.covariances(covariances);
    least_eigenvectors(covariances, eigen);
    Index without = 0;
    for (int lane = 0; lane < lanes.used(); ++lane) {
      const auto i = static_cast<std::size_t>(lanes.point(lane));
      const double l0 = std::max(eigen.values[0][lane], 0.0), l1 = eigen.values[1][lane], l2 = eigen.values[2][lane];
      if (lanes.count(lane) < std::max(options.min_neighbors, Index{3}) || !(l1 > line_ratio * l2) || !(l2 > 0)) {
        ++without;
        continue;
      }
      const Eigen::Vector3d n(eigen.vector[0][lane], eigen.vector[1][lane], eigen.vector[2][lane]);
      cloud.normals[i] = turned_towards(viewpoint, position(cloud, i), n);
      if (estimates.planarity.empty()) continue;
      estimates.planarity[i] = static_cast<float>((l1 - l0) / l2);
      estimates.curvature[i] = static_cast<float>(l0 / (l0 + l1 + l2));
      if (!options.covariances) continue;
      const auto entry = [&](const Doubles& values) { return static_cast<float>(values[lane]); };
      estimates.covariances[i] = {entry(covariances.xx), entry(covariances.xy), entry(covariances.xz),
                                  entry(covariances.yy), entry(covariances.yz), entry(covariances.zz)};
    }
    lanes.clear();
    return without;
  }
};

/// The `KdTree` in a search, or nothing.
template <class Search>
[[nodiscard]] constexpr std::nullptr_t tree_in(const Search&) {
  return nullptr;
}
template <class Scalar>
[[nodiscard]] const KdTree<Scalar>* tree_in(const KdTree<Scalar>& tree) {
  return &tree;
}
template <class Scalar>
[[nodiscard]] const KdTree<Scalar>* tree_in(const IndexedCloud<KdTree<Scalar>>& indexed) {
  return &indexed.search();
}

/// Leaves whose points get their normals together.
inline constexpr Index leaves_at_once = 8;

/// Normals of the points in leaves [begin, end), of which there are `leaves_at_once` or, at the end of the tree, fewer.
/// Returns how many of them got none.
template <class Scalar>
Index estimate_in_leaves(const KdTree<Scalar>& tree, const NormalWriter& writer, Index begin, Index end) {
  LeafNeighbors<KdTree<Scalar>> neighbors(tree, static_cast<std::size_t>(writer.options.neighbors),
                                          static_cast<Scalar>(writer.options.radius));
  PlaneLanes<Scalar> lanes;
  Index without = 0;
  for (Index leaf = begin; leaf < end; ++leaf)
    neighbors.search(leaf, [&](Index i, std::size_t count, auto&& offset) {
      lanes.add(i, count, offset);
      if (lanes.full()) without += writer.write(lanes);
    });
  return without + writer.write(lanes);
}

/// Normals of a tree's own points, which ask leaf by leaf. Returns how many of them got none.
template <class Scalar, Executor Exec>
Index estimate_in_leaves(const KdTree<Scalar>& tree, const NormalWriter& writer, const Exec& exec) {
  return reduce_chunks(
      exec, TreeLeaves(tree).count(), leaves_at_once, Index{0},
      [&](Index begin, Index end) { return estimate_in_leaves(tree, writer, begin, end); },
      [](Index left, Index right) { return left + right; });
}

/// Normals of any points, which ask one by one. Returns how many of them got none.
template <NearestNeighborSearch Search, Executor Exec>
Index estimate_one_by_one(const Search& search, const NormalWriter& writer, const Exec& exec) {
  constexpr Index grain = 256;
  using Scalar = typename Search::Scalar;
  const NormalOptions& options = writer.options;
  return reduce_chunks(
      exec, to_index(writer.cloud.size(), "cloud"), grain, Index{0},
      [&](Index begin, Index end) {
        std::vector<Neighbor<Scalar>> neighbors;
        PlaneLanes<Scalar> lanes;
        Index without = 0;
        for (Index i = begin; i < end; ++i) {
          const Eigen::Vector3f& at = writer.cloud.positions[static_cast<std::size_t>(i)];
          const Eigen::Matrix<Scalar, 3, 1> point(static_cast<Scalar>(at[0]), static_cast<Scalar>(at[1]),
                                                  static_cast<Scalar>(at[2]));
          if (options.neighbors > 0) {
            neighbors.resize(static_cast<std::size_t>(options.neighbors));
            neighbors.resize(
                static_cast<std::size_t>(search.knn(point, neighbors, static_cast<Scalar>(options.radius))));
          } else {
            search.within(point, static_cast<Scalar>(options.radius), neighbors);
          }
          lanes.add(i, neighbors.size(), [&](std::size_t j, std::size_t axis) {
            const auto row = static_cast<Eigen::Index>(axis);
            return static_cast<Scalar>(search.position(neighbors[j].index)[row] - point[row]);
          });
          if (lanes.full()) without += writer.write(lanes);
        }
        return without + writer.write(lanes);
      },
      [](Index left, Index right) { return left + right; });
}

/// `estimate_normals` over the tree of the cloud's own points.
template <class Scalar, Executor Exec>
NormalEstimates estimate_in_tree(PointCloud<float>& cloud, const KdTree<Scalar>& tree, const NormalOptions& options,
                                 const Eigen::Vector3d& viewpoint, const Exec& exec) {
  check(options);
  NormalEstimates estimates = no_normals(cloud, options);
  estimates.without_normal =
      tree.rejected() + estimate_in_leaves(tree, NormalWriter{cloud, estimates, options, viewpoint}, exec);
  return estimates;
}

}  // namespace detail

/// Fills `cloud.normals`: for each point the normal of the least-squares plane through its neighbours (Hoppe et al.
/// 1992), turned towards the viewpoint.
///
/// A point whose surroundings are no plane gets the zero vector: as a target of point-to-plane registration it then
/// counts for nothing. The result is the same to the bit for any executor.
/// @param cloud      n points, metres; NaN points get the zero vector.
/// @param search     over the points to take neighbours from, usually the cloud's own, in the same frame.
/// @param viewpoint  where the points were seen from, same frame, metres: the origin for a scan in the sensor's frame.
/// @throws std::invalid_argument if the options set neither a number of neighbours nor a radius.
template <NearestNeighborSearch Search, Executor Exec = Serial>
NormalEstimates estimate_normals(PointCloud<float>& cloud, const Search& search, const NormalOptions& options = {},
                                 const Eigen::Vector3d& viewpoint = Eigen::Vector3d::Zero(), const Exec& exec = {}) {
  const auto tree = detail::tree_in(search);
  if constexpr (std::is_pointer_v<decltype(tree)>) {
    if (LeafNeighbors<std::remove_cvref_t<decltype(*tree)>>(*tree, 1, 1).holds(cloud))
      return detail::estimate_in_tree(cloud, *tree, options, viewpoint, exec);
  }
  detail::check(options);
  NormalEstimates estimates = detail::no_normals(cloud, options);
  estimates.without_normal =
      detail::estimate_one_by_one(search, detail::NormalWriter{cloud, estimates, options, viewpoint}, exec);
  return estimates;
}

/// The same among the cloud's own points, over a tree that is built for it.
template <Executor Exec = Serial>
NormalEstimates estimate_normals(PointCloud<float>& cloud, const NormalOptions& options = {},
                                 const Eigen::Vector3d& viewpoint = Eigen::Vector3d::Zero(), const Exec& exec = {}) {
  return detail::estimate_in_tree(cloud, KdTree<float>(cloud), options, viewpoint, exec);
}

#ifdef CHAINSLAM_COMPILED
extern template NormalEstimates estimate_normals(PointCloud<float>&, const NormalOptions&, const Eigen::Vector3d&,
                                                 const Serial&);
extern template NormalEstimates estimate_normals(PointCloud<float>&, const NormalOptions&, const Eigen::Vector3d&,
                                                 const ThreadPool&);
#endif

/// For each point of a cloud those nearby, itself among them: searched for once, and kept for all that is computed from
/// them.
template <class Scalar>
class Neighborhoods {
 public:
  Neighborhoods() = default;

  /// @param cloud          n points, metres; one that is not finite has no neighbours.
  /// @param search         over the same points: its indices are the cloud's.
  /// @param radius         metres; neighbours are not farther.
  /// @param max_neighbors  the nearest of them, the point itself counted; 0: all.
  /// @throws std::invalid_argument if `radius` is not positive or `max_neighbors` negative.
  template <NearestNeighborSearch Search, Executor Exec = Serial>
  Neighborhoods(const PointCloud<float>& cloud, const Search& search, double radius, Index max_neighbors,
                const Exec& executor = {})
      : radius_(radius), size_(to_index(cloud.size(), "cloud")) {
    if (!(radius > 0) || max_neighbors < 0)
      throw std::invalid_argument("Neighborhoods: radius must be positive, max_neighbors not negative");
    blocks_ = std::vector<Block>(static_cast<std::size_t>(detail::count_chunks(size_, block_size)));
    executor.for_chunks(size_, block_size, [&](Index begin, Index end) {
      Block& block = blocks_[static_cast<std::size_t>(begin / block_size)];
      std::vector<Neighbor<Scalar>> found;
      for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
        find(search, cloud.positions[i], max_neighbors, found);
        block.neighbors.append(found);
        block.end.push_back(block.neighbors.size());
      }
    });
  }

  /// Points.
  [[nodiscard]] Index size() const { return size_; }
  [[nodiscard]] double radius() const { return radius_; }  ///< metres within which neighbours were sought
  /// The neighbours of point i.
  [[nodiscard]] std::span<const Neighbor<Scalar>> operator[](Index i) const {
    const Block& block = blocks_[static_cast<std::size_t>(i / block_size)];
    const Index place = i % block_size;
    return block.neighbors.range(place == 0 ? 0 : block.end[place - 1], block.end[place]);
  }

 private:
  static constexpr Index block_size = 256;
  struct Block {
    detail::Table<Neighbor<Scalar>> neighbors;  ///< point after point
    detail::Table<Offset> end;                  ///< of each point's
  };

  template <class Search>
  void find(const Search& search, const Eigen::Vector3f& at, Index max_neighbors,
            std::vector<Neighbor<Scalar>>& found) const {
    const Eigen::Matrix<Scalar, 3, 1> point(static_cast<Scalar>(at[0]), static_cast<Scalar>(at[1]),
                                            static_cast<Scalar>(at[2]));
    found.clear();
    if (!is_finite(at)) return;
    if (max_neighbors == 0) return search.within(point, static_cast<Scalar>(radius_), found);
    found.resize(static_cast<std::size_t>(max_neighbors));
    found.resize(static_cast<std::size_t>(search.knn(point, found, static_cast<Scalar>(radius_))));
  }

  double radius_ = 0;
  Index size_ = 0;
  std::vector<Block> blocks_;
};

template <NearestNeighborSearch Search, class... Rest>
Neighborhoods(const PointCloud<float>&, const Search&, Rest&&...) -> Neighborhoods<typename Search::Scalar>;

namespace detail {

/// Leaves those of a point's neighbours that the options name.
template <class Scalar>
void keep_wanted(Table<Neighbor<Scalar>>& neighbors, const NormalOptions& options) {
  const Index wanted = options.neighbors;
  if (wanted > 0 && neighbors.size() > wanted) {
    std::nth_element(neighbors.begin(), neighbors.begin() + wanted, neighbors.end(),
                     [](const auto& a, const auto& b) { return a.squared_distance < b.squared_distance; });
    neighbors.resize(wanted);
  }
  const double squared_radius = options.radius * options.radius;
  neighbors.keep_if([squared_radius](const Neighbor<Scalar>& neighbor) {
    return static_cast<double>(neighbor.squared_distance) <= squared_radius;
  });
}

}  // namespace detail

/// `estimate_normals` for a cloud whose neighbourhoods are known: no search. Of them it takes those that `options`
/// name, which cannot be farther than the neighbourhoods reach.
///
/// @throws std::invalid_argument if the neighbourhoods are not the cloud's.
template <class Scalar, Executor Exec = Serial>
NormalEstimates estimate_normals(PointCloud<float>& cloud, const Neighborhoods<Scalar>& neighborhoods,
                                 const NormalOptions& options,
                                 const Eigen::Vector3d& viewpoint = Eigen::Vector3d::Zero(),
                                 const Exec& executor = {}) {
  constexpr Index grain = 256;
  const Index size = to_index(cloud.size(), "cloud");
  if (neighborhoods.size() != size)
    throw std::invalid_argument("estimate_normals: the neighbourhoods are of another cloud");
  NormalEstimates estimates = detail::no_normals(cloud, options);
  const detail::NormalWriter writer{cloud, estimates, options, viewpoint};
  const auto estimate_chunk = [&](Index begin, Index end) {
    detail::Table<Neighbor<Scalar>> near;
    detail::PlaneLanes<float> lanes;
    Index without = 0;
    for (Index i = begin; i < end; ++i) {
      near.clear();
      near.append(neighborhoods[i]);
      detail::keep_wanted(near, options);
      const Eigen::Vector3f& center = cloud.positions[static_cast<std::size_t>(i)];
      lanes.add(i, near.all().size(), [&](std::size_t j, std::size_t axis) {
        const auto row = static_cast<Eigen::Index>(axis);
        return cloud.positions[static_cast<std::size_t>(near.data()[j].index)][row] - center[row];
      });
      if (lanes.full()) without += writer.write(lanes);
    }
    return without + writer.write(lanes);
  };
  estimates.without_normal = reduce_chunks(executor, size, grain, Index{0}, estimate_chunk,
                                           [](Index left, Index right) { return left + right; });
  return estimates;
}

}  // namespace chainslam
