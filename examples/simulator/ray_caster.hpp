#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "simulator/world.hpp"

namespace chainslam::simulator {

/// Where a ray meets the world.
struct RayHit {
  float distance;          ///< metres along the ray
  Eigen::Vector3f normal;  ///< unit length, world frame, on the side that is seen
  Material material;
  Presence presence = Presence::lasting;
};

/// Finds what rays meet first.
///
/// A uniform grid over x and y, walked cell by cell (Amanatides and Woo 1987). A cell lists the shapes above it with
/// their bounds, four side by side, so that most are passed over by comparisons alone; inside a cell the ground is
/// walked sample by sample, and only where the ray dips below the cell's highest sample. The answer is that of testing
/// every shape and every triangle. Reading from several threads at once is safe.
class RayCaster {
 public:
  /// @param cell_size  metres; rounded up to whole samples of the ground.
  /// @throws std::invalid_argument if the ground's columns do not have the stated lengths, or the world is empty.
  explicit RayCaster(World world, float cell_size = 3.0F);

  /// The first surface met from outside within the ray's maximum distance. A ray that starts inside a solid, or below
  /// the ground, does not see that solid's inner side.
  [[nodiscard]] std::optional<RayHit> cast(const Ray& ray) const;

  [[nodiscard]] const World& world() const { return world_; }

 private:
  enum class Kind : std::uint8_t { none, box, cylinder, ellipsoid, ground };

  /// Four shapes with their bounds, a little too wide, side by side: they are tested together.
  struct Quad {
    std::array<Eigen::Array4f, 3> low;  ///< along x, y, z; where a place is free, high z lies below low z
    std::array<Eigen::Array4f, 3> high;
    std::array<Index, 4> shape{};
    std::array<Kind, 4> kind{};
  };
  struct Slabs;
  struct Cell {
    Index begin = 0;  ///< in `quads_`
    Index end = 0;
    float shapes_top = -infinite_distance;
    float ground_top = -infinite_distance;
  };
  struct Nearest {
    float distance;
    Index shape = -1;  ///< for the ground: twice the lower left sample, plus one for the upper left triangle
    Kind kind = Kind::none;
  };
  struct Walk;

  void lay_grid(float cell_size);
  void list_shapes();
  void find_ground_tops();
  template <class Visit>
  void for_each_shape(const Visit& visit) const;
  template <class Visit>
  void for_each_cell(const Bounds& bounds, const Visit& visit);

  [[nodiscard]] const Cell& cell_at(const Walk& walk) const;
  /// Walks on from the cell at hand, unless something in it is as high as the ray, to the next that holds such a thing;
  /// false if there is none before `limit`.
  [[nodiscard]] bool walk_to_something(const Ray& ray, float limit, Walk& walk) const;
  void meet_shapes(const Ray& ray, const Slabs& slabs, const Cell& cell, float z_enter, float z_leave,
                   Nearest& nearest) const;
  void meet_ground(const Ray& ray, Index column, Index row, float enter, float leave, Nearest& nearest) const;
  void meet_ground_cell(const Ray& ray, Index column, Index row, float enter, float leave, Nearest& nearest) const;
  [[nodiscard]] RayHit describe(const Ray& ray, const Nearest& nearest) const;

  World world_;
  Eigen::Vector2f origin_ = Eigen::Vector2f::Zero();
  float cell_size_ = 1.0F;
  Index samples_per_cell_ = 1;
  Index first_sample_x_ = 0;  ///< ground column at the grid's origin; negative where shapes reach beyond the ground
  Index first_sample_y_ = 0;
  Index columns_ = 0;
  Index rows_ = 0;
  std::vector<Cell> cells_;
  std::vector<Quad> quads_;
};

}  // namespace chainslam::simulator
