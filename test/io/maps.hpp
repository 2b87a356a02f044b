#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/quantize.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/io/file_system.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::test {

/// The machine's files, without waiting for the disk: for tests that no loss of power concerns.
struct UnsyncedFiles : RealFileSystem {
  int sync(int) { return 0; }
  int sync_data(int) { return 0; }
  int sync_directory(const std::filesystem::path&) { return 0; }
};

/// A cloud of `count` points within some metres, not on any grid.
inline PointCloud<float> random_cloud(Rng& rng, int count) {
  PointCloud<float> cloud;
  for (int i = 0; i < count; ++i)
    cloud.positions.emplace_back(static_cast<float>(rng.normal(0, 20)), static_cast<float>(rng.normal(0, 20)),
                                 static_cast<float>(rng.normal(0, 2)));
  return cloud;
}

inline SE3d random_pose(Rng& rng, double metres = 100) {
  Vector6d xi;
  for (Eigen::Index i = 0; i < 6; ++i) xi[i] = rng.normal(0, i < 3 ? metres : 1.0);
  return SE3d::exp(xi);
}

inline SqrtInformation<6> random_root(Rng& rng) {
  SqrtInformation<6> root = SqrtInformation<6>::Zero();
  for (Eigen::Index row = 0; row < 6; ++row)
    for (Eigen::Index column = row; column < 6; ++column) root(row, column) = rng.normal(row == column ? 30 : 0, 5);
  return root;
}

/// A drive that grows keyframe by keyframe, as a mapper's would: sessions, odometry, closures, refusals, fixes that
/// come two keyframes late, poses that closures move. What each record says is random.
class GrowingMap {
 public:
  explicit GrowingMap(std::uint64_t seed, int points = 30) : rng_(seed), points_(points) { begin_session("first"); }

  [[nodiscard]] const SlamMap& map() const { return map_; }

  void begin_session(std::string name) {
    const SessionId id{to_index(map_.sessions.size())};
    map_.sessions.push_back({.id = id,
                             .name = std::move(name),
                             .first_keyframe = to_index(map_.keyframes.size()),
                             .keyframes = 0,
                             .frame = id,
                             .prior = random_pose(rng_),
                             .prior_sqrt_information = random_root(rng_)});
  }

  /// Joins the newest session to the first one's frame; some closures are decided otherwise then.
  void merge() {
    map_.sessions.back().frame = SessionId{0};
    for (std::size_t i = 1; i < map_.closures.size(); i += 3)
      map_.closures[i].verdict = i % 2 == 0 ? ClosureVerdict::inconsistent : ClosureVerdict::reverted;
    move_poses();
  }

  void add_keyframe() {
    Session& session = map_.sessions.back();
    const KeyframeId id{to_index(map_.keyframes.size())};
    Keyframe keyframe;
    keyframe.id = id;
    keyframe.session = session.id;
    keyframe.time = Timestamp::from_nanoseconds(1'600'000'000'123'456'789 + 1'000'000'007LL * id.value);
    keyframe.T_odom_body = random_pose(rng_);
    keyframe.T_map_body = random_pose(rng_);
    if (id.value % 7 != 3) keyframe.cloud = std::make_shared<const PointCloud<float>>(scan(id.value));
    if (session.keyframes > 0)
      map_.odometry.push_back({KeyframeId{id.value - 1}, id, random_pose(rng_, 1), random_root(rng_)});
    ++session.keyframes;
    for (int k = 2; k >= 0; --k) add_frame(keyframe, keyframe.time - seconds(0.1 * k));
    map_.keyframes.push_back(std::move(keyframe));
    if (id.value >= 2 && id.value % 3 == 0) add_fix(map_.keyframes[static_cast<std::size_t>(id.value - 2)]);
    if (id.value > 3 && id.value % 4 == 0) close(id);
  }

 private:
  [[nodiscard]] PointCloud<float> scan(Index id) {
    PointCloud<float> cloud = random_cloud(rng_, points_);
    if (id % 5 != 1) return quantized(cloud);
    for (const Eigen::Vector3f& p : cloud.positions) {
      cloud.normals.push_back(p.normalized());
      cloud.time_offsets.push_back(p[0]);
      if (id % 10 == 1) cloud.intensities.push_back(p[1]);
    }
    return cloud;
  }

  void add_frame(const Keyframe& keyframe, Timestamp time) {
    FrameRecord frame{.session = keyframe.session, .time = time, .T_odom_body = random_pose(rng_)};
    const Matrix6d root = random_root(rng_);
    frame.covariance = PackedCovariance(Matrix6d(root.transpose() * root));
    frame.health = {.status = static_cast<FrameStatus>(rng_.uniform_index(3)),
                    .points = rng_.uniform_index(5000),
                    .matches = rng_.uniform_index(5000),
                    .residual_rms = 0.0625 * rng_.uniform_index(9),
                    .iterations = rng_.uniform_index(99),
                    .map_restarted = rng_.uniform_index(2) == 0,
                    .after_gap = rng_.uniform_index(2) == 0};
    if (const Index use = rng_.uniform_index(5); use < 4) frame.health.imu_use = static_cast<ImuUse>(use);
    frame.health.imu_as_set = frame.health.imu_use == ImuUse::gyroscope && frame.health.matches % 2 == 0;
    if (rng_.uniform_index(3) > 0)
      frame.delta_velocity = Eigen::Vector3d(rng_.normal(), rng_.normal(), rng_.normal(0.98, 0.1)).cast<float>();
    map_.frames.push_back(frame);
  }

  void add_fix(Keyframe& keyframe) {
    GnssFix fix;
    fix.time = keyframe.time;
    fix.position_ecef = {4'000'000 + rng_.normal(0, 100), 900'000, 4'800'000};
    fix.covariance_ecef.diagonal() << 1.5, 2.5, 4;
    fix.quality = GnssQuality::rtk_float;
    keyframe.gnss = fix;
    keyframe.gnss_arrival = {keyframe.id, keyframe.id.value % 2 == 0};
  }

  void close(KeyframeId id) {
    LoopClosure closure;
    closure.from = KeyframeId{id.value - 4};
    closure.to = id;
    closure.T_from_to = random_pose(rng_, 2);
    closure.sqrt_information = random_root(rng_);
    closure.kind = map_.closures.empty() ? ClosureKind::direct : ClosureKind::chained;
    closure.mean_squared_error = rng_.normal(0.1, 0.01);
    closure.inlier_ratio = 0.75;
    closure.cause = to_index(map_.closures.size()) - 1;
    map_.closures.push_back(closure);
    closure.verdict = ClosureVerdict::inconsistent;
    closure.sqrt_information.setZero();
    map_.refusals.push_back(closure);
    move_poses();
  }

  void move_poses() {
    for (Keyframe& keyframe : map_.keyframes) keyframe.T_map_body = keyframe.T_map_body * random_pose(rng_, 0.1);
  }

  Rng rng_;
  int points_;
  SlamMap map_;
};

/// A map of two sessions.
inline SlamMap random_map(std::uint64_t seed, int keyframes, int points = 30) {
  GrowingMap growing(seed, points);
  for (int i = 0; i < keyframes; ++i) {
    if (i == keyframes / 2) growing.begin_session("second, with \xc3\xa4 and a\nnew line");
    growing.add_keyframe();
  }
  growing.merge();
  return growing.map();
}

// ---- equality, bit for bit ----

template <class T>
bool same_bits(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), sizeof(T) * a.size()) == 0);
}

inline bool same_cloud(const KeyframeScan& one, const KeyframeScan& other) {
  const auto a = one.load(), b = other.load();
  if (!a || !b) return !a && !b;
  return same_bits(a->positions, b->positions) && same_bits(a->normals, b->normals) &&
         same_bits(a->time_offsets, b->time_offsets) && same_bits(a->intensities, b->intensities);
}

inline bool same_fix(const std::optional<GnssFix>& a, const std::optional<GnssFix>& b) {
  if (!a || !b) return !a && !b;
  return a->time == b->time && a->position_ecef == b->position_ecef && a->covariance_ecef == b->covariance_ecef &&
         a->quality == b->quality;
}

/// Puts changed frames in the place of a map's.
template <class Change>
void change_frames(SlamMap& map, Change&& change) {
  for (FrameRecord frame : std::exchange(map.frames, {})) {
    change(frame);
    map.frames.push_back(frame);
  }
}

/// All but T_map_body and the fix, which may come later.
inline bool same_record(const Keyframe& a, const Keyframe& b) {
  return a.id == b.id && a.session == b.session && a.time == b.time && a.T_odom_body == b.T_odom_body;
}

inline bool same_record(const Session& a, const Session& b) {
  return a.id == b.id && a.name == b.name && a.first_keyframe == b.first_keyframe && a.keyframes == b.keyframes &&
         a.frame == b.frame && a.prior == b.prior && a.prior_sqrt_information == b.prior_sqrt_information;
}

inline bool same_record(const OdometryMeasurement& a, const OdometryMeasurement& b) {
  return a.from == b.from && a.to == b.to && a.T_from_to == b.T_from_to && a.sqrt_information == b.sqrt_information;
}

inline bool same_record(const LoopClosure& a, const LoopClosure& b) {
  return a.from == b.from && a.to == b.to && a.T_from_to == b.T_from_to && a.sqrt_information == b.sqrt_information &&
         a.kind == b.kind && a.verdict == b.verdict && a.mean_squared_error == b.mean_squared_error &&
         a.inlier_ratio == b.inlier_ratio && a.cause == b.cause;
}

inline bool same_record(const FrameRecord& a, const FrameRecord& b) {
  const FrameHealth &x = a.health, &y = b.health;
  return a.session == b.session && a.time == b.time && a.T_odom_body == b.T_odom_body && a.covariance == b.covariance &&
         x.status == y.status && x.points == y.points && x.matches == y.matches && x.residual_rms == y.residual_rms &&
         x.iterations == y.iterations && x.map_restarted == y.map_restarted && x.after_gap == y.after_gap &&
         x.imu_use == y.imu_use && x.imu_as_set == y.imu_as_set && a.delta_velocity == b.delta_velocity;
}

template <class Records>
bool same_records(const Records& a, const Records& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const auto& x, const auto& y) { return same_record(x, y); });
}

inline bool same_map(const SlamMap& a, const SlamMap& b) {
  return same_records(a.sessions, b.sessions) && same_records(a.keyframes, b.keyframes) &&
         same_records(a.odometry, b.odometry) && same_records(a.closures, b.closures) &&
         same_records(a.refusals, b.refusals) && same_records(a.frames, b.frames) &&
         std::equal(a.keyframes.begin(), a.keyframes.end(), b.keyframes.begin(),
                    [](const Keyframe& x, const Keyframe& y) {
                      return x.T_map_body == y.T_map_body && same_cloud(x.cloud, y.cloud) && same_fix(x.gnss, y.gnss) &&
                             x.gnss_arrival == y.gnss_arrival;
                    });
}

}  // namespace chainslam::test
