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
struct RayCaster::Walk {
  std::array<Index, 2> cell{};
  float enter;  ///< where the ray enters `cell`
  float leave;  ///< where it leaves it

  /// @param low, high  the cells that may be visited, both included.
  Walk(const Ray& ray, const Eigen::Vector2f& origin, float size, std::array<Index, 2> low, std::array<Index, 2> high,
       float start, float end)
      : enter(start), leave(end), origin_(origin), size_(size), end_(end), low_(low), high_(high) {
    for (int axis = 0; axis < 2; ++axis) {
      const auto i = static_cast<std::size_t>(axis);
      const float at = (ray.origin[axis] + start * ray.direction[axis] - origin[axis]) / size;
      cell[i] = std::clamp(floor_index(at), low[i], high[i]);
      from_[i] = ray.origin[axis];
      inverse_[i] = ray.direction[axis] != 0.0F ? 1.0F / ray.direction[axis] : 0.0F;
      find_boundary(i);
    }
    leave = std::min({next_[0], next_[1], end_});
  }

  /// Moves on to the next cell; false at the end of the ray or of the grid.
  bool advance() {
    if (leave >= end_) return false;
    const std::size_t axis = next_[0] < next_[1] ? 0 : 1;
    cell[axis] += inverse_[axis] > 0.0F ? 1 : -1;
    if (cell[axis] < low_[axis] || cell[axis] > high_[axis]) return false;
    enter = leave;
    find_boundary(axis);
    leave = std::max(enter, std::min({next_[0], next_[1], end_}));
    return true;
  }

 private:
  /// From the cell's index, not from the boundary before: rounding does not add up.
  void find_boundary(std::size_t axis) {
    if (inverse_[axis] == 0.0F) {
      next_[axis] = infinite_distance;
      return;
    }
    const Index line = cell[axis] + (inverse_[axis] > 0.0F ? 1 : 0);
    const float boundary = origin_[static_cast<Eigen::Index>(axis)] + static_cast<float>(line) * size_;
    next_[axis] = (boundary - from_[axis]) * inverse_[axis];
  }

  Eigen::Vector2f origin_;
  float size_;
  float end_;
  std::array<Index, 2> low_;
  std::array<Index, 2> high_;
  std::array<float, 2> from_{};
  std::array<float, 2> inverse_{};
  std::array<float, 2> next_{};
};

/// A ray's direction, made ready for slab tests (Williams et al. 2005).
struct RayCaster::Reciprocal {
  Eigen::Vector3f of_direction;

  explicit Reciprocal(const Ray& ray) {
    constexpr float parallel = 1e30F;  // in place of an infinity, whose product with zero is no number
    for (int axis = 0; axis < 3; ++axis)
      of_direction[axis] = std::abs(ray.direction[axis]) > 1.0F / parallel ? 1.0F / ray.direction[axis] : parallel;
  }

  /// Whether the ray can meet what lies in the bounds before `limit`.
  [[nodiscard]] bool reaches(const Ray& ray, const Bounds& bounds, float limit) const {
    const Eigen::Array3f a = (bounds.low - ray.origin).array() * of_direction.array();
    const Eigen::Array3f b = (bounds.high - ray.origin).array() * of_direction.array();
    const Eigen::Array3f enter = a.min(b);
    const Eigen::Array3f leave = a.max(b);
    const float first = std::max({enter.x(), enter.y(), enter.z(), 0.0F});
    return first <= std::min({leave.x(), leave.y(), leave.z(), limit});
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
    cell.begin = cell.end = to_index(total, "the number of shapes in all cells");
    total += count;
  }
  entries_.resize(total);
  for_each_shape([&](Kind kind, std::size_t shape, const Bounds& b) {
    for_each_cell(b, [&](Cell& cell) {
      entries_[static_cast<std::size_t>(cell.end++)] = {
          {b.low.array() - margin, b.high.array() + margin}, to_index(shape), kind};
      cell.shapes_top = std::max(cell.shapes_top, b.high.z() + margin);
    });
  });
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

std::optional<RayHit> RayCaster::cast(const Ray& ray) const {
  detail::Span inside{.enter = 0.0F, .leave = ray.max_distance};
  const Eigen::Vector2f half =
      0.5F * cell_size_ * Eigen::Vector2f(static_cast<float>(columns_), static_cast<float>(rows_));
  for (int axis = 0; axis < 2; ++axis)
    inside.clip_to_slab(ray.origin[axis] - origin_[axis] - half[axis], ray.direction[axis], half[axis]);
  if (inside.enter > inside.leave) return std::nullopt;

  const Reciprocal reciprocal(ray);
  Nearest nearest{.distance = ray.max_distance};
  Walk walk(ray, origin_, cell_size_, {0, 0}, {columns_ - 1, rows_ - 1}, inside.enter, inside.leave);
  do {
    const Cell& cell = cells_[static_cast<std::size_t>(walk.cell[1]) * static_cast<std::size_t>(columns_) +
                              static_cast<std::size_t>(walk.cell[0])];
    const float z_enter = ray.origin.z() + walk.enter * ray.direction.z();
    const float z_leave = ray.origin.z() + walk.leave * ray.direction.z();
    const float lowest = std::min(z_enter, z_leave);
    if (lowest <= cell.shapes_top) meet_shapes(ray, reciprocal, cell, z_enter, z_leave, nearest);
    if (lowest <= cell.ground_top) meet_ground(ray, walk.cell[0], walk.cell[1], walk.enter, walk.leave, nearest);
  } while (nearest.distance > walk.leave && walk.advance());
  if (nearest.kind == Kind::none) return std::nullopt;
  return describe(ray, nearest);
}

void RayCaster::meet_shapes(const Ray& ray, const Reciprocal& reciprocal, const Cell& cell, float z_enter,
                            float z_leave, Nearest& nearest) const {
  const float low = std::min(z_enter, z_leave);
  const float high = std::max(z_enter, z_leave);
  for (Index i = cell.begin; i < cell.end; ++i) {
    const Entry& entry = entries_[static_cast<std::size_t>(i)];
    if (entry.bounds.low.z() > high || entry.bounds.high.z() < low) continue;
    if (!reciprocal.reaches(ray, entry.bounds, nearest.distance)) continue;
    const auto shape = static_cast<std::size_t>(entry.shape);
    const float distance = entry.kind == Kind::box        ? distance_to(world_.boxes[shape], ray)
                           : entry.kind == Kind::cylinder ? distance_to(world_.cylinders[shape], ray)
                                                          : distance_to(world_.ellipsoids[shape], ray);
    if (distance < nearest.distance) nearest = {distance, entry.shape, entry.kind};
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
    meet_ground_cell(ray, walk.cell[0], walk.cell[1], walk.enter, walk.leave, nearest);
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
