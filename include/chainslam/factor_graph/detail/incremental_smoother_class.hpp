#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/between_factor.hpp"
#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/detail/factor_pools.hpp"
#include "chainslam/factor_graph/detail/held_components.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/prior_factor.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

namespace chainslam {

/// How `IncrementalSmoother` trades accuracy for time. Shares are of the squared error (chi^2).
struct SmootherOptions {
  /// By this share the estimate may be worse than the best one of the linearised factors.
  double linear_tolerance = 3e-5;
  /// A factor is linearised anew when its residual differs from the linear prediction by more than its part of this
  /// share. 0: always.
  double nonlinear_tolerance = 3e-5;
  /// A variable's factors are not looked at before its estimate has moved by this much (in the tangent space's units)
  /// since they were linearised, and then whenever it has moved half as far again.
  double first_look = 5e-3;
  /// Beyond this, a variable's factors are linearised anew in any case.
  double longest_step = 1.0;
  /// The shares are of a squared error of at least this.
  double least_error = 1e-3;
  /// At most so many variables' factors are linearised anew in an update; the rest wait for the next. It bounds the
  /// time of an update, and in long bursts saves work, since the rest is then nearer to where it will end.
  Index largest_relinearization = 300;
  /// Newest variables that are eliminated last.
  Index late_variables = 10;
};

enum class UpdateStatus {
  updated,
  unconstrained,  ///< no prior, no fixed variable and the like hold parts of the graph in all directions; `variables`
                  ///< has each one's least key, `free` the directions
  singular,    ///< a direction of variable `variables[0]` is not measured, given those eliminated before it
  not_finite,  ///< a residual is not a number: check values and measurements; `variables` has its factor's keys
};

/// What an update of `IncrementalSmoother` did.
struct UpdateReport {
  UpdateStatus status = UpdateStatus::updated;
  std::vector<Key> variables;
  std::vector<FreePart> free;  ///< what is free to move, if that made it fail; `describe` says it in words
  double squared_error = 0.0;  ///< chi^2 of the estimate, as the linearised factors see it
  double gap = 0.0;            ///< how much of it may be left to gain: by the linear system and by what still waits
  Index relinearized = 0;      ///< factors
  Index waiting = 0;           ///< variables whose factors wait to be linearised anew
  FactorizationWork work;

  [[nodiscard]] bool ok() const { return status == UpdateStatus::updated; }
};

/// When `converge` is done, and how it goes on where full steps fail.
struct ConvergeOptions {
  Index max_iterations = 50;
  /// Done when a full step is predicted to gain less than this share of the squared error,
  double relative_tolerance = 1e-9;
  /// or less than this.
  double absolute_tolerance = 1e-9;
  /// Whether optimisation may start again from the chordal relaxation, where full steps raise the squared error or it
  /// ends above what its degrees of freedom let expect. The lower optimum counts.
  bool restart = true;
};

/// What led to where `converge` ended: a local optimum always, not always the global one.
enum class ConvergeMethod {
  gauss_newton,         ///< full steps, from the estimate as it was
  levenberg_marquardt,  ///< damped steps, since a full one would have raised the squared error
  chordal_restart,      ///< damped steps from the chordal relaxation, which ended lower
};

struct ConvergeReport {
  UpdateStatus status = UpdateStatus::updated;
  std::vector<Key> variables;  ///< as in `UpdateReport`
  std::vector<FreePart> free;
  ConvergeMethod method = ConvergeMethod::gauss_newton;
  bool converged = false;  ///< else the iterations did not suffice
  Index iterations = 0;    ///< linear systems solved
  double initial_cost = 0.0;
  double final_cost = 0.0;  ///< chi^2 through the kernels
  double gap = 0.0;         ///< what the last step was predicted to gain, which bounds what is left to the optimum

  [[nodiscard]] bool ok() const { return status == UpdateStatus::updated; }
};

/// What a factor would do if it were added.
struct FactorForecast {
  double squared_residual = 0.0;  ///< at the estimate as it is
  /// What the squared error would rise by, with the factor and the rest giving way to each other: chi^2 distributed
  /// with as many degrees of freedom as the factor has rows, if it agrees with the rest.
  double rise = 0.0;
};

/// Keeps the best estimate of a growing factor graph (Kaess et al. 2012, "iSAM2", on `IncrementalCholesky`).
///
/// Values and factors that are added, and factors that are removed, wait for `update`. If that fails, they are dropped,
/// and all is as after the update before, bit for bit. An update costs what its changes reach. The same calls give the
/// same bits. Priors and between factors are always there; `Extra` adds more types of factors.
///
/// A factor is linearised anew where its own residual shows that it must be, not where its variables have moved: what
/// moves as a whole keeps its linearisation.
template <class Group, class... Extra>
class IncrementalSmoother {
  static_assert(LieGroup<Group>, "IncrementalSmoother: Group needs exp, log, adjoint and Jacobians, as in SE3d");
  static_assert((Factor<Extra> && ...),
                "IncrementalSmoother: a factor needs keys(), residual(values) and linearize(values)");

 public:
  using Value = Group;
  using Noise = NoiseModel<Group::dof>;
  using Tangent = typename Group::Tangent;

  explicit IncrementalSmoother(const SmootherOptions& options = {})
      : options_(options),
        solver_({.relative_excess = options.linear_tolerance,
                 .least_error = options.least_error,
                 .late_variables = options.late_variables}) {}

  /// @returns the new variable's key: 0, 1, ...
  Key add_value(const Group& initial) {
    begin();
    solver_.add_variable();
    look_.push_back(options_.first_look);
    waits_.push_back(0);
    if (!components_outdated_) components_.add_variable();
    const Key key = origins_.add(initial);
    estimates_.add(initial);
    changes_.push_back({ChangeKind::value_added, key, {}, 0.0});
    return key;
  }

  /// Adds a factor of any of the smoother's types.
  /// @throws std::invalid_argument if a key is unknown or repeated.
  template <Factor F>
  FactorId add(const F& factor) {
    static_assert(Pools::template has<F>, "IncrementalSmoother: name this type of factor in the smoother's Extra");
    const auto keys = factor.keys();
    require_keys(keys);
    begin();
    const Index term = solver_.add_term(keys, F::rows);
    const FactorId id = pools_.add(factor, term);
    if (term >= to_index(touched_.size())) touched_.resize(static_cast<std::size_t>(term) + 1, 0);
    touched_[static_cast<std::size_t>(term)] = 1;  // it will be linearised in any case
    changes_.push_back({ChangeKind::factor_added, term, {}, 0.0});
    if (!components_outdated_) components_.connect(factor, origins_);
    return id;
  }
  FactorId add_prior(Key key, const Group& mean, const Noise& noise) {
    return add(PriorFactor<Group>{key, mean, noise.sqrt_information()});
  }
  /// @param measurement  T_from_to
  FactorId add_between(Key from, Key to, const Group& measurement, const Noise& noise) {
    return add(BetweenFactor<Group>{from, to, measurement, noise.sqrt_information()});
  }

  /// @throws std::invalid_argument if there is no such factor (any longer).
  void remove(const FactorId& id) {
    if (!pools_.contains(id)) throw std::invalid_argument("IncrementalSmoother: there is no such factor");
    begin();
    pools_.visit_pool(id.type, [&](auto& pool) {
      const Index term = pool.at(id.slot).term;
      solver_.remove_term(term);
      pool.set_alive(id.slot, false);
      changes_.push_back({ChangeKind::factor_removed, term, {}, 0.0});
    });
    components_outdated_ = true;
  }

  /// Keeps a variable where it is, or lets it go again.
  void set_fixed(Key key, bool fixed = true) {
    require_keys(std::array<Key, 1>{key});
    if (solver_.is_fixed(key) == fixed) return;
    begin();
    relinearize_at_estimate(key);
    solver_.set_fixed(key, fixed);
    components_outdated_ = true;
  }
  [[nodiscard]] bool is_fixed(Key key) const { return solver_.is_fixed(key); }

  /// Takes in what was added and removed since the last update, and makes the estimate better.
  [[nodiscard]] UpdateReport update() { return update(false); }

  /// Moves variables as one body: x becomes motion * x. Factors between them that see no change cost nothing, so that a
  /// session is carried into another frame in closed form. Takes part in the next `update`.
  /// @throws std::invalid_argument if a key is unknown.
  void move(std::span<const Key> keys, const Group& motion);

  /// Makes all as it was before the last successful `update` and what was added for it, bit for bit; what was added
  /// since is dropped too. Only the last update can be undone.
  void undo() {
    revert();
    open_ = false;
  }

  /// Goes on to a local optimum of the squared error (chi^2, through the kernels), everything linearised anew at each
  /// step; takes in what was added. The squared error never rises. If it fails, the rest is as after `update`.
  ConvergeReport converge(const ConvergeOptions& options = {});

  /// The least key of each connected part that priors and the like do not hold in all directions, what was added
  /// included: if there is one, `update` would fail, and name them.
  [[nodiscard]] std::vector<Key> floating() { return find_floating(); }

  /// The estimate of a variable.
  [[nodiscard]] Group operator[](Key key) const {
    const Tangent step = Eigen::Map<const Tangent>(solver_.solution(key).data());
    return origins_[key].retract(step);
  }
  [[nodiscard]] Index size() const { return origins_.size(); }
  [[nodiscard]] Index factor_count() const { return pools_.count(); }
  /// How many factors there are of one type.
  template <Factor F>
  [[nodiscard]] Index count() const {
    return pools_.template count<F>();
  }
  [[nodiscard]] bool contains(const FactorId& id) const { return pools_.contains(id); }
  /// Keys whose estimate the last update changed; new ones may be missing, if they lie where they were put.
  [[nodiscard]] std::span<const Key> changed() const { return solver_.changed(); }

  /// All estimates.
  [[nodiscard]] Values<Group> values() const {
    Values<Group> all;
    for (Key key = 0; key < size(); ++key) all.add((*this)[key]);
    return all;
  }
  /// Sum of the squared whitened residuals (chi^2) of the estimate, through their kernels. Linear in the graph.
  [[nodiscard]] double cost() const {
    const Values<Group> all = values();
    double sum = 0.0;
    pools_.for_each([&](const auto& entry) { sum += detail::robust_cost(entry.factor, all); });
    return sum;
  }
  /// Covariance of the estimates of some variables together, as right perturbations, in the order of `keys` (without
  /// repetitions): by the linearised factors of the last update. Fixed variables have none. Costs the way to the root.
  /// @throws std::invalid_argument if a key is unknown.
  [[nodiscard]] Eigen::MatrixXd covariance(std::span<const Key> keys) const;
  [[nodiscard]] Eigen::MatrixXd covariance(Key key) const { return covariance(std::span<const Key>(&key, 1)); }
  /// The covariance of each variable by itself, all at once: for about two factorisations of everything.
  [[nodiscard]] std::vector<typename Group::Jacobian> marginals() const;

  /// What would happen if a factor on known variables were added, by the linearised factors of the last update.
  /// @throws std::invalid_argument if a key is unknown or repeated.
  template <Factor F>
  [[nodiscard]] FactorForecast what_if(const F& factor) const;

  /// The linear system behind.
  [[nodiscard]] const IncrementalCholesky<Group::dof>& solver() const { return solver_; }

 private:
  using Pools = detail::FactorPools<PriorFactor<Group>, BetweenFactor<Group>, Extra...>;
  static constexpr int dof = Group::dof;

  class View;

  enum class ChangeKind : char { value_added, factor_added, factor_removed, origin_moved, looked };
  struct Change {
    ChangeKind kind;
    Index id;      ///< key or term
    Group origin;  ///< before
    double look;   ///< before
  };

  template <std::size_t Arity>
  void require_keys(const std::array<Key, Arity>& keys) const {
    for (std::size_t i = 0; i < Arity; ++i) {
      if (!origins_.contains(keys[i]))
        throw std::invalid_argument("IncrementalSmoother: there is no variable " + std::to_string(keys[i]));
      for (std::size_t j = 0; j < i; ++j) {
        if (keys[i] == keys[j])
          throw std::invalid_argument("IncrementalSmoother: a factor names variable " + std::to_string(keys[i]) +
                                      " twice");
      }
    }
  }

  [[nodiscard]] UpdateReport update(bool exact);
  /// Derivative of a right perturbation of the estimate with respect to the linear system's step.
  [[nodiscard]] typename Group::Jacobian at_estimate(Key key) const {
    return Group::right_jacobian(Eigen::Map<const Tangent>(solver_.solution(key).data()));
  }
  void begin();
  void revert();
  void undo_change(const Change& change);

  [[nodiscard]] std::vector<Key> find_floating();

  void wait(Key key) {
    if (waits_[static_cast<std::size_t>(key)] != 0 || solver_.is_fixed(key)) return;
    waits_[static_cast<std::size_t>(key)] = 1;
    waiting_.push_back(key);
  }
  void relinearize_at_estimate(Key key) { relinearize_at(key, (*this)[key]); }
  void relinearize_at(Key key, const Group& origin);
  void relinearize_all();
  void damped_descent(Values<Group> start, const ConvergeOptions& options, ConvergeReport& report);
  void touch(Index term);
  [[nodiscard]] bool linearize_touched(UpdateReport& report);
  [[nodiscard]] bool linearize_added(UpdateReport& report);
  template <Factor F>
  [[nodiscard]] bool write(const typename detail::FactorPool<F>::Entry& entry, UpdateReport& report);
  void look_at_changed(UpdateReport& report);
  [[nodiscard]] double misprediction(Index term);
  void set_look(Key key, double look);

  SmootherOptions options_;
  IncrementalCholesky<dof> solver_;
  Values<Group> origins_;    ///< where the factors are linearised
  Values<Group> estimates_;  ///< scratch: up to date only where a factor is being looked at
  Pools pools_;
  std::vector<double> look_;  ///< of each variable: the step at which its factors are looked at
  std::vector<char> waits_;
  std::vector<Key> waiting_;
  std::vector<Key> waiting_before_;
  std::vector<char> touched_;  ///< of each term
  std::vector<Index> touched_terms_;
  std::vector<Change> changes_;
  detail::HeldComponents<Group> components_;
  bool components_outdated_ = false;
  bool open_ = false;  ///< whether changes wait for `update`
};

}  // namespace chainslam
