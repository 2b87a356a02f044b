#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/detail/byte_reader.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::detail {

// Records of a map file, little-endian, as the description in map_archive.hpp lays them out. Writing and reading share
// the checks: what a writer lets through, every reader takes.

inline constexpr std::size_t pose_bytes = 56, session_bytes = 360, keyframe_bytes = 72, odometry_bytes = 352,
                             closure_bytes = 376, gnss_bytes = 120, frame_bytes = 184;
inline constexpr std::size_t block_prelude_bytes = 16;      ///< before a block's records
inline constexpr std::size_t frame_bytes_before_1_3 = 172;  ///< without delta velocity
inline constexpr std::size_t gnss_bytes_before_1_4 = 112;   ///< without the fix's arrival
inline constexpr std::uint32_t keyframe_has_scan = 1;
inline constexpr std::uint32_t gnss_with_previous = 1;
inline constexpr std::uint8_t frame_map_restarted = 1, frame_after_gap = 2, frame_imu_as_set = 4,
                              frame_imu_unknown = 255;
inline constexpr std::size_t longest_session_name = 65535;

/// What is wrong with a record.
struct Fault {
  std::string field;
  std::string found;
};
using MaybeFault = std::optional<Fault>;

inline void append_pose(std::vector<std::byte>& out, const SE3d& T) {
  for (Eigen::Index i = 0; i < 3; ++i) append_bytes(out, T.translation()[i]);
  for (Eigen::Index i = 0; i < 4; ++i) append_bytes(out, T.rotation().quaternion().coeffs()[i]);  // x y z w
}

template <int Rows>
void append_matrix(std::vector<std::byte>& out, const Eigen::Matrix<double, Rows, Rows, Eigen::DontAlign>& matrix) {
  for (Eigen::Index row = 0; row < Rows; ++row)
    for (Eigen::Index column = 0; column < Rows; ++column) append_bytes(out, matrix(row, column));
}

/// A pose as it was stored, before its quaternion is known to be one.
struct StoredPose {
  Eigen::Vector3d translation;
  SO3d::Quaternion quaternion;

  [[nodiscard]] SE3d pose() const { return SE3d(SO3d::from_quaternion(quaternion), translation); }
};

inline StoredPose read_pose(ByteReader& in) {
  StoredPose stored;
  for (Eigen::Index i = 0; i < 3; ++i) stored.translation[i] = in.take<double>();
  for (Eigen::Index i = 0; i < 4; ++i) stored.quaternion.coeffs()[i] = in.take<double>();
  return stored;
}

template <int Rows>
Eigen::Matrix<double, Rows, Rows, Eigen::DontAlign> read_matrix(ByteReader& in) {
  Eigen::Matrix<double, Rows, Rows, Eigen::DontAlign> matrix;
  for (Eigen::Index row = 0; row < Rows; ++row)
    for (Eigen::Index column = 0; column < Rows; ++column) matrix(row, column) = in.take<double>();
  return matrix;
}

/// How many of each a map has, for what records say of one another.
struct MapCounts {
  Index sessions = 0, keyframes = 0, scans = 0, odometry = 0, closures = 0, refusals = 0;
  friend bool operator==(const MapCounts&, const MapCounts&) = default;
};

inline MaybeFault fault_of(const char* field, const Eigen::Vector3d& translation, const SO3d::Quaternion& quaternion) {
  if (!is_finite(translation) || !is_finite(quaternion.coeffs())) return Fault{field, "a number that is not finite"};
  const double norm = quaternion.norm();
  if (std::abs(norm - 1) > 1e-6) return Fault{field, "a quaternion of length " + std::to_string(norm)};
  return std::nullopt;
}

inline MaybeFault fault_of(const char* field, const SE3d& T) {
  return fault_of(field, T.translation(), T.rotation().quaternion());
}

inline MaybeFault fault_of(const char* field, const SqrtInformation<6>& matrix) {
  if (!is_finite(matrix)) return Fault{field, "a number that is not finite"};
  return std::nullopt;
}

inline MaybeFault fault_of_number(const char* field, Index value, Index least, Index count, const char* what) {
  if (value >= least && value < count) return std::nullopt;
  return Fault{field, std::to_string(value) + ", where there are " + std::to_string(count) + " " + what};
}

inline MaybeFault first_fault(std::initializer_list<MaybeFault> faults) {
  for (const MaybeFault& fault : faults)
    if (fault) return fault;
  return std::nullopt;
}

inline MaybeFault fault_of(const Session& session) {
  if (session.first_keyframe < 0) return Fault{"first keyframe", std::to_string(session.first_keyframe)};
  if (session.name.size() > longest_session_name)
    return Fault{"name", "a text of " + std::to_string(session.name.size()) + " bytes"};
  return first_fault(
      {fault_of("prior", session.prior), fault_of("prior's information", session.prior_sqrt_information)});
}

/// @param before  the keyframe before, if there is one.
inline MaybeFault fault_of(const Keyframe& keyframe, const Keyframe* before, Index sessions) {
  if (auto fault = fault_of_number("session", keyframe.session.value, 0, sessions, "sessions")) return fault;
  if (before != nullptr && keyframe.session < before->session)
    return Fault{"session", std::to_string(keyframe.session.value) + " after " + std::to_string(before->session.value)};
  if (before != nullptr && keyframe.session == before->session && keyframe.time <= before->time)
    return Fault{"time", std::to_string(keyframe.time.nanoseconds()) + " ns after " +
                             std::to_string(before->time.nanoseconds()) + " ns of the same session"};
  return fault_of("T_odom_body", keyframe.T_odom_body);
}

inline MaybeFault fault_of(const OdometryMeasurement& step, Index keyframes) {
  return first_fault({fault_of_number("from", step.from.value, 0, keyframes, "keyframes"),
                      fault_of_number("to", step.to.value, 0, keyframes, "keyframes"),
                      step.from == step.to ? MaybeFault(Fault{"to", "the keyframe that it comes from"}) : std::nullopt,
                      fault_of("T_from_to", step.T_from_to), fault_of("information", step.sqrt_information)});
}

inline MaybeFault fault_of(const LoopClosure& closure, const MapCounts& counts) {
  if (!is_finite(closure.mean_squared_error) || !is_finite(closure.inlier_ratio))
    return Fault{"score", "a number that is not finite"};
  return first_fault(
      {fault_of_number("kind", static_cast<Index>(closure.kind), 0, static_cast<Index>(ClosureKind::merge) + 1,
                       "kinds known to this version"),
       fault_of_number("verdict", static_cast<Index>(closure.verdict), 0,
                       static_cast<Index>(ClosureVerdict::against_fixes) + 1, "verdicts known to this version"),
       fault_of_number("from", closure.from.value, 0, counts.keyframes, "keyframes"),
       fault_of_number("to", closure.to.value, 0, counts.keyframes, "keyframes"),
       closure.from == closure.to ? MaybeFault(Fault{"to", "the keyframe that it comes from"}) : std::nullopt,
       fault_of_number("cause", closure.cause, -1, counts.closures, "closures"),
       fault_of("T_from_to", closure.T_from_to), fault_of("information", closure.sqrt_information)});
}

inline MaybeFault fault_of(const GnssFix& fix) {
  if (!is_finite(fix.position_ecef) || !is_finite(fix.covariance_ecef))
    return Fault{"position or covariance", "a number that is not finite"};
  // Rotated and interpolated covariances are symmetric and semi-definite up to rounding only.
  const double largest = fix.covariance_ecef.cwiseAbs().maxCoeff();
  if ((fix.covariance_ecef - fix.covariance_ecef.transpose()).cwiseAbs().maxCoeff() > 1e-6 * largest)
    return Fault{"covariance", "a matrix that is not symmetric"};
  const Eigen::Matrix3d raised = fix.covariance_ecef + 1e-9 * largest * Eigen::Matrix3d::Identity();
  if (!Eigen::LDLT<Eigen::Matrix3d>(raised).isPositive())
    return Fault{"covariance", "a matrix that is not positive semi-definite"};
  return fault_of_number("quality", static_cast<Index>(fix.quality), 0, static_cast<Index>(GnssQuality::rtk_fixed) + 1,
                         "qualities known to this version");
}

inline MaybeFault fault_of_arrival(const Keyframe& keyframe, Index keyframes) {
  const Index after = keyframe.gnss_arrival.after.value;
  if (after == -1) return std::nullopt;
  return fault_of_number("keyframe after which it came", after, keyframe.id.value, keyframes, "keyframes");
}

/// @param before  the frame before, if there is one.
inline MaybeFault fault_of(const FrameRecord& frame, const FrameRecord* before, Index sessions) {
  if (auto fault = fault_of_number("session", frame.session.value, 0, sessions, "sessions")) return fault;
  if (before != nullptr && frame.session < before->session)
    return Fault{"session", std::to_string(frame.session.value) + " after " + std::to_string(before->session.value)};
  if (before != nullptr && frame.session == before->session && frame.time <= before->time)
    return Fault{"time", std::to_string(frame.time.nanoseconds()) + " ns after " +
                             std::to_string(before->time.nanoseconds()) + " ns of the same session"};
  const Matrix6d covariance = frame.covariance.matrix();
  if (!is_finite(covariance)) return Fault{"covariance", "a number that is not finite"};
  for (int i = 0; i < 6; ++i)
    if (covariance(i, i) < 0) return Fault{"covariance", "a variance of " + std::to_string(covariance(i, i))};
  if (frame.delta_velocity && !is_finite(*frame.delta_velocity))
    return Fault{"delta velocity", "a number that is not finite"};
  const FrameHealth& health = frame.health;
  if (!is_finite(health.residual_rms)) return Fault{"residual", "a number that is not finite"};
  return first_fault({fault_of_number("status", static_cast<Index>(health.status), 0,
                                      static_cast<Index>(FrameStatus::lost) + 1, "statuses known to this version"),
                      fault_of_number("use of the IMU", static_cast<Index>(health.imu_use.value_or(ImuUse::all)), 0,
                                      static_cast<Index>(ImuUse::none) + 1, "uses known to this version"),
                      fault_of("T_odom_body", frame.T_odom_body)});
}

inline void append_session(std::vector<std::byte>& out, const Session& session) {
  append_bytes(out, session.id.value);
  append_bytes(out, session.first_keyframe);
  append_bytes(out, session.frame.value);
  append_bytes(out, static_cast<std::uint32_t>(session.name.size()));
  append_pose(out, session.prior);
  append_matrix<6>(out, session.prior_sqrt_information);
  for (const char c : session.name) out.push_back(static_cast<std::byte>(c));
}

inline void append_keyframe(std::vector<std::byte>& out, const Keyframe& keyframe) {
  append_bytes(out, keyframe.time.nanoseconds());
  append_bytes(out, keyframe.session.value);
  append_bytes(out, keyframe.cloud ? keyframe_has_scan : 0U);
  append_pose(out, keyframe.T_odom_body);
}

inline void append_odometry(std::vector<std::byte>& out, const OdometryMeasurement& step) {
  append_bytes(out, step.from.value);
  append_bytes(out, step.to.value);
  append_pose(out, step.T_from_to);
  append_matrix<6>(out, step.sqrt_information);
}

inline void append_closure(std::vector<std::byte>& out, const LoopClosure& closure) {
  append_bytes(out, closure.from.value);
  append_bytes(out, closure.to.value);
  append_bytes(out, static_cast<std::uint16_t>(closure.kind));
  append_bytes(out, static_cast<std::uint16_t>(closure.verdict));
  append_bytes(out, closure.cause);
  append_pose(out, closure.T_from_to);
  append_matrix<6>(out, closure.sqrt_information);
  append_bytes(out, closure.mean_squared_error);
  append_bytes(out, closure.inlier_ratio);
}

inline void append_gnss(std::vector<std::byte>& out, KeyframeId keyframe, const GnssFix& fix,
                        const GnssArrival& arrival = {}) {
  append_bytes(out, keyframe.value);
  append_bytes(out, static_cast<std::uint32_t>(fix.quality));
  append_bytes(out, fix.time.nanoseconds());
  for (Eigen::Index i = 0; i < 3; ++i) append_bytes(out, fix.position_ecef[i]);
  append_matrix<3>(out, fix.covariance_ecef);
  append_bytes(out, arrival.after.value);
  append_bytes(out, arrival.with_previous ? gnss_with_previous : 0U);
}

/// Nothing if the record is of a version that did not have it.
inline GnssArrival read_gnss_arrival(ByteReader& in) {
  if (in.left() == 0) return {};
  const KeyframeId after{in.take<Index>()};
  return {after, (in.take<std::uint32_t>() & gnss_with_previous) != 0};
}

/// The record but for the keyframe's number, and what came with 1.4.
inline GnssFix read_gnss(ByteReader& in) {
  GnssFix fix;
  fix.quality = static_cast<GnssQuality>(in.take<std::uint32_t>());
  fix.time = Timestamp::from_nanoseconds(in.take<std::int64_t>());
  for (Eigen::Index k = 0; k < 3; ++k) fix.position_ecef[k] = in.take<double>();
  fix.covariance_ecef = read_matrix<3>(in);
  return fix;
}

inline void append_frame(std::vector<std::byte>& out, const FrameRecord& frame) {
  const FrameHealth& health = frame.health;
  append_bytes(out, frame.time.nanoseconds());
  append_bytes(out, frame.session.value);
  append_bytes(out, static_cast<std::uint8_t>(health.status));
  append_bytes(out, static_cast<std::uint8_t>((health.map_restarted ? frame_map_restarted : 0) |
                                              (health.after_gap ? frame_after_gap : 0) |
                                              (health.imu_as_set ? frame_imu_as_set : 0)));
  append_bytes(out, health.imu_use ? static_cast<std::uint8_t>(*health.imu_use) : frame_imu_unknown);
  append_bytes(out, std::uint8_t{0});
  append_bytes(out, health.points);
  append_bytes(out, health.matches);
  append_bytes(out, health.iterations);
  append_bytes(out, static_cast<float>(health.residual_rms));
  append_pose(out, frame.T_odom_body);
  for (const float entry : frame.covariance.upper()) append_bytes(out, entry);
  constexpr float not_measured = std::numeric_limits<float>::quiet_NaN();
  for (int axis = 0; axis < 3; ++axis)
    append_bytes(out, frame.delta_velocity ? (*frame.delta_velocity)[axis] : not_measured);
}

/// Nothing if it was not measured, or the record is of a version that did not have it.
inline std::optional<Eigen::Vector3f> read_delta_velocity(ByteReader& in) {
  if (in.left() == 0) return std::nullopt;
  Eigen::Vector3f gained;
  for (int axis = 0; axis < 3; ++axis) gained[axis] = in.take<float>();
  if (std::isnan(gained[0]) && std::isnan(gained[1]) && std::isnan(gained[2])) return std::nullopt;
  return gained;
}

inline PackedCovariance read_packed_covariance(ByteReader& in) {
  std::array<float, PackedCovariance::entries> upper;
  for (float& entry : upper) entry = in.take<float>();
  return PackedCovariance(upper);
}

/// @param take_pose  reads the pose, which may have to be checked before it is one.
template <class TakePose>
FrameRecord read_frame(ByteReader& in, TakePose&& take_pose) {
  FrameRecord frame;
  FrameHealth& health = frame.health;
  frame.time = Timestamp::from_nanoseconds(in.take<std::int64_t>());
  frame.session.value = in.take<Index>();
  health.status = static_cast<FrameStatus>(in.take<std::uint8_t>());
  const auto flags = in.take<std::uint8_t>();
  const auto imu_use = static_cast<std::uint8_t>(in.take<std::uint16_t>());  // and a byte of zero
  health.map_restarted = (flags & frame_map_restarted) != 0;
  health.after_gap = (flags & frame_after_gap) != 0;
  health.imu_as_set = (flags & frame_imu_as_set) != 0;
  if (imu_use != frame_imu_unknown) health.imu_use = static_cast<ImuUse>(imu_use);
  health.points = in.take<Index>();
  health.matches = in.take<Index>();
  health.iterations = in.take<Index>();
  health.residual_rms = static_cast<double>(in.take<float>());
  frame.T_odom_body = take_pose();
  frame.covariance = read_packed_covariance(in);
  frame.delta_velocity = read_delta_velocity(in);
  return frame;
}

}  // namespace chainslam::detail
