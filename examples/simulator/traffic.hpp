#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/random.hpp"
#include "simulator/drive.hpp"
#include "simulator/ray_caster.hpp"
#include "simulator/terrain.hpp"
#include "simulator/world.hpp"

namespace chainslam::simulator {

/// Who else is on the way. All keep to the line that the vehicle itself will drive or has driven.
struct TrafficOptions {
  Index companions = 0;           ///< vehicles that travel along, ahead, behind and beside
  double gap = 13.0;              ///< from the vehicle to those next ahead and behind, metres
  double beside = 0.0;            ///< how far to the left those beside are; 0: there is no lane for them, metres
  bool on_both_sides = false;     ///< ... every other of them to the right instead
  Index crowd = 0;                ///< people who walk along, within a few metres on all sides
  double between_oncoming = 0.0;  ///< mean time between vehicles that come the other way, seconds; 0: none
  double oncoming_lane = 3.4;     ///< how far to the left they pass, metres
  double between_people = 0.0;    ///< mean time between people met or overtaken, seconds; 0: none
  double lane = 1.7;              ///< right of the street's middle: the vehicle's own, metres
  double least_aside = 5.6;       ///< how far from the street's middle people walk, metres: from this ...
  double most_aside = 7.2;        ///< ... to this
  double reach = 100.0;           ///< nobody is farther along the way than this, metres
};

/// Somebody who moves, while the sensor turns once.
struct Passing {
  const World* shape;         ///< boxes and cylinders in a frame of its own: x ahead, z up, standing on the origin
  float radius;               ///< of all of it about the frame's z axis, metres
  float height;               ///< of all of it, metres
  Eigen::Vector3f start;      ///< where that frame is when the turn begins, ...
  Eigen::Vector3f stop;       ///< ... and when it ends; map frame, metres
  Eigen::Matrix3f R_map_own;  ///< halfway

  [[nodiscard]] Eigen::Vector3f at(float part) const { return start + part * (stop - start); }
};

/// Somebody who moves, held still for one firing.
struct Halted {
  const World* shape;
  Eigen::Vector3f foot;  ///< the shape's origin; map frame, metres
  Eigen::Matrix3f R_own_map;
  Eigen::Vector3f middle;  ///< of a ball around all of it
  float radius;            ///< of that ball, metres

  /// @param part  of the turn that has passed, 0 to 1.
  Halted(const Passing& passing, float part);
};

/// Where a ray meets those who move, if it meets any of them before it meets what stands.
[[nodiscard]] std::optional<RayHit> meet(std::span<const Halted> near, const Ray& ray);

/// Vehicles and people around a drive.
class Traffic {
 public:
  /// Nobody.
  Traffic() = default;
  Traffic(const TrafficOptions& options, const Drive& drive, const Rng& rng);

  /// All that are near between two times, seconds. `drive` is the one given at the start; all stand on `terrain`.
  [[nodiscard]] std::vector<Passing> during(const Drive& drive, const Terrain& terrain, double from, double to) const;

 private:
  struct Mover {
    World shape;
    float radius = 0.0F;
    float height = 0.0F;
    double along = 0.0;   ///< metres: of the vehicle's place on the path for companions, else of the path at `met`
    double speed = 0.0;   ///< along the path, m/s; companions have the vehicle's
    double met = 0.0;     ///< seconds
    double aside = 0.0;   ///< to the left of the path, metres
    double swing = 0.0;   ///< companions fall back and catch up by this, metres, ...
    double period = 1.0;  ///< ... in this time, seconds
    bool companion = false;

    [[nodiscard]] double distance(const Drive& drive, double time) const;
  };

  void add_companions(const Rng& rng);
  void add_crowd(const Rng& rng);
  void add_oncoming(const Drive& drive, Rng rng);
  void add_people(const Drive& drive, Rng rng);

  TrafficOptions options_;
  std::vector<Mover> movers_;
};

}  // namespace chainslam::simulator
