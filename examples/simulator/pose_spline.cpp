#include "simulator/pose_spline.hpp"

#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

namespace chainslam::simulator {

namespace {

using PoseControl = Spline<7>::Vector;
using Matrix = Eigen::SparseMatrix<double>;

/// Seconds since the first pose, refused unless a spline can follow them.
std::vector<double> times_of(const Trajectory& trajectory) {
  if (!trajectory.has_times() || trajectory.size() < 6)
    throw std::invalid_argument("PoseSpline: needs at least 6 poses with times");
  if (first_disorder(trajectory.times)) throw std::invalid_argument("PoseSpline: times must increase");
  if (first_not_finite(trajectory.poses)) throw std::invalid_argument("PoseSpline: poses must be finite");
  std::vector<double> times;
  for (const Timestamp time : trajectory.times) times.push_back(to_seconds(time - trajectory.times.front()));
  if (times.back() < 1.0) throw std::invalid_argument("PoseSpline: needs poses over at least a second");
  return times;
}

/// The median of the intervals, but no longer than allowed.
double knot_interval(const std::vector<double>& times, double longest) {
  std::vector<double> intervals;
  for (std::size_t i = 1; i < times.size(); ++i) intervals.push_back(times[i] - times[i - 1]);
  std::ranges::nth_element(intervals, intervals.begin() + static_cast<std::ptrdiff_t>(intervals.size() / 2));
  return std::clamp(intervals[intervals.size() / 2], 0.1 * longest, longest);
}

/// Positions, and quaternions (x y z w) each with the sign that is nearer to the one before.
Eigen::MatrixXd values_of(const Trajectory& trajectory) {
  Eigen::MatrixXd values(static_cast<Eigen::Index>(trajectory.size()), 7);
  Eigen::Vector4d last = trajectory.poses.front().rotation().quaternion().coeffs();
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    const Eigen::Vector4d q = trajectory.poses[i].rotation().quaternion().coeffs();
    if (q.dot(last) < 0.0)
      last = -q;
    else
      last = q;
    values.row(static_cast<Eigen::Index>(i)) << trajectory.poses[i].translation().transpose(), last.transpose();
  }
  return values;
}

/// Row i: how much each control point counts at time i.
Matrix observation(const std::vector<double>& times, double knot_spacing, Eigen::Index controls) {
  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t i = 0; i < times.size(); ++i) {
    const double segment = std::clamp(std::floor(times[i] / knot_spacing), 0.0, static_cast<double>(controls - 6));
    const auto weights = Spline<7>::weights_at(times[i] / knot_spacing - segment);
    for (int k = 0; k < 6; ++k) entries.emplace_back(static_cast<int>(i), static_cast<int>(segment) + k, weights(k, 0));
  }
  Matrix result(static_cast<Eigen::Index>(times.size()), controls);
  result.setFromTriplets(entries.begin(), entries.end());
  return result;
}

/// Third differences of the control points: the third derivative, times knot_spacing^3.
Matrix third_differences(Eigen::Index controls) {
  std::vector<Eigen::Triplet<double>> entries;
  for (int i = 0; i + 3 < controls; ++i) {
    constexpr double binomial[] = {-1.0, 3.0, -3.0, 1.0};
    for (int k = 0; k < 4; ++k) entries.emplace_back(i, i + k, binomial[k]);
  }
  Matrix result(controls - 3, controls);
  result.setFromTriplets(entries.begin(), entries.end());
  return result;
}

/// The control points of least cost: sum |S(t_i) - y_i|^2 + smoothing^2 * integral |S'''|^2.
Eigen::MatrixXd fit(const Matrix& at_poses, const Matrix& bending, const Eigen::MatrixXd& values, double penalty) {
  const Matrix normal = at_poses.transpose() * at_poses + penalty * Matrix(bending.transpose() * bending);
  const Eigen::SimplicialLDLT<Matrix, Eigen::Lower, Eigen::NaturalOrdering<int>> solver(normal);
  return solver.solve(at_poses.transpose() * values);
}

Spline<7> spline_through(const Trajectory& trajectory, const PoseSplineOptions& options) {
  const std::vector<double> times = times_of(trajectory);
  const double knot_spacing = knot_interval(times, options.longest_knot);
  const auto controls = static_cast<Eigen::Index>(std::ceil(times.back() / knot_spacing)) + 5;
  const Matrix at_poses = observation(times, knot_spacing, controls);
  const Matrix bending = third_differences(controls);
  const auto penalty = [&](double smoothing) { return smoothing * smoothing * std::pow(knot_spacing, -5); };
  const Eigen::MatrixXd values = values_of(trajectory);
  const Eigen::MatrixXd positions = fit(at_poses, bending, values.leftCols(3), penalty(options.position_smoothing));
  // A quaternion turns by half the angle, and so do its deviations.
  const Eigen::MatrixXd rotations = fit(at_poses, bending, values.rightCols(4), penalty(options.rotation_smoothing));
  std::vector<PoseControl> points(static_cast<std::size_t>(controls));
  for (Eigen::Index i = 0; i < controls; ++i)
    points[static_cast<std::size_t>(i)] << positions.row(i).transpose(), rotations.row(i).transpose();
  return Spline<7>(std::move(points), knot_spacing);
}

}  // namespace

PoseSpline::PoseSpline(const Trajectory& trajectory, const PoseSplineOptions& options)
    : duration_(times_of(trajectory).back()), spline_(spline_through(trajectory, options)) {}

Motion PoseSpline::motion(double time) const {
  const Spline<7>::Point point = spline_.at(time);
  const Eigen::Quaterniond q(point.value[6], point.value[3], point.value[4], point.value[5]);
  const Eigen::Quaterniond change(point.rate[6], point.rate[3], point.rate[4], point.rate[5]);
  return {.T_map_body = SE3d(SO3d::from_quaternion(q.normalized()), point.value.head<3>()),
          .velocity_map = point.rate.head<3>(),
          .acceleration_map = point.acceleration.head<3>(),
          .rate_body = 2.0 / q.squaredNorm() * (q.conjugate() * change).vec()};
}

}  // namespace chainslam::simulator
