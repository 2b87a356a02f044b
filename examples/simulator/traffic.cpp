#include "simulator/traffic.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "simulator/furniture.hpp"
#include "simulator/place.hpp"

namespace chainslam::simulator {

namespace {

World person(Rng rng) {
  World world;
  const double size = rng.uniform(0.88, 1.08);
  const Material clothes = rng.uniform() < 0.5 ? Material::wood : Material::pavement;
  const double stride = rng.uniform(0.05, 0.25);
  for (const double side : {-1.0, 1.0})
    add_cylinder(world, {}, {side * stride, side * 0.1, 0.0}, 0.09, 0.85 * size, clothes);
  add_cylinder(world, {}, {0.0, 0.0, 0.85 * size}, rng.uniform(0.17, 0.24), 0.65 * size, clothes);
  add_cylinder(world, {}, {0.0, 0.0, 1.5 * size}, 0.1, 0.25 * size, Material::wood);
  return world;
}

World vehicle(Rng rng) {
  World world;
  if (rng.uniform() < 0.9) {
    add_car(world, {}, rng);
    return world;
  }
  const double half_length = rng.uniform(3.5, 5.5);  // a lorry or a bus
  add_box(world, {}, {-half_length, -1.2, 0.6}, {half_length - 0.3, 1.2, rng.uniform(2.8, 3.4)}, Material::car);
  add_box(world, {}, {half_length - 0.3, -1.1, 0.5}, {half_length, 1.1, 2.6}, Material::glass);
  for (const double x : {-0.6 * half_length, 0.6 * half_length})
    add_box(world, {}, {x - 0.5, -1.15, 0.0}, {x + 0.5, 1.15, 0.95}, Material::road);
  return world;
}

/// How far something reaches from the z axis, and up, metres.
struct Reach {
  float radius = 0.0F;
  float height = 0.0F;
};

/// Marks all as moving.
Reach set_in_motion(World& world) {
  Reach reach;
  for (Box& box : world.boxes) {
    box.presence = Presence::moving;
    reach.radius = std::max(reach.radius, box.center.head<2>().norm() + box.half_extents.head<2>().norm());
    reach.height = std::max(reach.height, bounds(box).high.z());
  }
  for (Cylinder& cylinder : world.cylinders) {
    cylinder.presence = Presence::moving;
    reach.radius = std::max(reach.radius, cylinder.base.head<2>().norm() + cylinder.radius);
    reach.height = std::max(reach.height, bounds(cylinder).high.z());
  }
  return reach;
}

/// Whether a ray passes through the ball around somebody before `limit`.
bool comes_near(const Halted& one, const Ray& ray, float limit) {
  const Eigen::Vector3f offset = one.middle - ray.origin;
  const float along = offset.dot(ray.direction);
  return offset.squaredNorm() - along * along < one.radius * one.radius && along > -one.radius &&
         along - one.radius < limit;
}

}  // namespace

Halted::Halted(const Passing& passing, float part)
    : shape(passing.shape),
      foot(passing.at(part)),
      R_own_map(passing.R_map_own.transpose()),
      middle(foot + 0.5F * passing.height * Eigen::Vector3f::UnitZ()) {
  constexpr float room = 0.05F;  // metres: what stands a little below the foot, and rounding
  radius = std::hypot(passing.radius, 0.5F * passing.height) + room;
}

std::optional<RayHit> meet(std::span<const Halted> near, const Ray& ray) {
  std::optional<RayHit> found;
  float nearest = ray.max_distance;
  for (const Halted& one : near) {
    if (!comes_near(one, ray, nearest)) continue;
    const Ray own{one.R_own_map * (ray.origin - one.foot), one.R_own_map * ray.direction, nearest};
    const auto try_all = [&](const auto& shapes) {
      for (const auto& shape : shapes) {
        const float distance = distance_to(shape, own);
        if (distance >= nearest) continue;
        nearest = distance;
        found = RayHit{distance, one.R_own_map.transpose() * normal_at(shape, own, distance), shape.material,
                       shape.presence};
      }
    };
    try_all(one.shape->boxes);
    try_all(one.shape->cylinders);
  }
  return found;
}

Traffic::Traffic(const TrafficOptions& options, const Drive& drive, const Rng& rng) : options_(options) {
  add_companions(rng.fork(0));
  add_crowd(rng.fork(3));
  if (options.between_oncoming > 0.0) add_oncoming(drive, rng.fork(1));
  if (options.between_people > 0.0) add_people(drive, rng.fork(2));
  for (Mover& mover : movers_) {
    const Reach reach = set_in_motion(mover.shape);
    mover.radius = reach.radius;
    mover.height = reach.height;
  }
}

void Traffic::add_companions(const Rng& rng) {
  for (Index i = 0; i < options_.companions; ++i) {
    Rng draw = rng.fork(static_cast<std::uint64_t>(i));
    const bool beside = options_.beside > 0.0 && i % 3 == 2;
    const Index place = i - i / 3;  // in the own lane: ahead, behind, ahead, ...
    const double gap =
        beside ? draw.uniform(-6.0, 10.0) : (place % 2 == 0 ? 1.0 : -1.0) * (options_.gap + 9.0 * (place / 2));
    const double side = options_.on_both_sides && (i / 3) % 2 == 1 ? -1.0 : 1.0;
    movers_.push_back({.shape = vehicle(draw.fork(0)),
                       .along = gap,
                       .aside = beside ? side * options_.beside : 0.0,
                       .swing = beside ? 8.0 : 0.2 * gap,
                       .period = draw.uniform(30.0, 70.0),
                       .companion = true});
  }
}

void Traffic::add_crowd(const Rng& rng) {
  for (Index i = 0; i < options_.crowd; ++i) {
    Rng draw = rng.fork(static_cast<std::uint64_t>(i));
    const double bearing = draw.uniform(0.0, 2.0 * std::numbers::pi);
    const double distance = draw.uniform(1.0, 4.0);
    movers_.push_back({.shape = person(draw.fork(0)),
                       .along = distance * std::cos(bearing),
                       .aside = distance * std::sin(bearing),
                       .swing = 0.15 * distance,
                       .period = draw.uniform(6.0, 20.0),
                       .companion = true});
  }
}

void Traffic::add_oncoming(const Drive& drive, Rng rng) {
  for (double time = rng.uniform() * options_.between_oncoming; time < drive.duration();
       time += options_.between_oncoming * rng.uniform(0.5, 1.5))
    movers_.push_back({.shape = vehicle(rng.fork(movers_.size())),
                       .along = drive.driven(time),
                       .speed = -rng.uniform(6.0, 13.0),
                       .met = time,
                       .aside = options_.oncoming_lane});
}

void Traffic::add_people(const Drive& drive, Rng rng) {
  for (double time = rng.uniform() * options_.between_people; time < drive.duration();
       time += options_.between_people * rng.uniform(0.5, 1.5)) {
    const double side = rng.uniform() < 0.5 ? 1.0 : -1.0;
    const double way = rng.uniform() < 0.5 ? 1.0 : -1.0;
    movers_.push_back({.shape = person(rng.fork(movers_.size())),
                       .along = drive.driven(time) + rng.uniform(-10.0, 10.0),
                       .speed = way * rng.uniform(0.9, 1.7),
                       .met = time,
                       .aside = options_.lane + side * rng.uniform(options_.least_aside, options_.most_aside)});
  }
}

double Traffic::Mover::distance(const Drive& drive, double time) const {
  if (companion) return drive.driven(time) + along + swing * std::sin(2.0 * std::numbers::pi * time / period);
  return along + speed * (time - met);
}

std::vector<Passing> Traffic::during(const Drive& drive, const Terrain& terrain, double from, double to) const {
  std::vector<Passing> near;
  const LanePath& path = drive.path();
  const double here = drive.driven(from);
  for (const Mover& mover : movers_) {
    const double distance = mover.distance(drive, from);
    if (std::abs(distance - here) > options_.reach || distance < 0.0 || distance > path.length()) continue;
    const auto position = [&](double along) {
      const PathPoint at(path, along);
      const double heading = at.of(path.headings);
      const Eigen::Vector2d p =
          at.of(path.positions) + mover.aside * Eigen::Vector2d(-std::sin(heading), std::cos(heading));
      return Eigen::Vector3d(p.x(), p.y(), terrain.height(p));
    };
    const double heading = PathPoint(path, distance).of(path.headings) + (mover.speed < 0.0 ? std::numbers::pi : 0.0);
    near.push_back({.shape = &mover.shape,
                    .radius = mover.radius,
                    .height = mover.height,
                    .start = position(distance).cast<float>(),
                    .stop = position(mover.distance(drive, to)).cast<float>(),
                    .R_map_own = yawed(heading).cast<float>()});
  }
  return near;
}

}  // namespace chainslam::simulator
