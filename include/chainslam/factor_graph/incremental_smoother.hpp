#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/constrained_factor.hpp"
#include "chainslam/factor_graph/detail/cost_sum.hpp"
#include "chainslam/factor_graph/detail/factor_pools.hpp"
#include "chainslam/factor_graph/detail/held_components.hpp"
#include "chainslam/factor_graph/detail/linearization.hpp"
#include "chainslam/factor_graph/detail/waiting_list.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/smoother_reports.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

namespace chainslam {

/// Keeps the best estimate of a growing factor graph (Kaess et al. 2012, "iSAM2", on `IncrementalCholesky`).
///
/// Values and factors that are added, and factors that are removed, wait for `update`. If that fails, they are dropped,
/// and all is as after the update before, bit for bit. An update costs what its changes reach. Deterministic: the same
/// calls give bit-identical results. Priors and between factors are built in; `Extra` adds more types of factors.
///
/// A factor is relinearized where its own residual requires it, not where its variables have moved: variables that move
/// as a whole keep their linearization.
template <class Group, class... Extra>
class IncrementalSmoother {
  static_assert(
      LieGroup<Group>,
      "IncrementalSmoother: Group needs exp, log, adjoint and Jacobians, as in SE3d; see chainslam/lie/concepts.hpp");
  static_assert((Factor<Extra> && ...),
                "IncrementalSmoother: a factor needs keys(), residual(values) and linearize(values); see "
                "chainslam/factor_graph/values.hpp");

 public:
  using Value = Group;                      ///< type of the variables
  using Noise = NoiseModel<Group::dof>;     ///< noise of a factor with a row for each degree of freedom
  using Tangent = typename Group::Tangent;  ///< tangent of a variable

  IncrementalSmoother();
  explicit IncrementalSmoother(const SmootherOptions& options);  ///< an empty smoother
  /// A smoother that keeps all variables: what a lag needs is then not compiled.
  /// @throws std::invalid_argument if the options set a lag.
  IncrementalSmoother(const SmootherOptions& options, NoLag);
  IncrementalSmoother(IncrementalSmoother&&);             ///< takes over the other's state
  IncrementalSmoother& operator=(IncrementalSmoother&&);  ///< takes over the other's state
  [[gnu::cold]] ~IncrementalSmoother();

  /// @returns the new variable's key: 0, 1, ...
  Key add_value(const Group& initial);

  /// Adds a factor of any of the smoother's types.
  /// @throws std::invalid_argument if a key is unknown or repeated.
  template <Factor F>
  FactorId add(const F& factor);
  /// The same, to count with a weight from the start (`set_weight`).
  template <Factor F>
  FactorId add(const F& factor, double weight);
  /// Adds a prior: the variable is `mean`, up to `noise`. @throws std::invalid_argument if the key is unknown.
  FactorId add_prior(Key key, const Group& mean, const Noise& noise);
  /// @param measurement  T_from_to
  FactorId add_between(Key from, Key to, const Group& measurement, const Noise& noise);

  /// Adds all of another graph in one go, such as a session that was saved: values, factors with names of their own,
  /// and what is fixed. Its factors' members of type `Key` are their keys.
  /// @param graph  a `FactorGraph`, another smoother, or anything with their `values`, `is_fixed` and
  /// `for_each_factor`.
  /// @returns the key of its first variable; the others follow in their order.
  template <class Graph>
  Key append(const Graph& graph);

  /// @throws std::invalid_argument if there is no such factor (any longer).
  void remove(const FactorId& id);

  /// Lets a factor's squared residual count so many times from the next update on: 0 switches it off, 1 is as it was
  /// added. It keeps its name. For factors with `sqrt_information` and without a kernel.
  /// @throws std::invalid_argument if there is no such factor, or it has a kernel, or the weight is negative.
  void set_weight(const FactorId& id, double weight);
  /// @throws std::invalid_argument if there is no such factor.
  [[nodiscard]] double weight(const FactorId& id) const;

  /// Marginalizes variables (Schur complement): a linear factor on their neighbours, about the present estimate,
  /// replaces all factors on them. Takes part in the next `update`; later ones cost nothing for them. They keep their
  /// last estimate and no factor may name them; the names of other variables do not change.
  /// @throws std::invalid_argument if a key is unknown.
  void marginalize(std::span<const Key> keys);
  /// Whether `marginalize` was called for it.
  [[nodiscard]] bool is_marginalized(Key key) const { return marginalized_[key] != 0; }

  /// Keeps a variable where it is, or lets it go again.
  void set_fixed(Key key, bool fixed = true);
  /// Whether a variable is kept where it is.
  [[nodiscard]] bool is_fixed(Key key) const { return solver_.is_fixed(key); }

  /// Takes in what was added and removed since the last update, and makes the estimate better. An executor shares out
  /// large factorizations; any gives bit-identical results.
  template <Executor Exec = Serial>
  [[nodiscard]] UpdateReport update(const Exec& executor = {});

  /// Moves variables as one body: x becomes motion * x. Factors between them that see no change cost nothing, so that a
  /// session is carried into another frame in closed form. Takes part in the next `update`.
  /// @throws std::invalid_argument if a key is unknown.
  [[gnu::cold]] void move(std::span<const Key> keys, const Group& motion);

  /// Makes all as it was before the last successful `update` and what was added for it, bit for bit; what was added
  /// since is dropped too. Only the last update can be undone.
  void undo();
  /// The last update cannot be undone from here on, unless something was added since: gives back the memory for that.
  void commit() { begin(); }

  /// Goes on to a local optimum of the squared error (chi^2, through the kernels), everything relinearized at each
  /// step; takes in what was added. The squared error never rises. If it fails, the rest is as after `update`.
  /// Constraints then hold; their multipliers are part of the state.
  template <class Restart = ChordalRestart, Executor Exec = Serial>
  [[gnu::cold]] ConvergeReport converge(const ConvergeOptions<Restart>& options = {}, const Exec& executor = {});

  /// The least key of each connected part that priors and the like do not hold in all directions, what was added
  /// included: if there is one, `update` would fail, and name them.
  [[nodiscard]] std::vector<Key> floating() { return find_floating(); }

  /// The estimate of a variable.
  [[nodiscard]] Group operator[](Key key) const { return estimates_[key]; }
  [[nodiscard]] Index size() const { return origins_.size(); }         ///< number of variables
  [[nodiscard]] Index factor_count() const { return pools_.count(); }  ///< number of factors
  /// How many factors there are of one type.
  template <Factor F>
  [[nodiscard]] Index count() const {
    return pools_.template count<F>();
  }
  /// Whether there is such a factor.
  [[nodiscard]] bool contains(const FactorId& id) const { return pools_.contains(id); }
  /// Keys whose estimate the last update changed; new ones may be missing, if they lie where they were put.
  [[nodiscard]] std::span<const Key> changed() const { return solver_.changed(); }

  /// Grows by one with each update, and by more with what changes estimates otherwise.
  [[nodiscard]] std::uint64_t revision() const { return revision_; }

  /// Calls visit(factor) for each factor, as it counts, type by type.
  template <class Visit>
  void for_each_factor(Visit&& visit) const {
    pools_.for_each([&](const auto& entry) { detail::visit_weighed(entry, visit); });
  }
  /// All estimates.
  [[nodiscard]] Values<Group> values() const { return estimates_; }
  /// Sum of the squared whitened residuals (chi^2) of the estimate, through their kernels. Linear in the graph.
  [[nodiscard]] double cost() const { return pools_.cost(estimates_); }
  /// The same, for who asks often: costs what has changed since the last time. Rounding adds up over the calls.
  [[nodiscard]] [[gnu::cold]] double current_cost();
  /// Covariance of the estimates of some variables together, as right perturbations, in the order of `keys` (without
  /// repetitions): by the linearized factors of the last update. Fixed variables have none. Costs the way to the root.
  /// @throws std::invalid_argument if a key is unknown.
  [[nodiscard]] Eigen::MatrixXd covariance(std::span<const Key> keys) const;
  /// Covariance of one variable's estimate, as a right perturbation.
  [[nodiscard]] Eigen::MatrixXd covariance(Key key) const { return covariance(std::span<const Key>(&key, 1)); }
  /// Covariance of x_from^-1 x_to, as a right perturbation: zero if they are one.
  /// @throws std::invalid_argument if a key is unknown.
  [[nodiscard]] [[gnu::cold]] typename Group::Jacobian relative_covariance(Key from, Key to) const;
  /// Whether covariances know the variable: it is not fixed, and an update has taken it in.
  [[nodiscard]] bool has_covariance(Key key) const { return solver_.is_eliminated(key); }
  /// The covariance of each variable by itself, all at once: for about two factorizations of everything.
  [[nodiscard]] std::vector<typename Group::Jacobian> marginals() const;

  /// What would happen if a factor on known variables were added, by the linearized factors of the last update.
  /// @throws std::invalid_argument if a key is unknown or repeated.
  template <Factor F>
  [[nodiscard]] [[gnu::cold]] FactorForecast what_if(const F& factor) const;
  /// What the squared error would rise by if several factors were added together.
  template <Factor F>
  [[nodiscard]] [[gnu::cold]] JointForecast rise_with(std::span<const F> factors) const;
  /// What it would fall by if several factors of the graph, which count in full, were taken out together; NaN if
  /// nothing else holds what they hold.
  template <Factor F>
  [[nodiscard]] [[gnu::cold]] JointForecast fall_without(std::span<const F> factors) const;
  class Leverages;  ///< of factors: how much of each the rest of the graph and itself know, by the hat matrix
  /// Grows whenever the graph may have come to know less: factors removed, weights lowered, variables moved.
  [[nodiscard]] std::uint64_t losses() const { return losses_; }

  /// The whole state as bytes, the same on every machine: values and where they are linearized, factors with their
  /// names and weights, what is fixed or waits, and the order of elimination; not what `undo` would need. Types of
  /// factors of one's own have `visit_members(self, visit)`, as `BetweenFactor` has.
  /// @throws std::invalid_argument if changes wait for `update`.
  [[nodiscard]] std::vector<std::byte> save() const;
  /// A smoother that continues bit-identically from what was saved. Costs a factorization of everything.
  /// @param name  what the bytes are called in messages.
  /// @throws IoError if the bytes are not whole, or those of a smoother of another type.
  [[nodiscard]] static IncrementalSmoother load(std::span<const std::byte> bytes,
                                                const std::string& name = "saved IncrementalSmoother");

  /// The linear system behind.
  [[nodiscard]] const IncrementalCholesky<Group::dof>& solver() const { return solver_; }

 private:
  using Pools = detail::FactorPools<PriorFactor<Group>, BetweenFactor<Group>, Extra..., LinearPrior<Group>>;
  static constexpr int dof = Group::dof;
  class View;

  enum class ChangeKind : char {
    value_added,
    factor_added,
    factor_removed,
    factor_weighed,
    factor_tightened,
    origin_moved,
    looked,
    judged,
    marginalized
  };
  struct Change {
    ChangeKind kind;
    Index id;     ///< key or term
    double look;  ///< or weight, how far a term is off, or number of a constraint's multipliers, before
  };

  [[noreturn]] [[gnu::cold]] [[gnu::noinline]] static void refuse(const char* why) {
    throw std::invalid_argument(std::string("IncrementalSmoother: ").append(why));
  }
  [[noreturn]] [[gnu::cold]] [[gnu::noinline]] static void refuse(const char* before, Key key, const char* after = "") {
    refuse(std::string(before).append(std::to_string(key)).append(after).c_str());
  }
  void require_known(Key key) const {
    if (!origins_.contains(key)) refuse("there is no variable ", key);
  }
  /// Of a factor.
  void require_keys(std::span<const Key> keys) const;
  [[nodiscard]] Index term_of(const FactorId& id) const {
    if (!pools_.contains(id)) refuse("there is no such factor");
    return pools_.pool(id.type).term(id.slot);
  }
  /// The term of a factor to be added, and what is kept of it once it is.
  [[nodiscard]] Index begin_term(std::span<const Key> keys, Index rows);
  void note_added(Index term);
  void remove_term(Index term);
  void recount(Index term);
  void set_alive(Index term, bool alive) {
    const auto place = pools_.place(term);
    pools_.pool(place.type).set_alive(place.slot, alive);
  }
  void release(Index term) {
    const auto place = pools_.place(term);
    pools_.pool(place.type).release(place.slot);
  }
  void weigh_term(Index term, double weight) {
    const auto place = pools_.place(term);
    pools_.pool(place.type).set_weight(place.slot, weight);
  }
  [[nodiscard]] detail::FactorTraits traits(Index term) const { return pools_.pool(pools_.place(term).type).traits(); }

  /// @param exact  everything that waits is relinearized, and all that changes at all is solved for.
  template <Executor Exec>
  [[nodiscard]] UpdateReport update_to(bool exact, const Exec& executor);
  /// Derivative of a right perturbation of the estimate with respect to the linear system's step.
  [[nodiscard]] typename Group::Jacobian at_estimate(Key key) const {
    return Group::right_jacobian(matrix_of<Tangent>(solver_.solution(key).data()));
  }
  template <Factor F>
  [[nodiscard]] [[gnu::cold]] JointForecast forecast(std::span<const F> factors, double sign) const;
  /// r^T (I + sign J H^-1 J^T)^-1 r for a J of these variables. @param residual  is overwritten.
  [[nodiscard]] [[gnu::cold]] JointForecast forecast(std::span<const Key> keys, std::span<const double> jacobian,
                                                     std::span<double> residual, double sign) const;
  template <class Archive>
  static void visit_options(SmootherOptions& options, Archive&& archive);
  void marginalize_old();
  /// `marginalize_old`, or null where no lag can be set, so that programs without one do not compile it.
  using MarginalizeOld = void (IncrementalSmoother::*)();
  [[gnu::cold]] IncrementalSmoother(const SmootherOptions& options, MarginalizeOld by_lag);
  void begin();
  [[gnu::cold]] void revert();
  [[gnu::cold]] void undo_change(const Change& change);

  [[nodiscard]] std::vector<Key> find_floating();
  [[nodiscard]] std::vector<Key> find_all_floating();
  [[nodiscard]] bool matters_to_components(Index term);
  void tie(Index term);
  void hold(Index term);
  [[nodiscard]] [[gnu::cold]] std::vector<FreePart> open_parts() const;
  /// Of a term, in the order of its factor.
  void list_keys(Index term, std::vector<Key>& keys) const {
    keys.clear();
    for (const auto& slot : solver_.terms().slots(term)) keys.push_back(slot.variable);
  }

  void wait(Key key) {
    if (!waiting_.waits(key) && !solver_.is_fixed(key)) waiting_.wait(key);
  }
  void relinearize_waiting(bool exact);
  /// Whether all that waits is worth its linearization.
  [[nodiscard]] bool impatient() const;
  [[nodiscard]] bool all_due(Key key) const;
  void set_off(Index term, double off);
  void relinearize_at_estimate(Key key) { relinearize_at(key, (*this)[key]); }
  void estimate(Key key);
  void estimate_all() {
    for (Key key = 0; key < size(); ++key) estimate(key);
  }
  void relinearize_at(Key key, const Group& origin);
  void relinearize_all();
  static constexpr bool any_constraint = (detail::is_constraint<Extra> || ...);
  template <class Restart, Executor Exec>
  [[nodiscard]] [[gnu::cold]] ConvergeReport converge_penalized(const ConvergeOptions<Restart>& options,
                                                                const Exec& executor);
  [[nodiscard]] double violation() const;
  void tighten();
  void restore_multipliers(const Change& change);
  template <class Restart, Executor Exec>
  [[gnu::cold]] void damped_descent(Values<Group> start, const ConvergeOptions<Restart>& options,
                                    ConvergeReport& report, const Exec& executor);
  void touch(Index term);
  [[nodiscard]] bool linearize_touched(UpdateReport& report);
  [[nodiscard]] bool linearize_added(UpdateReport& report);
  [[nodiscard]] bool write(Index term, UpdateReport& report);
  void look_at_changed(UpdateReport& report);
  [[nodiscard]] double misprediction(Index term);
  void set_look(Key key, double look);

  SmootherOptions options_;
  MarginalizeOld marginalize_old_;
  IncrementalCholesky<dof> solver_;
  Values<Group> origins_;    ///< where the factors are linearized
  Values<Group> estimates_;  ///< these, moved by the linear system's solution
  Pools pools_;
  detail::Table<double> look_;        ///< of each variable: the step at which its factors are looked at
  detail::Table<char> marginalized_;  ///< of each variable
  detail::WaitingList waiting_;       ///< to be relinearized
  detail::Table<Key> far_;            ///< of the waiting: have moved by more than the longest step
  detail::Table<double> off_;         ///< of each term for which variables wait: squared error of its linear prediction
  double waiting_gap_ = 0.0;          ///< their sum
  detail::Table<Key> far_before_;
  double waiting_gap_before_ = 0.0;
  detail::Table<char> touched_;  ///< of each term
  detail::Table<Index> touched_terms_;
  detail::Table<Change> changes_;
  std::vector<Group> origins_before_;         ///< of those that were moved, in their order
  detail::Table<double> multipliers_before_;  ///< of constraints that were tightened since the last update
  std::vector<Key> keys_;                     ///< of the term at hand
  detail::Table<double> numbers_;             ///< of the term at hand, or its residual
  detail::CostSum costs_;                     ///< of `current_cost`
  detail::HeldComponents<Group> components_;
  bool components_outdated_ = false;
  Key oldest_ = 0;  ///< none before it is kept by `SmootherOptions::lag`
  std::uint64_t revision_ = 0;
  std::uint64_t losses_ = 0;
  bool open_ = false;  ///< whether changes wait for `update`
};

template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...>::IncrementalSmoother() : IncrementalSmoother({}, NoLag{}) {}

template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...>::IncrementalSmoother(const SmootherOptions& options)
    : IncrementalSmoother(options, &IncrementalSmoother::marginalize_old) {}

template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...>::IncrementalSmoother(const SmootherOptions& options, NoLag)
    : IncrementalSmoother(options, nullptr) {
  if (options.lag > 0) refuse("a lag was set where there is to be none");
}

template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...>::IncrementalSmoother(const SmootherOptions& options, MarginalizeOld by_lag)
    : options_(options),
      marginalize_old_(by_lag),
      solver_({.relative_excess = options.linear_tolerance,
               .least_error = options.least_error,
               .late_variables = options.late_variables,
               .forgotten_share = options.forgotten_share}) {}

// Out of the class, so that they are compiled once where the library holds a smoother.
template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...>::IncrementalSmoother(IncrementalSmoother&&) = default;
template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...>& IncrementalSmoother<Group, Extra...>::operator=(IncrementalSmoother&&) = default;
template <class Group, class... Extra>
IncrementalSmoother<Group, Extra...>::~IncrementalSmoother() = default;

}  // namespace chainslam

// Bodies of its members.
#include "chainslam/factor_graph/detail/incremental_smoother_changes.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_converge.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_leverages.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_queries.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_update.hpp"
