#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/detail/match_cache.hpp"
#include "chainslam/registration/detail/normal_equations.hpp"
#include "chainslam/registration/detail/pair_sums.hpp"
#include "chainslam/registration/optimizers.hpp"
#include "chainslam/registration/rejectors.hpp"

namespace chainslam::detail {

/// What a metric asks of the target beside positions; a metric of the pairwise kind looks for itself.
template <class Metric>
[[nodiscard]] constexpr Surface target_surface() {
  if constexpr (SurfaceMetric<Metric>)
    return Metric::target_surface;
  else
    return Surface::nothing;
}
template <class Metric>
[[nodiscard]] constexpr Surface source_surface() {
  if constexpr (SurfaceMetric<Metric>)
    return Metric::source_surface;
  else
    return Surface::nothing;
}

template <class Metric>
[[nodiscard]] constexpr double degeneracy_threshold_of() {
  if constexpr (requires { Metric::degeneracy_threshold; })
    return Metric::degeneracy_threshold;
  else
    return 0.005;
}

template <class Target, Surface TargetSurface>
struct MatchesOf {
  using type = MatchCache<Target, TargetSurface>;
};
template <MatchingTarget Target, Surface TargetSurface>
struct MatchesOf<Target, TargetSurface> {
  using type = NamedMatches<Target, TargetSurface>;
};

/// One alignment under way: the pose, its pairs and their sums. Models `AlignProblem` for the optimizer.
template <class Icp, class Target, class Exec>
class IcpRun {
  using Metric = typename Icp::MetricType;
  using Scalar = typename Target::Scalar;
  using Matches = typename MatchesOf<Target, target_surface<Metric>()>::type;
  static constexpr bool rejects = !std::same_as<typename Icp::RejectorType, KeepPairs>;
  static constexpr Index grain = 512;

 public:
  /// @param threshold  see `RestrictedSystem`.
  IcpRun(const Icp& icp, const SourceColumns& source, const Target& target, const SE3d& guess, double threshold,
         const Exec& executor)
      : icp_(icp),
        threshold_(threshold),
        source_(source),
        target_(target),
        executor_(executor),
        matches_(target, source.count, static_cast<Scalar>(icp.max_distance)),
        rotation_(guess.rotation()),
        pivot_(guess * source.pivot) {
    const double within = std::min(Matches::within(target, icp.max_distance), 1e15);
    squared_max_distance_ = within * within;
    if constexpr (rejects) {
      kept_.resize((static_cast<std::size_t>(source.count) + Quad::size - 1) / Quad::size * Quad::size);
      squared_distances_.resize(kept_.size());
    }
  }

  /// Matches at the present pose and sums over the pairs.
  /// @param keep  see `MatchCache::update`.
  void measure(bool keep) {
    const Placement at = placement(rotation_, pivot_);
    if constexpr (rejects) {
      executor_.for_chunks(source_.count, grain, [&](Index begin, Index end) {
        matches_.update(source_, at, begin, end, keep);
        measure_distances(at, begin, end);
      });
      matched_ = 0;
      for (const float kept : kept_) matched_ += kept > 0 ? 1 : 0;
      PairView view{*this, at.rotation};
      icp_.rejector(view);
      sums_ = sum(at);
    } else {
      sums_ = reduce([&](Index begin, Index end) {
        matches_.update(source_, at, begin, end, keep);
        return pairs().sum(at, begin, end);
      });
      matched_ = sums_.inliers;
    }
    sums_.information /= residuals_a_pair();
    add_prior(sums_, T_target_source(rotation_, pivot_));
    system_ = RestrictedSystem(sums_, threshold_, icp_.free.mask());
  }

  /// A motion of the pivot, and about it, in the target's axes.
  void move(const Vector6d& step) {
    rotation_ = turned(step);
    pivot_ = shifted(step);
  }

  [[nodiscard]] Vector6d solve(double damping) const { return system_.step(damping); }
  [[nodiscard]] double cost() const { return sums_.cost; }
  [[nodiscard]] double mean_cost() const { return sums_.inliers > 0 ? sums_.cost / sums_.inliers : 0.0; }
  [[nodiscard]] double cost_after(const Vector6d& step) const {
    const SO3d rotation = turned(step);
    const Eigen::Vector3d pivot = shifted(step);
    const Placement at = placement(rotation, pivot);
    AlignmentEquations sums = sum(at);
    add_prior(sums, T_target_source(rotation, pivot));
    return sums.cost;
  }

  [[nodiscard]] bool overlaps() const {
    return sums_.inliers >= Icp::least_points && share(matched_) >= icp_.min_overlap;
  }
  /// Whether a step moves the points by less than half their distance from their matches, root mean square: few get
  /// another match.
  [[nodiscard]] bool is_short(const Vector6d& step) const {
    const auto inliers = static_cast<double>(sums_.inliers);
    const double moved =
        translation_of(step).squaredNorm() + rotation_of(step).squaredNorm() * sums_.squared_extent / inliers;
    return moved < 0.25 * sums_.squared_distance / inliers;
  }
  [[nodiscard]] Index left_out() const { return system_.left_out(); }
  [[nodiscard]] SE3d T_target_source() const { return T_target_source(rotation_, pivot_); }

  /// Fills in what can be said of the pairs whether or not they suffice.
  void count(AlignResult& result) const {
    result.inliers = sums_.inliers;
    result.inlier_ratio = share(sums_.inliers);
    result.overlap = share(matched_);
  }

  /// Fills in all figures at the present pose.
  [[gnu::cold]] void report(AlignResult& result) const {
    count(result);
    const auto inliers = static_cast<double>(sums_.inliers);
    result.T_target_source = T_target_source();
    result.mean_squared_error = sums_.squared_distance / inliers;
    result.mean_squared_residual = sums_.squared_residual / inliers;
    const Eigen::Matrix3d R = rotation_.matrix();
    const Matrix6d to_source = tangent_to_source(rotation_);
    const double most = std::min(squared_max_distance_, largest_variance);
    result.hessian = congruent(transposed(tangent_from_source(rotation_)), system_.hessian());
    result.covariance = congruent(to_source, system_.covariance(residual_variance(), most));
    result.eigenvalues = system_.eigenvalues();
    result.eigenvectors = system_.eigenvectors(R);
    result.localizability = system_.localizability(R, std::max(0.1 * threshold_, 1e-6));
    result.degenerate_directions = system_.left_out();
  }

 private:
  static constexpr double largest_variance = 1e6;  ///< m^2, where no distance is the largest

  /// The pairs as rejectors see them.
  struct PairView {
    IcpRun& run;
    const Eigen::Matrix3d& R;

    [[nodiscard]] Index size() const { return run.source_.count; }
    [[nodiscard]] bool kept(Index i) const { return run.kept_[static_cast<std::size_t>(i)] > 0; }
    [[nodiscard]] Index target(Index i) const { return run.matches_.index(i); }
    [[nodiscard]] double squared_distance(Index i) const { return run.squared_distances_[static_cast<std::size_t>(i)]; }
    [[nodiscard]] double cosine(Index i) const {
      if constexpr (Icp::RejectorType::needs_normals) {
        const auto& columns = run.source_.normals;
        const Eigen::Vector3d m(static_cast<double>(*columns.at(0, i)), static_cast<double>(*columns.at(1, i)),
                                static_cast<double>(*columns.at(2, i)));
        const auto& n = run.target_.normal(target(i));
        const Eigen::Vector3d normal(static_cast<double>(n[0]), static_cast<double>(n[1]), static_cast<double>(n[2]));
        const double lengths = std::sqrt(m.squaredNorm() * normal.squaredNorm());
        const Eigen::Vector3d turned = product(R, m);
        if (lengths > 0 && is_finite(lengths)) return normal.dot(turned) / lengths;
      }
      return std::numeric_limits<double>::quiet_NaN();
    }
    void reject(Index i) const { run.kept_[static_cast<std::size_t>(i)] = 0; }
  };

  [[nodiscard]] static Placement placement(const SO3d& rotation, const Eigen::Vector3d& pivot) {
    return {rotation.matrix(), pivot};
  }
  [[nodiscard]] SE3d T_target_source(const SO3d& rotation, const Eigen::Vector3d& pivot) const {
    return SE3d(rotation, pivot - rotation * source_.pivot);
  }

  [[nodiscard]] Pairs<Metric, typename Icp::KernelType, Target, Matches> pairs() const {
    return {icp_.metric, icp_.kernel, source_, target_, matches_, squared_max_distance_, kept_};
  }

  template <class Chunk>
  [[nodiscard]] AlignmentEquations reduce(Chunk&& chunk) const {
    return reduce_chunks(executor_, source_.count, grain, AlignmentEquations{}, chunk,
                         [](AlignmentEquations left, const AlignmentEquations& right) { return left += right; });
  }
  [[nodiscard]] AlignmentEquations sum(const Placement& at) const {
    return reduce([&](Index begin, Index end) { return pairs().sum(at, begin, end); });
  }

  void measure_distances(const Placement& at, Index begin, Index end) {
    for_each_moved<double>(source_, at, begin, end, [&](Index i, const Eigen::Vector3d& p) {
      double squared = 0;
      for (int axis = 0; axis < 3; ++axis) {
        const double along = p[axis] - static_cast<double>(*matches_.positions().at(axis, i));
        squared += along * along;
      }
      squared_distances_[static_cast<std::size_t>(i)] = squared;
      kept_[static_cast<std::size_t>(i)] = squared <= squared_max_distance_ ? 1.0F : 0.0F;
    });
  }

  void add_prior(AlignmentEquations& sums, const SE3d& T) const {
    if constexpr (!std::same_as<typename Icp::PriorType, NoPrior>) {
      const PriorTerms terms = icp_.prior.evaluate(T);
      const Matrix6d from_target = transposed(tangent_to_source(T.rotation()));
      sums.hessian += congruent(from_target, terms.hessian);
      sums.gradient += product(from_target, terms.gradient);
      sums.cost += terms.cost;
    }
  }

  /// Takes tangents at T_target_source to motions of the pivot and about it, in the target's axes.
  [[nodiscard]] Matrix6d tangent_from_source(const SO3d& rotation) const {
    return SE3d(rotation, rotation * negative(source_.pivot)).adjoint();
  }
  /// The inverse of that.
  [[nodiscard]] Matrix6d tangent_to_source(const SO3d& rotation) const {
    return SE3d(rotation.inverse(), source_.pivot).adjoint();
  }
  /// A S A'
  [[nodiscard]] static Matrix6d congruent(const Matrix6d& A, const Matrix6d& S) {
    return product_transposed(product(A, S), A);
  }

  [[nodiscard]] SO3d turned(const Vector6d& step) const { return SO3d::exp(rotation_of(step)) * rotation_; }
  [[nodiscard]] Eigen::Vector3d shifted(const Vector6d& step) const { return pivot_ + translation_of(step); }

  [[nodiscard]] double share(Index points) const {
    return static_cast<double>(points) / static_cast<double>(source_.count);
  }

  [[nodiscard]] static constexpr double residuals_a_pair() {
    if constexpr (SurfaceMetric<Metric>)
      return Metric::residuals_a_pair;
    else
      return decltype(std::declval<Metric>().error(std::declval<Target>(), 0, Eigen::Vector3d()))::rows;
  }

  /// Of one residual, m^2, from those of all pairs less the unknowns.
  [[nodiscard]] double residual_variance() const {
    return sums_.weighted_square / std::max(residuals_a_pair() * sums_.weight - 6.0, 1.0);
  }

  const Icp& icp_;
  double threshold_;
  const SourceColumns& source_;
  const Target& target_;
  const Exec& executor_;
  Matches matches_;
  double squared_max_distance_ = 0;
  std::vector<float> kept_;
  std::vector<double> squared_distances_;
  SO3d rotation_;
  Eigen::Vector3d pivot_;  ///< of the source, in the target's frame
  AlignmentEquations sums_;
  RestrictedSystem system_{AlignmentEquations{}, 0.0, {true, true, true, true, true, true}};
  Index matched_ = 0;  ///< pairs near enough, rejected ones included
};

}  // namespace chainslam::detail
