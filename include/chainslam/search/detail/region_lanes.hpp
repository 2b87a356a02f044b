#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>

#include "chainslam/search/detail/box_node.hpp"
#include "chainslam/search/detail/point_runs.hpp"
#include "chainslam/search/detail/regions.hpp"

namespace chainslam::detail {

/// How the children of a node lie to a region: bit i is child i. Those in neither mask lie outside.
struct LaneOverlap {
  unsigned inside = 0;
  unsigned partly = 0;
};

template <class Scalar, int Dim>
[[nodiscard]] Eigen::AlignedBox<double, Dim> wide_box(const Bounds<Scalar, Dim>& box) {
  Eigen::AlignedBox<double, Dim> wide;
  for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
    wide.min()[static_cast<Eigen::Index>(axis)] = static_cast<double>(box.low[axis]);
    wide.max()[static_cast<Eigen::Index>(axis)] = static_cast<double>(box.high[axis]);
  }
  return wide;
}

template <class Scalar, int Dim>
[[nodiscard]] BoxRegion<Scalar, Dim> region_of(const Bounds<Scalar, Dim>& box) {
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  return {{Vector(box.low.data()), Vector(box.high.data())}};
}

[[nodiscard]] inline std::uint32_t first_lanes(std::size_t count) {
  return static_cast<std::uint32_t>((std::uint64_t{1} << count) - 1);
}

template <class Region, class Scalar, int Dim>
[[nodiscard]] LaneOverlap overlap_lanes(const Region& region, const BoxNode<Scalar, Dim>& node) {
  LaneOverlap lanes;
  for (std::size_t lane = 0; lane < node.count; ++lane) {
    const Overlap overlap = region.overlap(wide_box(node.box(lane)));
    lanes.inside |= static_cast<unsigned>(overlap == Overlap::inside) << lane;
    lanes.partly |= static_cast<unsigned>(overlap == Overlap::partly) << lane;
  }
  return lanes;
}

/// All children at once.
template <class Scalar, int Dim>
[[nodiscard]] LaneOverlap overlap_lanes(const BoxRegion<Scalar, Dim>& region, const BoxNode<Scalar, Dim>& node) {
  unsigned inside = first_lanes(node.count), touching = inside;
  for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
    const Pack<Scalar> low = Pack<Scalar>::load(node.low[axis].data());
    const Pack<Scalar> high = Pack<Scalar>::load(node.high[axis].data());
    const Scalar least = region.box.min()[static_cast<Eigen::Index>(axis)];
    const Scalar most = region.box.max()[static_cast<Eigen::Index>(axis)];
    inside &= low.at_least(least) & high.at_most(most);
    touching &= low.at_most(most) & high.at_least(least);
  }
  return {inside, touching & ~inside};
}

template <class Region, class Scalar, int Dim>
[[nodiscard]] LaneOverlap overlap_lanes(const Complement<Region>& region, const BoxNode<Scalar, Dim>& node) {
  const LaneOverlap inner = overlap_lanes(region.region, node);
  return {first_lanes(node.count) & ~(inner.inside | inner.partly), inner.partly};
}

template <class Scalar, int Dim>
[[nodiscard]] LaneOverlap overlap_lanes(const PointRegion<Scalar, Dim>& region, const BoxNode<Scalar, Dim>& node) {
  const LaneOverlap at = overlap_lanes(BoxRegion<Scalar, Dim>{{region.p, region.p}}, node);
  return {0, at.inside | at.partly};
}

template <class Scalar, int Dim>
[[nodiscard]] LaneOverlap overlap_lanes(const Everywhere&, const BoxNode<Scalar, Dim>& node) {
  return {first_lanes(node.count), 0};
}

template <class Scalar, int Dim>
[[nodiscard]] LaneOverlap overlap_lanes(const Somewhere&, const BoxNode<Scalar, Dim>& node) {
  return {0, first_lanes(node.count)};
}

/// Which of the first `count` points of a leaf lie in a region: bit i is lane i.
template <class Region, class Runs>
[[nodiscard]] std::uint32_t contained_lanes(const Region& region, const Runs& runs, RunLink run, std::uint32_t count) {
  std::uint32_t lanes = 0;
  for (std::uint32_t lane = 0; lane < count; ++lane)
    lanes |= std::uint32_t{region.contains(runs.position(run.slot(lane)))} << lane;
  return lanes;
}

template <class Scalar, int Dim, class Runs>
[[nodiscard]] std::uint32_t contained_lanes(const BoxRegion<Scalar, Dim>& region, const Runs& runs, RunLink run,
                                            std::uint32_t count) {
  std::uint32_t lanes = 0;
  const PointGroup<Scalar, Dim>* const groups = runs.groups(run);
  for (std::uint32_t g = 0; g < run.groups(); ++g) {
    unsigned inside = first_lanes(pack_width);
    for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
      const Pack<Scalar> p = Pack<Scalar>::load(groups[g].at[axis].data());
      inside &= p.at_least(region.box.min()[static_cast<Eigen::Index>(axis)]) &
                p.at_most(region.box.max()[static_cast<Eigen::Index>(axis)]);
    }
    lanes |= inside << (pack_width * g);
  }
  return lanes & first_lanes(count);
}

template <class Runs>
[[nodiscard]] std::uint32_t contained_lanes(const Somewhere&, const Runs&, RunLink, std::uint32_t) {
  return 0;  // none for certain
}

template <class Region, class Runs>
[[nodiscard]] std::uint32_t contained_lanes(const Complement<Region>& region, const Runs& runs, RunLink run,
                                            std::uint32_t count) {
  return first_lanes(count) & ~contained_lanes(region.region, runs, run, count);
}

}  // namespace chainslam::detail
