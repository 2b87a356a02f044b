#include "simulator/error_sources.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <map>
#include <numbers>
#include <set>
#include <stdexcept>
#include <string>

#include "simulator/place.hpp"
#include "simulator/preset_description.hpp"
#include "simulator/spinning_lidar.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::simulator {
namespace {

/// Rests in the middle of a world.
class Parked final : public VehicleMotion {
 public:
  [[nodiscard]] double duration() const override { return 3600.0; }
  [[nodiscard]] Motion motion(double) const override {
    return {.T_map_body = SE3d(),
            .velocity_map = Eigen::Vector3d::Zero(),
            .acceleration_map = Eigen::Vector3d::Zero(),
            .rate_body = Eigen::Vector3d::Zero()};
  }
};

/// Goes straight ahead at 10 m/s.
class Straight final : public VehicleMotion {
 public:
  [[nodiscard]] double duration() const override { return 60.0; }
  [[nodiscard]] Motion motion(double time) const override {
    Motion motion = Parked().motion(time);
    motion.T_map_body = SE3d(SO3d(), {10.0 * time, 0.0, 0.0});
    motion.velocity_map.x() = 10.0;
    return motion;
  }
};

LidarOptions ideal_lidar() {
  LidarOptions options = with_only_errors(preset_named("ideal", ""), "").lidar;
  options.firings_per_revolution = 360;
  options.T_body_lidar = SE3d();
  return options;
}

/// Four walls 10 m away.
World walls(Material material) {
  World world;
  for (const double side : {-1.0, 1.0}) {
    add_box(world, {}, {side * 10.5 - 0.5, -12.0, -20.0}, {side * 10.5 + 0.5, 12.0, 20.0}, material);
    add_box(world, {}, {-12.0, side * 10.5 - 0.5, -20.0}, {12.0, side * 10.5 + 0.5, 20.0}, material);
  }
  return world;
}

using Ranges = std::map<std::pair<int, int>, double>;  // by firing and laser, metres

Ranges ranges_of(const LidarOptions& options, const RayCaster& world, Index revolution) {
  Ranges ranges;
  for (const LidarReturn& hit : SpinningLidar(options, Rng(1)).turn(world, Parked(), revolution).returns)
    ranges[{hit.firing, hit.laser}] = static_cast<double>(hit.position.norm());
  return ranges;
}

/// What a change of the options adds to the ranges of rays that return in both cases.
std::vector<double> added_by(const LidarOptions& options, const RayCaster& world, Index revolution = 0) {
  const Ranges without = ranges_of(ideal_lidar(), world, revolution);
  std::vector<double> added;
  for (const auto& [ray, range] : ranges_of(options, world, revolution))
    if (const auto there = without.find(ray); there != without.end()) added.push_back(range - there->second);
  REQUIRE(added.size() > 5000);
  return added;
}

double mean(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

}  // namespace

TEST_SUITE("simulator/error_sources") {
  TEST_CASE("each error source is named once, and hard presets have a size for each") {
    std::set<std::string_view> names;
    for (const ErrorSource& source : error_sources()) {
      CAPTURE(source.name);
      CHECK(names.insert(source.name).second);
      CHECK(!source.summary.empty());
      CHECK(!source.reference.empty());
      bool differs = false;
      for (const char* name : {"nclt-hard", "mars-hard"}) {
        const Preset hard = *preset(name, PresetSize::large);
        const Preset without = without_errors(hard, source.name);
        differs = differs || options_hash(without) != options_hash(hard);
        // What is left out and put back makes the same world.
        Preset again = without;
        source.copy(again, hard);
        if (source.name != "open-stretches" && source.name != "passages")  // which come in another order
          CHECK(options_hash(again) == options_hash(hard));
      }
      CHECK(differs);
    }
  }

  TEST_CASE("all error sources by name are all of a preset's, and none leaves none") {
    const Preset hard = *preset("mars-hard", PresetSize::small);
    CHECK(options_hash(with_only_errors(hard, "all")) == options_hash(hard));
    CHECK(options_hash(without_errors(hard, "")) == options_hash(hard));
    CHECK(options_hash(without_errors(hard, "all")) == options_hash(with_only_errors(hard, "")));
    std::string names = error_source_names();
    std::erase(names, ' ');
    CHECK(options_hash(without_errors(hard, names)) == options_hash(without_errors(hard, "all")));
    CHECK_THROWS_WITH_AS(static_cast<void>(without_errors(hard, "wind,rust")),
                         doctest::Contains("there is no error source rust; there are: laser-angles, "),
                         std::invalid_argument);
  }

  TEST_CASE("a description names every option, and its hash changes with any of them") {
    const Preset preset_at_hand = *preset("nclt-hard", PresetSize::small);
    const std::string text = describe_options(preset_at_hand);
    CHECK(text.find(". =") == std::string::npos);  // a value without a name
    CHECK(text.find("lidar.wind = 0.15\n") != std::string::npos);
    CHECK(text.find("drive.corners.bend = 15\n") != std::string::npos);
    Preset changed = preset_at_hand;
    changed.sessions[1].day += 1;
    CHECK(options_hash(changed) != options_hash(preset_at_hand));
    changed = preset_at_hand;
    changed.gnss.antenna_body.z() += 1e-12;
    CHECK(options_hash(changed) != options_hash(preset_at_hand));
    changed = preset_at_hand;
    changed.summary = "another";
    CHECK(options_hash(changed) == options_hash(preset_at_hand));
  }

  TEST_CASE("all lasers can be off by the same angle") {
    // A floor 10 m below: a ray that really points half a degree higher reaches farther.
    World world;
    add_box(world, {}, {-90.0, -90.0, -11.0}, {90.0, 90.0, -10.0}, Material::metal);
    const RayCaster caster(std::move(world));
    LidarOptions options = ideal_lidar();
    const Ranges exact = ranges_of(options, caster, 0);
    options.elevation_offset_deg = 0.5;
    int compared = 0;
    for (const auto& [ray, range] : ranges_of(options, caster, 0)) {
      const auto there = exact.find(ray);
      if (there == exact.end()) continue;
      const double angle = std::asin(10.0 / there->second);
      CHECK(range == doctest::Approx(10.0 / std::sin(angle - 0.5 * std::numbers::pi / 180.0)).epsilon(1e-3));
      ++compared;
    }
    CHECK(compared > 3000);
  }

  TEST_CASE("a circle off its centre is read too far on ahead, too little behind, and right at the sides") {
    const RayCaster world(walls(Material::metal));
    const auto azimuths_of = [&](const LidarOptions& options) {
      std::map<std::pair<int, int>, double> azimuths;
      for (const LidarReturn& hit : SpinningLidar(options, Rng(1)).turn(world, Parked(), 0).returns)
        azimuths[{hit.firing, hit.laser}] =
            std::atan2(static_cast<double>(hit.position.y()), static_cast<double>(hit.position.x()));
      return azimuths;
    };
    LidarOptions options = ideal_lidar();
    const auto exact = azimuths_of(options);
    options.encoder_eccentricity_deg = 0.5;
    const auto off = azimuths_of(options);
    REQUIRE(off.size() == exact.size());  // nothing else is changed
    CHECK(off.size() > 5000);
    for (const auto& [ray, azimuth] : off) {
      const double truth = exact.at(ray);
      const double error = std::remainder(azimuth - truth, 2.0 * std::numbers::pi);
      // A firing's lasers go off up to 0.2 degrees of the turn after each other, and its error is that of their first.
      CHECK(std::abs(error - 0.5 * std::numbers::pi / 180.0 * std::cos(truth)) < 1e-4);
    }
    // Only angles are: ranges stay.
    for (const double added : added_by(options, world)) CHECK(std::abs(added) < 1e-5);
  }

  TEST_CASE("lasers drift as the sensor warms up") {
    const RayCaster world(walls(Material::wall));
    LidarOptions options = ideal_lidar();
    options.range_drift = 0.02;
    options.warm_up_time = 100.0;
    for (const double error : added_by(options, world, 0)) CHECK(error == doctest::Approx(0.0));
    for (const double error : added_by(options, world, 1000)) {  // after 100 s
      CHECK(std::abs(error) > 0.5 * 0.02 * (1.0 - std::exp(-1.0)) - 1e-5);
      CHECK(std::abs(error) < 1.5 * 0.02 * (1.0 - std::exp(-1.0)) + 1e-5);
    }
    options.range_drift = 0.0;
    options.elevation_drift_deg = 0.5;
    for (const double error : added_by(options, world, 0)) CHECK(error == doctest::Approx(0.0));
    double most = 0.0;
    for (const double error : added_by(options, world, 36000)) most = std::max(most, std::abs(error));
    CHECK(most > 0.02);  // 0.5 degrees at 30 degrees of elevation on a wall 10 m away: up to 6 cm
    CHECK(most < 0.12);
  }

  TEST_CASE("what returns little light is measured farther") {
    LidarOptions options = ideal_lidar();
    options.intensity_bias = 0.02;
    const double bright = mean(added_by(options, RayCaster(walls(Material::metal))));
    const double dark = mean(added_by(options, RayCaster(walls(Material::road))));
    CHECK(bright >= 0.0);
    CHECK(dark > bright + 0.005);
    CHECK(dark < 0.02);
  }

  TEST_CASE("panes show behind them what they mirror") {
    // A pane 10 m ahead; a wall 5 m behind the sensor: mirrored, it seems to be 10 + 15 m ahead.
    World world;
    add_box(world, {}, {10.0, -30.0, -30.0}, {10.2, 30.0, 30.0}, Material::glass);
    add_box(world, {}, {-6.0, -200.0, -200.0}, {-5.0, 200.0, 200.0}, Material::wall);
    const RayCaster caster(std::move(world));
    LidarOptions options = ideal_lidar();
    options.mirrored = 1.0;
    int ghosts = 0;
    for (const LidarReturn& hit : SpinningLidar(options, Rng(1)).turn(caster, Parked(), 0).returns) {
      if (hit.position.x() < 0.0F) continue;
      ++ghosts;
      CHECK(hit.position.x() == doctest::Approx(25.0).epsilon(1e-3));
      CHECK(hit.presence == Presence::moving);
    }
    CHECK(ghosts > 500);
    options.mirrored = 0.0;
    for (const LidarReturn& hit : SpinningLidar(options, Rng(1)).turn(caster, Parked(), 0).returns)
      if (hit.position.x() > 0.0F) CHECK(hit.position.x() == doctest::Approx(10.0).epsilon(1e-3));
  }

  TEST_CASE("leaves sway, walls do not") {
    LidarOptions options = ideal_lidar();
    options.wind = 0.2;
    for (const double error : added_by(options, RayCaster(walls(Material::wall)))) CHECK(error == 0.0);
    // How deep rays get into the leaves is drawn alike with wind and without.
    double most = 0.0;
    for (const double error : added_by(options, RayCaster(walls(Material::foliage))))
      most = std::max(most, std::abs(error));
    CHECK(most > 0.15);
    CHECK(most < 0.2 * std::numbers::sqrt2 + 1e-3);
  }

  TEST_CASE("rain echoes from near, and dims what is far") {
    LidarOptions options = ideal_lidar();
    const RayCaster world(walls(Material::wall));
    const auto dry = ranges_of(options, world, 0).size();
    options.drops = 0.01;
    int echoes = 0;
    for (const auto& [ray, range] : ranges_of(options, world, 0)) echoes += range < 9.9;
    // Over 10 m: the integral of 0.01 (1 - x / 20) = 7.5 %; less what is nearer than the least range.
    CHECK(echoes / static_cast<double>(dry) == doctest::Approx(0.066).epsilon(0.2));
    options.drops = 0.0;
    options.dimming = 0.2;
    CHECK(ranges_of(options, world, 0).size() < dry * 9 / 10);
  }

  TEST_CASE("scans and packets are lost as often as is said, and a scan that is lost is not handed on") {
    const RayCaster world(walls(Material::wall));
    LidarOptions options = ideal_lidar();
    const auto all = SpinningLidar(options, Rng(1)).turn(world, Parked(), 0).returns.size();
    options.lost_packets = 0.25;
    std::size_t left = 0;
    for (Index index = 0; index < 20; ++index)
      left += SpinningLidar(options, Rng(1)).turn(world, Parked(), index).returns.size();
    CHECK(static_cast<double>(left) / static_cast<double>(20 * all) == doctest::Approx(0.75).epsilon(0.05));
    options.lost_packets = 0.0;
    options.lost_scans = 0.25;
    const SpinningLidar lidar(options, Rng(1));
    Index arrived = 0;
    for (Index index = 0; index < 1000; ++index) {
      arrived += lidar.arrives(index);
      if (index < 20) CHECK(lidar.turn(world, Parked(), index).returns.empty() == !lidar.arrives(index));
    }
    CHECK(arrived / 1000.0 == doctest::Approx(0.75).epsilon(0.06));

    Preset town = *preset("town-small");
    town.lidar.firings_per_revolution = 24;
    town.lidar.lost_scans = 0.25;
    TownDrive drive(town, 1);
    Index scans = 0;
    while (const auto packet = drive.next()) scans += std::holds_alternative<LidarScan>(*packet);
    CHECK(scans < drive.scan_count() * 9 / 10);
    CHECK(scans > drive.scan_count() / 2);
  }

  TEST_CASE("stamps of scans drift and jitter by what is said") {
    World world;
    add_box(world, {}, {100.0, -500.0, -500.0}, {101.0, 500.0, 500.0}, Material::metal);
    const RayCaster caster(std::move(world));
    LidarOptions options = ideal_lidar();
    const auto first_x = [&](const LidarOptions& with, Index index) {
      const Revolution turn = SpinningLidar(with, Rng(1)).turn(caster, Straight(), index);
      // The middle firing looks ahead.
      for (const LidarReturn& hit : turn.returns)
        if (hit.firing == 180 && hit.laser == 15) return static_cast<double>(hit.position.x());
      return -1.0;
    };
    options.clock_drift = 1e-3;
    const LidarOptions exact = ideal_lidar();
    REQUIRE(first_x(exact, 50) > 0.0);
    // 5 s at 1e-3 make 5 ms: 5 cm nearer.
    CHECK(first_x(exact, 50) - first_x(options, 50) == doctest::Approx(0.05).epsilon(0.01));
    options.clock_drift = 0.0;
    options.clock_jitter = 0.01;
    double squares = 0.0;
    for (Index index = 0; index < 70; ++index) {
      const double error = (first_x(exact, index) - first_x(options, index)) / 10.0;
      squares += error * error / 70.0;
    }
    CHECK(std::sqrt(squares) == doctest::Approx(0.01).epsilon(0.25));
  }

  TEST_CASE("an inertial unit warms up, is shaken while it moves, and its clock jitters") {
    InertialOptions options = InertialOptions{}.without_errors();
    options.rate = 100.0;
    const auto at_rest = record_imu(Parked(), options, Timestamp(), Rng(1));
    options.gyro_warm_up = 1e-3;
    options.accel_warm_up = 0.1;
    options.shake_gyro = 0.01;
    options.shake_accel = 0.5;
    const auto parked = record_imu(Parked(), options, Timestamp(), Rng(1));
    CHECK((parked.front().gyro - at_rest.front().gyro).norm() < 1e-6);
    CHECK((parked.back().gyro - at_rest.back().gyro).norm() > 2e-4);
    CHECK((parked.back().accel - at_rest.back().accel).norm() > 0.02);
    const auto driving = record_imu(Straight(), options, Timestamp(), Rng(1));
    double squares = 0.0;
    for (const ImuSample& sample : driving) squares += sample.gyro.x() * sample.gyro.x();
    CHECK(std::sqrt(squares / static_cast<double>(driving.size())) ==
          doctest::Approx(0.01 / std::numbers::sqrt2).epsilon(0.05));

    const TownDrive town(*preset("town-small"), 1);
    InertialOptions late = InertialOptions{}.without_errors();
    const auto exact = record_imu(town.drive(), late, Timestamp(), Rng(1));
    late.clock_offset = 0.01;  // a period
    const auto shifted = record_imu(town.drive(), late, Timestamp(), Rng(1));
    for (std::size_t i = 500; i < 1000; ++i) CHECK((shifted[i].gyro - exact[i + 1].gyro).norm() < 1e-9);
    late.clock_offset = 0.0;
    late.clock_jitter = 0.004;
    const auto jittered = record_imu(town.drive(), late, Timestamp(), Rng(1));
    double most = 0.0;
    for (std::size_t i = 0; i < exact.size(); ++i) {
      CHECK(jittered[i].time == exact[i].time);
      most = std::max(most, (jittered[i].gyro - exact[i].gyro).norm());
    }
    CHECK(most > 1e-4);
  }

  TEST_CASE("along an open stretch there are railings, and nothing beside them") {
    TownOptions options = preset("nclt-like", PresetSize::small)->town;
    options.passages.clear();
    options.passages.push_back({.from = {1, 1}, .to = {2, 1}, .kind = PassageKind::open, .begin = 0.1, .end = 0.9});
    const Town town = make_town(options, Rng(7));
    const Eigen::Vector2d from = town.streets.position({1, 1});
    const Eigen::Vector2d to = town.streets.position({2, 1});
    const Eigen::Vector2d middle = 0.5 * (from + to);
    const Eigen::Vector2d along = (to - from).normalized();
    const Eigen::Vector2d left(-along.y(), along.x());
    const RayCaster caster(town.world);
    const auto look = [&](double side, double height) {
      const Eigen::Vector3d origin(middle.x(), middle.y(), town.terrain.height(middle) + height);
      const Eigen::Vector3d direction(side * left.x(), side * left.y(), 0.0);
      return caster.cast({origin.cast<float>(), direction.cast<float>(), 38.0F});
    };
    for (const double side : {-1.0, 1.0}) {
      bool railing = false;
      for (double height = 0.3; height < 1.6; height += 0.03)
        if (const auto hit = look(side, height); hit && hit->material == Material::metal)
          railing = railing || hit->distance < options.streets.half_road + 1.0;
      CHECK(railing);
      const auto above = look(side, 3.5);
      if (above) CHECK(above->material != Material::wall);  // at most a tree of another street, or rising ground
    }
  }

  TEST_CASE("people can walk along on all sides, and vehicles close in") {
    Preset crowded = *preset("town-small");
    crowded.lidar.firings_per_revolution = 60;
    crowded.traffic.crowd = 6;
    const TownDrive drive(crowded, 1);
    const auto near =
        drive.traffic().during(drive.drive(), make_town(crowded.town, Rng(1).fork(0)).terrain, 10.0, 10.1);
    CHECK(near.size() == 6);
    for (const Passing& one : near)
      CHECK((one.start - drive.drive().pose(10.0).translation().cast<float>()).head<2>().norm() < 5.0F);
    TrafficOptions tight{.companions = 9, .gap = 8.0, .beside = 3.3, .on_both_sides = true};
    const Traffic traffic(tight, drive.drive(), Rng(2));
    const auto around = traffic.during(drive.drive(), make_town(crowded.town, Rng(1).fork(0)).terrain, 10.0, 10.1);
    CHECK(around.size() >= 5);
    float nearest = 100.0F;
    for (const Passing& one : around)
      nearest = std::min(nearest, (one.start - drive.drive().pose(10.0).translation().cast<float>()).head<2>().norm());
    CHECK(nearest < 10.0F);
  }
}

}  // namespace chainslam::simulator
