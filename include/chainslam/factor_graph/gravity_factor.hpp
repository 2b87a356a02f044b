#pragma once

#include <Eigen/Core>
#include <array>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/s2.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// Gravity direction measured in the body frame: residual R_map_body^T up_map - up_body over `sigma`.
///
/// Its length is that of the chord, 2 sin(angle / 2): the angle where that is small, and largest where the body stands
/// on its head. Nothing is said of position and heading.
template <RobustCost Kernel = Trivial>
struct GravityFactor {
  using Value = SE3d;                                           ///< type of the variables
  static constexpr std::size_t arity = 1;                       ///< number of variables
  static constexpr int rows = 3;                                ///< rows of the residual
  using Residual = Eigen::Vector3d;                             ///< whitened residual
  using Linearized = LinearizedFactor<rows, SE3d::dof, arity>;  ///< what `linearize` returns

  Key key = 0;           ///< the variable
  S2<double> up_body{};  ///< as measured: along the mean specific force of a body at rest, which points up
  double sigma = 1.0;    ///< radians
  S2<double> up_map{};   ///< up in the map's frame
  [[no_unique_address]] Kernel kernel{};  ///< robust kernel of the squared whitened residual

  /// Keys of the variables, in the order of the Jacobians.
  [[nodiscard]] std::array<Key, arity> keys() const { return {key}; }

  /// The whitened residual; see `Factor`.
  [[nodiscard]] Residual residual(const Values<SE3d>& values) const {
    return (seen(values) - up_body.direction()) / sigma;
  }

  /// d (R exp(w))^T u = hat(R^T u) w.
  [[nodiscard]] Linearized linearize(const Values<SE3d>& values) const {
    Linearized result;
    result.residual = residual(values);
    result.jacobians[0].leftCols<3>().setZero();
    result.jacobians[0].rightCols<3>() = SO3d::hat(seen(values)) / sigma;
    return result;
  }

  /// Calls visit(members...), to save or to load them.
  template <class Self, class Visit>
  static void visit_members(Self& self, Visit&& visit) {
    visit(self.key, self.up_body, self.sigma, self.up_map, self.kernel);
  }

 private:
  [[nodiscard]] Eigen::Vector3d seen(const Values<SE3d>& values) const {
    return values[key].rotation().inverse() * up_map.direction();
  }
};
static_assert(RobustFactor<GravityFactor<>> && RobustFactor<GravityFactor<Huber>>);

}  // namespace chainslam
