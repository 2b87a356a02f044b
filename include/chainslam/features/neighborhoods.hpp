#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/features/detail/plane_lanes.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

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
