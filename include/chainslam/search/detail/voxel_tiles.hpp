#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <stdexcept>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/passes.hpp"
#include "chainslam/search/detail/tile_gaps.hpp"
#include "chainslam/search/detail/voxel_block.hpp"
#include "chainslam/search/detail/voxel_place.hpp"
#include "chainslam/search/detail/voxel_tile_store.hpp"
#include "chainslam/search/downsampling.hpp"

namespace chainslam::detail {

/// At most one point a voxel, in tiles: what is kept, erased and found.
///
/// Meeting an occupied voxel costs one look into the hash, two masks and the voxel's state; many points at once are
/// inserted in passes, so that these are not waited for one by one. Searching is exact at any distance: tiles around
/// the query by the hash, farther ones one after the other.
template <class ScalarType, int Dim, class Policy>
class VoxelTiles {
 public:
  using Scalar = ScalarType;
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  using Options = Policy;

  explicit VoxelTiles(const Policy& policy)
      : policy_(policy), inverse_voxel_(1.0 / policy.voxel_size), tile_size_(policy.voxel_size * edge * edge) {
    require_valid(policy);
    if (!is_finite(tile_size_)) throw std::invalid_argument("VoxelMap: voxel_size must be positive and finite");
  }

  [[nodiscard]] const Options& options() const { return policy_; }
  [[nodiscard]] Index size() const { return store_.size(); }
  [[nodiscard]] Index rejected() const { return rejected_; }
  [[nodiscard]] std::size_t memory() const { return store_.memory(); }
  [[nodiscard]] bool contains(Index i) const { return store_.contains(i); }
  [[nodiscard]] Vector position(Index i) const { return store_.runs().position(i); }

  bool insert(const Vector& p) { return put(p, {voxel_place(p, inverse_voxel_)}); }
  /// Inserts `count` points in their order, `point_at(i)` each.
  template <class PointAt>
  void insert(Index count, PointAt&& point_at) {
    const auto locate = [&](Index i) {
      Where at{voxel_place(point_at(i), inverse_voxel_)};
      if (at.voxel.there()) at.block = store_.find_block(at.voxel.cell);
      if (at.block >= 0) store_.fetch(at.block);
      return at;
    };
    const auto fetch = [&](const Where& at) {
      if (at.block >= 0) store_.fetch(at.block, place_in_parent(at.voxel.cell));
    };
    in_passes(count, locate, fetch, [&](Index i, const Where& at) { put(point_at(i), at); });
  }

  bool erase(Index i) {
    if (!contains(i)) return false;
    store_.filter(store_.runs().owner(i), [i](Index other, const Vector&) { return other == i; });
    return true;
  }

  template <class Predicate>
  Index erase_if(Predicate&& leaves) {
    const Index before = size();
    for (std::size_t t = 0; t < store_.tiles(); ++t)
      for (std::uint64_t blocks = store_.tile(t).blocks; blocks != 0; blocks &= blocks - 1)
        store_.filter(store_.tile(t).block[static_cast<std::size_t>(std::countr_zero(blocks))], leaves);
    return before - size();
  }

  template <class Region>
  Index erase_region(const Region& region) {
    const Index before = size();
    for_each_tile_near(region, [&](std::size_t t) {
      const Tile& tile = store_.tile(t);
      const Overlap whole = region.overlap(cell_box<Dim>(tile.cell, tile_size_));
      if (whole == Overlap::outside) return;
      for (std::uint64_t blocks = tile.blocks; blocks != 0; blocks &= blocks - 1) {
        const int place = std::countr_zero(blocks);
        const Index owner = tile.block[static_cast<std::size_t>(place)];
        const Overlap part = whole == Overlap::inside
                                 ? whole
                                 : region.overlap(cell_box<Dim>(child(tile.cell, place), tile_size_ / edge));
        if (part == Overlap::inside)
          store_.drop(owner);
        else if (part == Overlap::partly)
          store_.filter(owner, [&](Index, const Vector& p) { return region.contains(p); });
      }
    });
    return before - size();
  }

  template <class Region, class Visit>
  void visit_region(const Region& region, Visit&& visit) const {
    for_each_tile_near(region, [&](std::size_t t) {
      const Tile& tile = store_.tile(t);
      if (region.overlap(cell_box<Dim>(tile.cell, tile_size_)) == Overlap::outside) return;
      store_.for_each_point(tile, [&](Index i, const Vector& p) {
        if (region.contains(p)) visit(i, p);
      });
    });
  }

  template <class Visit>
  void for_each_point(Visit&& visit) const {
    for (std::size_t t = 0; t < store_.tiles(); ++t) store_.for_each_point(store_.tile(t), visit);
  }

  [[nodiscard]] Eigen::AlignedBox<Scalar, Dim> bounding_box() const {
    Eigen::AlignedBox<Scalar, Dim> bounds;
    for (std::size_t t = 0; t < store_.tiles(); ++t) {
      if (bounds.template cast<double>().contains(cell_box<Dim>(store_.tile(t).cell, tile_size_))) continue;
      store_.for_each_point(store_.tile(t), [&](Index, const Vector& p) { bounds.extend(p); });
    }
    return bounds;
  }

  template <class Collector>
  void search(const Vector& query, Collector& found) const {
    const Eigen::Vector3d scaled = in_voxels(query);
    const std::optional<Cell> cell = cell_of(scaled);
    const Eigen::Vector3d in_tiles = scaled / (edge * edge);
    if (!cell) {
      if (is_finite(query)) search_far(query, in_tiles, std::nullopt, 0, found);
      return;
    }
    const Cell center = parent(parent(*cell));
    if (const Index own = store_.find_tile(center); own >= 0)
      search_from(tile(own), place_in_parent(parent(*cell)), query, in_tiles, found);
    const Gaps gaps(in_tiles, center, tile_size_);
    constexpr int last_ring = 2;
    for (int ring = 1; ring <= last_ring; ++ring) {
      if (!(gaps.beyond(ring) < found.bound())) return;
      search_ring(ring, query, in_tiles, center, gaps, found);
    }
    if (gaps.beyond(last_ring + 1) < found.bound()) search_far(query, in_tiles, center, last_ring, found);
  }

 private:
  using Store = VoxelTileStore<Scalar, Dim, Policy::state_bits>;
  using Tile = typename Store::Tile;
  using Block = typename Store::Block;
  using Gaps = TileGaps<Scalar, Dim>;
  using Slabs = BlockSlabs<Scalar, Dim>;
  static constexpr int edge = VoxelBlock::edge;

  [[nodiscard]] const Tile& tile(Index t) const { return store_.tile(static_cast<std::size_t>(t)); }
  [[nodiscard]] Eigen::Vector3d in_voxels(const Vector& p) const {
    Eigen::Vector3d scaled = zeros<Eigen::Vector3d>();
    for (int i = 0; i < Dim; ++i) scaled[i] = static_cast<double>(p[i]) * inverse_voxel_;
    return scaled;
  }

  // ---- inserting ----

  /// A point's voxel, and its block; -1 if that has not been looked for, or has yet to be made.
  struct Where {
    VoxelPlace voxel;
    Index block = -1;
  };

  /// Returns whether the point has become one of the map.
  bool put(const Vector& p, const Where& at) {
    if (!at.voxel.there()) {
      ++rejected_;
      return false;
    }
    const Index owner = at.block >= 0 ? at.block : store_.block_at(at.voxel.cell);
    const int voxel = place_in_parent(at.voxel.cell);
    const Block& block = store_.block(owner);
    if (Store::occupied(block, voxel)) return meet(Store::index(block, voxel), p, at.voxel);
    store_.add(owner, voxel, p, policy_.first_state(at.voxel.offset));
    return true;
  }

  /// A point that came to the voxel of the i-th. Returns whether it has taken its place.
  bool meet(Index i, const Vector& p, const VoxelPlace& at) {
    unsigned state = store_.runs().state(i);
    if (policy_.judge(state, at.offset) != VoxelVerdict::meet) return false;
    if constexpr (requires(Vector & held) { policy_.meet(state, held, 0.0, p, 0.0); }) {
      const Vector old = position(i);
      Vector held = old;
      const bool changes = policy_.meet(state, held, voxel_place(old, inverse_voxel_).offset, p, at.offset);
      const bool replaced = changes && held == p;
      // A mean may be rounded out of its voxel; then the point stays where it was.
      const bool stays = !changes || (!replaced && !(voxel_place(held, inverse_voxel_).cell == at.cell));
      store_.runs().set(i, stays ? old : held, state);
      return replaced;
    }
    return false;
  }

  // ---- visiting ----

  /// Calls `visit(t)` for the tiles that may hold points of a region: through the hash where it has bounds and they are
  /// few, otherwise for all.
  template <class Region, class Visit>
  void for_each_tile_near(const Region& region, Visit&& visit) const {
    if constexpr (requires { region.bounds(); }) {
      const auto look = [&](const Cell& cell) {
        if (const Index t = store_.find_tile(cell); t >= 0) visit(static_cast<std::size_t>(t));
      };
      if (for_each_cell_near<Dim>(region.bounds(), tile_size_, store_.tiles(), look)) return;
    }
    for (std::size_t t = 0; t < store_.tiles(); ++t) visit(t);
  }

  // ---- searching ----

  template <class Collector>
  void search_blocks(const Tile& tile, std::uint64_t blocks, const Slabs& slabs, const Vector& query,
                     Collector& found) const {
    for (blocks &= slabs.within(found.bound()); blocks != 0; blocks &= blocks - 1) {
      const int place = std::countr_zero(blocks);
      if (!(slabs.distance(place) < found.bound())) continue;
      const Block& block = store_.block(tile, place);
      store_.runs().search(block.first, std::popcount(block.occupied), query, found);
    }
  }

  /// The query's own tile: first its own block, then those around it.
  template <class Collector>
  void search_from(const Tile& tile, int place, const Vector& query, const Eigen::Vector3d& in_tiles,
                   Collector& found) const {
    const Slabs slabs = Gaps(in_tiles, tile.cell, tile_size_).slabs();
    const std::uint64_t own = std::uint64_t{1} << place, around = VoxelBlock::around(place);
    search_blocks(tile, tile.blocks & own, slabs, query, found);
    search_blocks(tile, tile.blocks & around & ~own, slabs, query, found);
    search_blocks(tile, tile.blocks & ~around, slabs, query, found);
  }

  /// The tiles `ring` steps away.
  template <class Collector>
  void search_ring(int ring, const Vector& query, const Eigen::Vector3d& in_tiles, const Cell& center, const Gaps& gaps,
                   Collector& found) const {
    const int layers = Dim == 3 ? ring : 0;
    for (int dz = -layers; dz <= layers; ++dz) {
      const Scalar gap_z = Dim == 3 ? gaps.along(2, dz) : 0;
      if (!(gap_z < found.bound())) continue;
      for (int dy = -ring; dy <= ring; ++dy) {
        const Scalar gap_yz = gap_z + gaps.along(1, dy);
        if (!(gap_yz < found.bound())) continue;
        const bool whole_row = std::abs(dz) == ring || std::abs(dy) == ring;
        for (int dx = -ring; dx <= ring; dx += whole_row ? 1 : 2 * ring) {
          if (!(gap_yz + gaps.along(0, dx) < found.bound())) continue;
          const Index t = store_.find_tile(shifted(center, dx, dy, dz));
          if (t >= 0) search_tile(tile(t), query, in_tiles, found);
        }
      }
    }
  }

  template <class Collector>
  void search_tile(const Tile& tile, const Vector& query, const Eigen::Vector3d& in_tiles, Collector& found) const {
    search_blocks(tile, tile.blocks, Gaps(in_tiles, tile.cell, tile_size_).slabs(), query, found);
  }

  /// All tiles but those at most `ring` steps from the center, in shells whose radius doubles.
  template <class Collector>
  void search_far(const Vector& query, const Eigen::Vector3d& in_tiles, const std::optional<Cell>& center, int ring,
                  Collector& found) const {
    const auto size = static_cast<Scalar>(tile_size_);
    Scalar from = -1;
    for (Scalar to = 4 * static_cast<Scalar>((ring + 1) * (ring + 1)) * size * size; from < found.bound();) {
      bool any_beyond = false;
      for (std::size_t t = 0; t < store_.tiles(); ++t) {
        const Tile& tile = store_.tile(t);
        if (tile.blocks == 0 || (center && steps_apart(*center, tile.cell) <= ring)) continue;
        const Scalar distance = Gaps(in_tiles, tile.cell, tile_size_).to_tile();
        any_beyond = any_beyond || distance >= to;
        if (distance >= from && distance < to && distance < found.bound()) search_tile(tile, query, in_tiles, found);
      }
      if (!any_beyond) return;
      from = to;
      to = 4 * to;
    }
  }

  Policy policy_;
  double inverse_voxel_;
  double tile_size_;
  Store store_;
  Index rejected_ = 0;
};

}  // namespace chainslam::detail
