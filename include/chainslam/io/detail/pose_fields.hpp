#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <string>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/detail/text.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam::detail {

/// How far a quaternion's norm may be from 1, and a rotation matrix's R^T R from I, element by element: what files with
/// four decimals and more keep to. Within it, rotations are made exact; beyond it, the file is refused.
inline constexpr double rotation_tolerance = 1e-3;

enum class QuaternionOrder { xyzw, wxyz };

inline Eigen::Vector3d read_position(LineFields& fields) {
  const double x = fields.number("x"), y = fields.number("y"), z = fields.number("z");
  return {x, y, z};
}

/// Reads a unit quaternion. @throws IoError if its norm is not 1 within `rotation_tolerance`.
inline SO3d read_quaternion(LineFields& fields, QuaternionOrder order) {
  constexpr std::array<std::array<const char*, 4>, 2> names{{{"qx", "qy", "qz", "qw"}, {"qw", "qx", "qy", "qz"}}};
  const auto& name = names[order == QuaternionOrder::xyzw ? 0 : 1];
  std::array<double, 4> q{};
  for (std::size_t i = 0; i < 4; ++i) q[i] = fields.number(name[i]);
  const double norm = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  if (!(std::abs(norm - 1) <= rotation_tolerance))
    fields.fail("qx qy qz qw", "a quaternion of length " + std::to_string(norm),
                "write a unit quaternion, its parts in the order " +
                    std::string(order == QuaternionOrder::xyzw ? "x y z w" : "w x y z"));
  if (order == QuaternionOrder::wxyz) return SO3d::from_quaternion(Eigen::Quaterniond(q[0], q[1], q[2], q[3]));
  return SO3d::from_quaternion(Eigen::Quaterniond(q[3], q[0], q[1], q[2]));
}

/// Reads a row-major 3x4 matrix [R | t]. @throws IoError if R is no rotation within `rotation_tolerance`.
inline SE3d read_matrix_3x4(LineFields& fields) {
  constexpr std::array<const char*, 12> names{"r11", "r12", "r13", "x",   "r21", "r22",
                                              "r23", "y",   "r31", "r32", "r33", "z"};
  Eigen::Matrix3d R;
  Eigen::Vector3d t;
  for (int i = 0; i < 12; ++i) {
    const double number = fields.number(names[static_cast<std::size_t>(i)]);
    (i % 4 < 3 ? R(i / 4, i % 4) : t[i / 4]) = number;
  }
  const Eigen::Matrix3d square = transposed_product(R, R);
  double defect = 0;
  bool orthonormal = true;  // not so if a number is NaN
  for (int i = 0; i < 9; ++i) {
    const double off = std::abs(square.data()[i] - (i % 4 == 0 ? 1 : 0));
    orthonormal = orthonormal && off <= rotation_tolerance;
    defect = std::max(defect, off);
  }
  const Eigen::Vector3d x(R(0, 0), R(1, 0), R(2, 0)), y(R(0, 1), R(1, 1), R(2, 1)), z(R(0, 2), R(1, 2), R(2, 2));
  const Eigen::Vector3d third = x.cross(y);
  if (!orthonormal || third.dot(z) < 0)
    fields.fail("r11..r33", "a matrix that is no rotation (R^T R differs from I by " + std::to_string(defect) + ")",
                "write row-major 3x4 poses [R | t] with R orthonormal and right-handed");
  return SE3d(SO3d::from_matrix(R), t);
}

[[noreturn]] inline void throw_not_finite(const FileTarget& target, const char* what, std::int64_t number) {
  throw_output_error(target.path.string(), std::string(what) + " " + std::to_string(number),
                     "a number that is NaN or infinite, which is never written",
                     "what was estimated came to nothing there: run `chainslam inspect` on the data");
}

/// @throws IoError if a pose that is to be written is not finite.
template <class Pose>
void require_finite(const FileTarget& target, const char* what, auto number, const Pose& pose) {
  if (!is_finite(pose.matrix())) throw_not_finite(target, what, static_cast<std::int64_t>(number));
}

inline void append_position(std::string& text, const Eigen::Vector3d& p) {
  for (int i = 0; i < 3; ++i) {
    text += ' ';
    append_number(text, p[i]);
  }
}

/// Appends " qx qy qz qw".
inline void append_quaternion(std::string& text, const SO3d& rotation) {
  const auto& q = rotation.quaternion();
  for (const double value : {q.x(), q.y(), q.z(), q.w()}) {
    text += ' ';
    append_number(text, value);
  }
}

}  // namespace chainslam::detail
