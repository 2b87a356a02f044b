#include "factor_graph/peers/ceres.hpp"

#include <ceres/ceres.h>

#include <array>
#include <vector>

#include "chainslam/lie/se2.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam::bench {
namespace {

/// As many numbers as a pose is to Ceres.
template <class Pose>
inline constexpr int numbers = Pose::dof == 6 ? 7 : 3;

template <class Pose>
Pose read(const double* from) {
  if constexpr (Pose::dof == 6) {
    return Pose(SO3d::from_quaternion(Eigen::Map<const Eigen::Quaterniond>(from)), Eigen::Vector3d(from + 4));
  } else {
    return Pose(SO2d::from_angle(from[2]), Eigen::Vector2d(from));
  }
}
void write(const SE3d& pose, double* to) {
  Eigen::Map<Eigen::Vector4d>{to} = pose.rotation().quaternion().coeffs();
  Eigen::Map<Eigen::Vector3d>{to + 4} = pose.translation();
}
void write(const SE2d& pose, double* to) {
  Eigen::Map<Eigen::Vector2d>{to} = pose.translation();
  to[2] = pose.rotation().angle();
}

template <int Rows, int Columns>
using RowMajor = Eigen::Matrix<double, Rows, Columns, Eigen::RowMajor>;

/// Retracts as we do. Jacobians come with respect to the tangent space already, in the first columns.
template <class Pose>
class TangentSpace final : public ceres::Manifold {
 public:
  int AmbientSize() const override { return numbers<Pose>; }
  int TangentSize() const override { return Pose::dof; }
  bool Plus(const double* x, const double* step, double* moved) const override {
    Pose pose = read<Pose>(x).retract(Eigen::Map<const typename Pose::Tangent>(step));
    pose.normalize();
    write(pose, moved);
    return true;
  }
  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<RowMajor<numbers<Pose>, Pose::dof>>(jacobian).setIdentity();
    return true;
  }
  bool Minus(const double* y, const double* x, double* step) const override {
    Eigen::Map<typename Pose::Tangent> difference(step);
    difference = read<Pose>(x).local(read<Pose>(y));
    return true;
  }
  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<RowMajor<Pose::dof, numbers<Pose>>>(jacobian).setIdentity();
    return true;
  }
};

template <class Pose>
class Between final : public ceres::SizedCostFunction<Pose::dof, numbers<Pose>, numbers<Pose>> {
 public:
  explicit Between(const BetweenFactor<Pose>& factor) : factor_(factor) {
    factor_.from = 0;
    factor_.to = 1;
  }

  bool Evaluate(double const* const* poses, double* residual, double** jacobians) const override {
    static thread_local Values<Pose> both = [] {
      Values<Pose> values;
      values.add(Pose());
      values.add(Pose());
      return values;
    }();
    both[0] = read<Pose>(poses[0]);
    both[1] = read<Pose>(poses[1]);
    Eigen::Map<typename Pose::Tangent> out(residual);
    if (jacobians == nullptr) {
      out = factor_.residual(both);
      return true;
    }
    const auto linearized = factor_.linearize(both);
    out = linearized.residual;
    for (std::size_t k = 0; k < 2; ++k) {
      if (jacobians[k] == nullptr) continue;
      Eigen::Map<RowMajor<Pose::dof, numbers<Pose>>> jacobian(jacobians[k]);
      jacobian.setZero();
      jacobian.template leftCols<Pose::dof>() = linearized.jacobians[k];
    }
    return true;
  }

 private:
  BetweenFactor<Pose> factor_;
};

ceres::Solver::Options options() {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.max_num_iterations = 100;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  return options;
}

}  // namespace

template <class Pose>
struct CeresBatch<Pose>::State {
  using Numbers = std::array<double, static_cast<std::size_t>(numbers<Pose>)>;

  Index size = 0;
  std::vector<Numbers> start{};  ///< of the variables, and behind them the priors' means
  std::vector<Numbers> poses{};
  TangentSpace<Pose> manifold{};
  ceres::Problem problem = [] {
    ceres::Problem::Options options;
    options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    return ceres::Problem(options);
  }();
};

template <class Pose>
CeresBatch<Pose>::CeresBatch(const FactorGraph<Pose>& graph) : state_(std::make_unique<State>()) {
  state_->size = graph.values().size();
  for (const Pose& pose : graph.values()) write(pose, state_->start.emplace_back().data());
  for (const auto& prior : graph.priors()) write(prior.mean, state_->start.emplace_back().data());
  state_->poses = state_->start;
  ceres::Problem& problem = state_->problem;
  const auto of = [&](Key key) { return state_->poses[static_cast<std::size_t>(key)].data(); };
  for (Key key = 0; key < to_index(state_->poses.size()); ++key) {
    problem.AddParameterBlock(of(key), numbers<Pose>, &state_->manifold);
    if (key >= graph.values().size() || graph.is_fixed(key)) problem.SetParameterBlockConstant(of(key));
  }
  for (const auto& factor : graph.betweens())
    problem.AddResidualBlock(new Between<Pose>(factor), nullptr, of(factor.from), of(factor.to));
  Key mean = graph.values().size();  // a prior is an edge from where it wants its variable
  for (const auto& prior : graph.priors()) {
    const BetweenFactor<Pose> edge{0, 1, Pose(), prior.sqrt_information};
    problem.AddResidualBlock(new Between<Pose>(edge), nullptr, of(mean++), of(prior.key));
  }
}

template <class Pose>
CeresBatch<Pose>::~CeresBatch() = default;

template <class Pose>
Values<Pose> CeresBatch<Pose>::optimized() {
  state_->poses = state_->start;
  ceres::Solver::Summary summary;
  ceres::Solve(options(), &state_->problem, &summary);
  Values<Pose> values;
  for (Index key = 0; key < state_->size; ++key)
    values.add(read<Pose>(state_->poses[static_cast<std::size_t>(key)].data()));
  return values;
}

template class CeresBatch<SE3d>;
template class CeresBatch<SE2d>;

}  // namespace chainslam::bench
