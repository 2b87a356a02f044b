#include "simulator/ray_caster.hpp"

#include <array>
#include <stdexcept>
#include <utility>

namespace chainslam::simulator {

namespace {

/// Shapes are listed, and z compared, this much too generously: more than single precision loses at a kilometre.
constexpr float margin = 2e-3F;

Index floor_index(float value) { return static_cast<Index>(std::floor(value)); }

}  // namespace

/// A walk through the cells of a uniform grid along a ray, in units of the ray's length.
///
/// Both axes are moved at every step, one of them by nothing: which one is hard to foresee, and a branch taken wrongly
/// costs more than the step.
struct RayCaster::Walk {
  Index x = 0;  ///< the cell
  Index y = 0;
  float enter;  ///< where the ray enters it
  float leave;  ///< where it leaves it

  /// @param low, high  the cells that may be visited, both included.
  Walk(const Ray& ray, const Eigen::Vector2f& origin, float size, std::array<Index, 2> low, std::array<Index, 2> high,
       float start, float end)
      : enter(start), end_(end), low_(low), span_{of_steps(high[0] - low[0]), of_steps(high[1] - low[1])} {
    const auto first = [&](std::size_t i) {
      const auto axis = static_cast<Eigen::Index>(i);
      const float at = (ray.origin[axis] + start * ray.direction[axis] - origin[axis]) / size;
      return std::clamp(floor_index(at), low[i], high[i]);
    };
    x = first(0);
    y = first(1);
    along_x_ = Axis(ray.origin.x(), ray.direction.x(), origin.x(), size, x);
    along_y_ = Axis(ray.origin.y(), ray.direction.y(), origin.y(), size, y);
    leave = std::min({along_x_.next, along_y_.next, end_});
  }

  /// Moves on to the next cell; false at the end of the ray or of the grid.
  bool advance() {
    if (leave >= end_) return false;
    const bool is_x = along_x_.next < along_y_.next;
    x += is_x ? along_x_.step : 0;
    y += is_x ? 0 : along_y_.step;
    if (of_steps(x - low_[0]) > span_[0] || of_steps(y - low_[1]) > span_[1]) return false;
    along_x_.advance(is_x);
    along_y_.advance(!is_x);
    enter = leave;
    leave = std::max(enter, std::min({along_x_.next, along_y_.next, end_}));
    return true;
  }

 private:
  /// Where the ray crosses the grid's lines across one axis.
  struct Axis {
    float next = 0.0F;   ///< the crossing that ends the cell, ...
    float after = 0.0F;  ///< ... and the one behind
    Index step = 0;

    Axis() = default;
    Axis(float ray_origin, float direction, float grid_origin, float cell_size, Index cell)
        : step(direction > 0.0F ? 1 : -1),
          from(ray_origin),
          inverse(direction != 0.0F ? 1.0F / direction : 0.0F),
          origin(grid_origin),
          size(cell_size),
          line(static_cast<float>(cell + (direction > 0.0F ? 1 : 0))),
          line_step(static_cast<float>(step)) {
      next = direction != 0.0F ? crossing(line) : infinite_distance;
      after = crossing(line + line_step);
    }

    void advance(bool moves) {
      next = moves ? after : next;
      line = moves ? line + line_step : line;
      after = crossing(line + line_step);
    }

    /// From the line's number, not from the crossing before: rounding does not add up.
    [[nodiscard]] float crossing(float number) const { return (origin + number * size - from) * inverse; }

    float from = 0.0F, inverse = 0.0F, origin = 0.0F, size = 0.0F;
    float line = 0.0F;  ///< number of the line at `next`, a whole one
    float line_step = 0.0F;
  };

  /// A number of cells; below none is beyond all.
  static std::uint32_t of_steps(Index steps) { return static_cast<std::uint32_t>(steps); }

  float end_;
  std::array<Index, 2> low_;
  std::array<std::uint32_t, 2> span_;
  Axis along_x_, along_y_;
};

/// A ray, made ready for slab tests (Williams et al. 2005) of four shapes at a time.
struct RayCaster::Slabs {
  Eigen::Vector3f origin;
  Eigen::Vector3f inverse;  ///< of the direction

  explicit Slabs(const Ray& ray) : origin(ray.origin) {
    constexpr float parallel = 1e30F;  // in place of an infinity, whose product with zero is no number
    for (int axis = 0; axis < 3; ++axis)
      inverse[axis] = std::abs(ray.direction[axis]) > 1.0F / parallel ? 1.0F / ray.direction[axis] : parallel;
  }

  /// Where the ray enters the bounds, not before 0. @param leave  where it leaves them.
  [[nodiscard]] Eigen::Array4f enter(const Quad& quad, Eigen::Array4f& leave) const {
    Eigen::Array4f first = Eigen::Array4f::Zero();
    leave.setConstant(infinite_distance);
    for (int axis = 0; axis < 3; ++axis) {
      const auto i = static_cast<std::size_t>(axis);
      const Eigen::Array4f a = (quad.low[i] - origin[axis]) * inverse[axis];
      const Eigen::Array4f b = (quad.high[i] - origin[axis]) * inverse[axis];
      first = first.max(a.min(b));
      leave = leave.min(a.max(b));
    }
    return first;
  }
};

RayCaster::RayCaster(World world, float cell_size) : world_(std::move(world)) {
  const HeightField& ground = world_.ground;
  const std::size_t samples = static_cast<std::size_t>(ground.columns) * static_cast<std::size_t>(ground.rows);
  if (ground.heights.size() != samples || ground.materials.size() != samples)
    throw std::invalid_argument("RayCaster: ground.heights and ground.materials must have columns * rows elements");
  lay_grid(cell_size);
  list_shapes();
  find_ground_tops();
}

template <class Visit>
void RayCaster::for_each_shape(const Visit& visit) const {
  for (std::size_t i = 0; i < world_.boxes.size(); ++i) visit(Kind::box, i, bounds(world_.boxes[i]));
  for (std::size_t i = 0; i < world_.cylinders.size(); ++i) visit(Kind::cylinder, i, bounds(world_.cylinders[i]));
  for (std::size_t i = 0; i < world_.ellipsoids.size(); ++i) visit(Kind::ellipsoid, i, bounds(world_.ellipsoids[i]));
}

template <class Visit>
void RayCaster::for_each_cell(const Bounds& bounds, const Visit& visit) {
  const auto cell_of = [&](float value, int axis, Index count) {
    return std::clamp(floor_index((value - origin_[axis]) / cell_size_), Index{0}, count - 1);
  };
  const Index left = cell_of(bounds.low.x() - margin, 0, columns_);
  const Index right = cell_of(bounds.high.x() + margin, 0, columns_);
  const Index upper = cell_of(bounds.high.y() + margin, 1, rows_);
  for (Index row = cell_of(bounds.low.y() - margin, 1, rows_); row <= upper; ++row)
    for (Index column = left; column <= right; ++column)
      visit(cells_[static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
                   static_cast<std::size_t>(column)]);
}

void RayCaster::lay_grid(float cell_size) {
  const HeightField& ground = world_.ground;
  Eigen::Vector2f low = Eigen::Vector2f::Constant(infinite_distance);
  Eigen::Vector2f high = -low;
  const auto include = [&](const Eigen::Vector2f& a, const Eigen::Vector2f& b) {
    low = low.cwiseMin(a);
    high = high.cwiseMax(b);
  };
  const Eigen::Vector2f around = Eigen::Vector2f::Constant(2.0F * margin);
  for_each_shape(
      [&](Kind, std::size_t, const Bounds& b) { include(b.low.head<2>() - around, b.high.head<2>() + around); });
  if (ground.columns > 1 && ground.rows > 1) {
    const Eigen::Vector2f size(static_cast<float>(ground.columns - 1), static_cast<float>(ground.rows - 1));
    include(ground.origin, ground.origin + ground.spacing * size);
  }
  if (!(low.x() < high.x())) throw std::invalid_argument("RayCaster: the world is empty");

  samples_per_cell_ = std::max(Index{1}, static_cast<Index>(std::ceil(cell_size / ground.spacing)));
  cell_size_ = static_cast<float>(samples_per_cell_) * ground.spacing;
  // The grid's lines fall on the ground's, so that a ground cell belongs to one cell.
  first_sample_x_ = floor_index((low.x() - ground.origin.x()) / ground.spacing);
  first_sample_y_ = floor_index((low.y() - ground.origin.y()) / ground.spacing);
  origin_.x() = ground.origin.x() + static_cast<float>(first_sample_x_) * ground.spacing;
  origin_.y() = ground.origin.y() + static_cast<float>(first_sample_y_) * ground.spacing;
  columns_ = floor_index((high.x() - origin_.x()) / cell_size_) + 1;
  rows_ = floor_index((high.y() - origin_.y()) / cell_size_) + 1;
  cells_.resize(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_));
}

void RayCaster::list_shapes() {
  for_each_shape([&](Kind, std::size_t, const Bounds& b) {
    for_each_cell(b, [](Cell& cell) { ++cell.end; });  // counts first, places after
  });
  std::size_t total = 0;
  for (Cell& cell : cells_) {
    const auto count = static_cast<std::size_t>(cell.end);
    cell.begin = to_index(total, "the number of shapes in all cells");
    cell.end = 0;  // shapes listed so far
    total += (count + 3) / 4;
  }
  const Eigen::Array4f nowhere = Eigen::Array4f::Constant(1e30F);
  const Eigen::Array4f zero = Eigen::Array4f::Zero();
  quads_.assign(total, Quad{.low = {zero, zero, nowhere}, .high = {zero, zero, -nowhere}});
  for_each_shape([&](Kind kind, std::size_t shape, const Bounds& b) {
    for_each_cell(b, [&](Cell& cell) {
      Quad& quad = quads_[static_cast<std::size_t>(cell.begin + cell.end / 4)];
      const auto place = static_cast<std::size_t>(cell.end++ % 4);
      for (int axis = 0; axis < 3; ++axis) {
        const auto i = static_cast<std::size_t>(axis);
        quad.low[i][static_cast<Index>(place)] = b.low[axis] - margin;
        quad.high[i][static_cast<Index>(place)] = b.high[axis] + margin;
      }
      quad.shape[place] = to_index(shape);
      quad.kind[place] = kind;
      cell.shapes_top = std::max(cell.shapes_top, b.high.z() + margin);
    });
  });
  for (Cell& cell : cells_) cell.end = cell.begin + (cell.end + 3) / 4;
}

void RayCaster::find_ground_tops() {
  const HeightField& ground = world_.ground;
  for (Index row = 0; row < ground.rows; ++row) {
    for (Index column = 0; column < ground.columns; ++column) {
      const float height = ground.heights[ground.at(column, row)] + margin;
      const float x = ground.origin.x() + static_cast<float>(column) * ground.spacing;
      const float y = ground.origin.y() + static_cast<float>(row) * ground.spacing;
      // A sample on a line between cells, wherever rounding puts it, counts for all of them: the bounds are widened.
      for_each_cell({{x, y, height}, {x, y, height}},
                    [&](Cell& cell) { cell.ground_top = std::max(cell.ground_top, height); });
    }
  }
}

const RayCaster::Cell& RayCaster::cell_at(const Walk& walk) const {
  return cells_[static_cast<std::size_t>(walk.y) * static_cast<std::size_t>(columns_) +
                static_cast<std::size_t>(walk.x)];
}

bool RayCaster::walk_to_something(const Ray& ray, float limit, Walk& walk) const {
  const float z = ray.origin.z(), rise = ray.direction.z();
  for (Walk here = walk;;) {  // a copy, which stays in registers
    const Cell& cell = cell_at(here);
    if (std::min(z + here.enter * rise, z + here.leave * rise) <= std::max(cell.shapes_top, cell.ground_top)) {
      walk = here;
      return true;
    }
    if (limit <= here.leave || !here.advance()) return false;
  }
}

std::optional<RayHit> RayCaster::cast(const Ray& ray) const {
  detail::Span inside{.enter = 0.0F, .leave = ray.max_distance};
  const Eigen::Vector2f half =
      0.5F * cell_size_ * Eigen::Vector2f(static_cast<float>(columns_), static_cast<float>(rows_));
  for (int axis = 0; axis < 2; ++axis)
    inside.clip_to_slab(ray.origin[axis] - origin_[axis] - half[axis], ray.direction[axis], half[axis]);
  if (inside.enter > inside.leave) return std::nullopt;

  const Slabs slabs(ray);
  Nearest nearest{.distance = ray.max_distance};
  Walk walk(ray, origin_, cell_size_, {0, 0}, {columns_ - 1, rows_ - 1}, inside.enter, inside.leave);
  while (walk_to_something(ray, nearest.distance, walk)) {
    const Cell& cell = cell_at(walk);
    const float z_enter = ray.origin.z() + walk.enter * ray.direction.z();
    const float z_leave = ray.origin.z() + walk.leave * ray.direction.z();
    const float lowest = std::min(z_enter, z_leave);
    if (lowest <= cell.shapes_top) meet_shapes(ray, slabs, cell, z_enter, z_leave, nearest);
    if (lowest <= cell.ground_top) meet_ground(ray, walk.x, walk.y, walk.enter, walk.leave, nearest);
    if (nearest.distance <= walk.leave || !walk.advance()) break;
  }
  if (nearest.kind == Kind::none) return std::nullopt;
  return describe(ray, nearest);
}

void RayCaster::meet_shapes(const Ray& ray, const Slabs& slabs, const Cell& cell, float z_enter, float z_leave,
                            Nearest& nearest) const {
  const float low = std::min(z_enter, z_leave);
  const float high = std::max(z_enter, z_leave);
  for (Index i = cell.begin; i < cell.end; ++i) {
    const Quad& quad = quads_[static_cast<std::size_t>(i)];
    Eigen::Array4f leave;
    const Eigen::Array4f enter = slabs.enter(quad, leave);
    // Not below zero where the ray passes through the bounds, and they are as high as it is in this cell.
    const Eigen::Array4f room = (leave - enter).min((quad.high[2] - low).min(high - quad.low[2]));
    if (room.maxCoeff() < 0.0F) continue;
    for (std::size_t k = 0; k < 4; ++k) {
      const auto lane = static_cast<Eigen::Index>(k);
      if (!(room[lane] >= 0.0F) || enter[lane] > nearest.distance) continue;
      const auto shape = static_cast<std::size_t>(quad.shape[k]);
      const float distance = quad.kind[k] == Kind::box        ? distance_to(world_.boxes[shape], ray)
                             : quad.kind[k] == Kind::cylinder ? distance_to(world_.cylinders[shape], ray)
                                                              : distance_to(world_.ellipsoids[shape], ray);
      if (distance < nearest.distance) nearest = {distance, quad.shape[k], quad.kind[k]};
    }
  }
}

void RayCaster::meet_ground(const Ray& ray, Index column, Index row, float enter, float leave, Nearest& nearest) const {
  const HeightField& ground = world_.ground;
  const Index x = first_sample_x_ + column * samples_per_cell_;
  const Index y = first_sample_y_ + row * samples_per_cell_;
  const std::array<Index, 2> low{std::max(Index{0}, x), std::max(Index{0}, y)};
  const std::array<Index, 2> high{std::min(ground.columns - 1, x + samples_per_cell_) - 1,
                                  std::min(ground.rows - 1, y + samples_per_cell_) - 1};
  if (low[0] > high[0] || low[1] > high[1]) return;
  detail::Span over_ground{.enter = enter, .leave = leave};  // the cell may reach beyond the ground
  for (int axis = 0; axis < 2; ++axis) {
    const auto i = static_cast<std::size_t>(axis);
    const float half = 0.5F * ground.spacing * static_cast<float>(high[i] + 1 - low[i]);
    const float middle = ground.origin[axis] + 0.5F * ground.spacing * static_cast<float>(high[i] + 1 + low[i]);
    over_ground.clip_to_slab(ray.origin[axis] - middle, ray.direction[axis], half + 1e-4F);
  }
  if (over_ground.enter > over_ground.leave) return;
  Walk walk(ray, ground.origin, ground.spacing, low, high, over_ground.enter, over_ground.leave);
  do {
    meet_ground_cell(ray, walk.x, walk.y, walk.enter, walk.leave, nearest);
  } while (nearest.distance > walk.leave && walk.advance());
}

void RayCaster::meet_ground_cell(const Ray& ray, Index column, Index row, float enter, float leave,
                                 Nearest& nearest) const {
  const HeightField& ground = world_.ground;
  const std::size_t lower_left = ground.at(column, row);
  const float h00 = ground.heights[lower_left];
  const float h10 = ground.heights[lower_left + 1];
  const float h01 = ground.heights[ground.at(column, row + 1)];
  const float h11 = ground.heights[ground.at(column + 1, row + 1)];
  const float lowest = ray.origin.z() + (ray.direction.z() < 0.0F ? leave : enter) * ray.direction.z();
  if (lowest > std::max({h00, h10, h01, h11}) + margin) return;

  const float scale = 1.0F / ground.spacing;
  const float u0 = (ray.origin.x() - ground.origin.x()) * scale - static_cast<float>(column);
  const float v0 = (ray.origin.y() - ground.origin.y()) * scale - static_cast<float>(row);
  const float du = ray.direction.x() * scale;
  const float dv = ray.direction.y() * scale;
  const auto meet_triangle = [&](float from, float to) {
    const float middle = 0.5F * (from + to);
    const bool upper = v0 + middle * dv > u0 + middle * du;
    const float slope_u = upper ? h11 - h01 : h10 - h00;
    const float slope_v = upper ? h01 - h00 : h11 - h10;
    const auto above = [&](float t) {
      return ray.origin.z() + t * ray.direction.z() - (h00 + (u0 + t * du) * slope_u + (v0 + t * dv) * slope_v);
    };
    const float start = above(from);
    const float stop = above(to);
    // From above only; `margin` closes the seam between two cells against rounding.
    if (stop > 0.0F || start < -margin) return;
    const float distance = start <= 0.0F ? from : from + (to - from) * start / (start - stop);
    if (distance < nearest.distance)
      nearest = {distance, 2 * static_cast<Index>(lower_left) + (upper ? 1 : 0), Kind::ground};
  };
  const float diagonal = (v0 - u0) / (du - dv);  // not a number, or infinite, along the diagonal
  if (diagonal > enter && diagonal < leave) {
    meet_triangle(enter, diagonal);
    meet_triangle(diagonal, leave);
  } else {
    meet_triangle(enter, leave);
  }
}

RayHit RayCaster::describe(const Ray& ray, const Nearest& nearest) const {
  const auto shape = static_cast<std::size_t>(nearest.shape);
  const auto of = [&](const auto& solid) {
    return RayHit{nearest.distance, normal_at(solid, ray, nearest.distance), solid.material, solid.presence};
  };
  switch (nearest.kind) {
    case Kind::box:
      return of(world_.boxes[shape]);
    case Kind::cylinder:
      return of(world_.cylinders[shape]);
    case Kind::ellipsoid:
      return of(world_.ellipsoids[shape]);
    default:
      break;
  }
  const HeightField& ground = world_.ground;
  const std::size_t lower_left = shape / 2;
  const std::size_t upper_left = lower_left + static_cast<std::size_t>(ground.columns);
  const bool upper = shape % 2 == 1;
  const std::size_t left = upper ? upper_left : lower_left;
  const std::size_t foot = upper ? lower_left : lower_left + 1;
  const float slope_u = ground.heights[left + 1] - ground.heights[left];
  const float slope_v = ground.heights[foot + static_cast<std::size_t>(ground.columns)] - ground.heights[foot];
  return {nearest.distance, Eigen::Vector3f(-slope_u, -slope_v, ground.spacing).normalized(),
          ground.materials[lower_left]};
}

}  // namespace chainslam::simulator
