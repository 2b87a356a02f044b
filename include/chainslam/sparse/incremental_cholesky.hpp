#pragma once

#include <algorithm>
#include <cassert>
#include <mutex>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/concepts.hpp"
#include "chainslam/sparse/detail/change_journal.hpp"
#include "chainslam/sparse/detail/excess_tolerance.hpp"
#include "chainslam/sparse/detail/front.hpp"
#include "chainslam/sparse/detail/front_assembly.hpp"
#include "chainslam/sparse/detail/front_tree.hpp"
#include "chainslam/sparse/detail/near_variables.hpp"
#include "chainslam/sparse/detail/partial_elimination.hpp"
#include "chainslam/sparse/detail/path_solver.hpp"
#include "chainslam/sparse/detail/tree_inverse.hpp"

namespace chainslam {

/// Solves sum(J^T J) x = -sum(J^T r) over terms that come, change and go, each on a few variables of `BlockSize` rows.
///
/// Only what a change reaches is computed again: the fronts on the way from the changed variables to the root of the
/// elimination tree. Where the pattern changed, these are reordered among themselves, and keep what the subtrees
/// beside them have left (Kaess et al. 2012, "iSAM2"); where only numbers changed, the order stays; where only
/// gradients changed, so does the factor. Changes since `begin` can be undone. No recursion.
template <int BlockSize>
class IncrementalCholesky {
  static_assert(BlockSize > 0, "IncrementalCholesky: BlockSize is a number of scalar rows, at least 1");

 public:
  static constexpr int block_size = BlockSize;  ///< rows and columns of a block

  /// How it orders and updates.
  struct Options {
    /// A pivot counts as zero when elimination has left less than this share of the matrix's diagonal entry.
    double pivot_tolerance = 1e-14;
    /// Share of the squared error by which the solution may exceed its minimum: where the change is smaller, old parts
    /// of the solution are kept. 0: all are exact.
    double relative_excess = 1e-5;
    /// What a front may take of that for each block of its columns, which is what solving for them costs: this share of
    /// what is left,
    double block_share = 1e-3;
    /// and at most so many times a variable's mean. Where that is less, in large systems, fronts that took much are
    /// solved again when a tenth is left.
    double largest_excess = 40.0;
    /// The squared error of which these shares are taken at least.
    double least_error = 1e-3;
    /// Newest variables that are eliminated last, since the next terms are likely to touch them.
    Index late_variables = 10;
    /// Variables nearest to the newest in the graph that are eliminated late, where many are ordered: what comes next
    /// will touch these, and then not what lies beyond. More (as the square root) in systems of above 50 000 variables.
    Index near_variables = 100;
    /// So they are where few are ordered whose fronts take more multiplications than this;
    double near_work = 1e6;
    /// and above this, what lies beyond their surroundings comes first of all, unless these fronts then take more.
    double far_work = 1e7;
    /// How many times as many variables these are, listed around the newest whenever it has left their inner half.
    Index surroundings = 30;
    /// Fronts of more multiplications a variable are reordered whenever they are refactorized,
    double reorder_work = 20000.0;
    /// if they take more than this share of all multiplications: a way through a large tree keeps its order.
    double reorder_share = 0.3;
    /// In subtrees whose factorization takes less than this share of what a mean update must multiply, what a front
    /// leaves to its parent is not kept, but computed again when the parent is. More takes less memory, more time.
    double forgotten_share = 1.0;
    /// A factorization of fewer multiplications than this (a few tenths of a millisecond) is not worth waking threads.
    double least_shared_work = 2e6;
  };

  IncrementalCholesky() = default;
  [[gnu::cold]] explicit IncrementalCholesky(const Options& options) : options_(options) {}  ///< an empty system

  /// From here on, changes can be undone; those before no longer.
  void begin() {
    for (const Journal::Entry& entry : journal_.entries()) {
      if (entry.change == detail::Change::term_removed) terms_.release(entry.id);
      if (entry.change == detail::Change::node_removed) tree_.release(entry.id);
    }
    journal_.clear();
    surroundings_.begin();
    clear_changes();
    totals_before_ = totals_;
  }

  /// Makes everything as it was at `begin`, bit for bit.
  [[gnu::cold]] void rollback();

  /// @returns the new variable: 0, 1, ... Its solution is 0 until the next `solve`.
  Index add_variable() {
    const Index variable = size();
    fixed_.push_back(0);
    local_.push_back(-1);
    assembly_.add_variable();
    solution_.resize(solution_.size() + BlockSize);
    std::fill_n(solution_.data() + Offset{variable} * BlockSize, BlockSize, 0.0);
    terms_.add_variable();
    tree_.add_variable();
    journal_.add(detail::Change::variable_added, variable);
    reorder(variable);
    return variable;
  }
  [[nodiscard]] Index size() const { return to_index(fixed_.size()); }  ///< number of variables

  /// Takes a variable out of the system (its solution is 0), or puts it back.
  void set_fixed(Index variable, bool fixed) {
    if (is_fixed(variable) == fixed) return;
    journal_.add(detail::Change::variable_fixed, variable);
    fixed_[variable] = fixed ? 1 : 0;
    if (fixed) set_solution_zero(variable);
    reorder(variable);
    for (Index k = terms_.first(variable); k != -1; k = terms_.slot(k).next) reorder_term(terms_.slot(k).term);
  }
  /// Whether a variable is kept where it is.
  [[nodiscard]] bool is_fixed(Index variable) const { return fixed_[variable] != 0; }

  /// Adds a term on some variables; its numbers are zero.
  /// @returns its number; those of removed terms are used again.
  Index add_term(std::span<const Index> variables, Index rows) {
    const Index term = terms_.add(variables, rows);
    journal_.add(detail::Change::term_added, term);
    written_.push_back(term);
    reorder_term(term);
    return term;
  }
  /// Removes a term's part of the matrix.
  void remove_term(Index term) {
    terms_.unlink(term);
    discount(term);
    journal_.add(detail::Change::term_removed, term);
    reorder_term(term);
  }
  [[nodiscard]] const detail::BlockTerms<BlockSize>& terms() const { return terms_; }  ///< the terms of the system

  /// To be called before `jacobian` and `residual` of a term are written, unless the term is new.
  void change_term(Index term) {
    journal_.add_numbers(detail::Change::term_numbers, term,
                         {terms_.jacobian(term), static_cast<std::size_t>(terms_.size(term))});
    discount(term);
    written_.push_back(term);
    for (const auto& slot : terms_.slots(term)) mark(tree_.node_of(slot.variable), Stale::numbers);
  }
  /// J^T, column-major: `BlockSize` rows for each variable, a column for each residual row.
  [[nodiscard]] double* jacobian(Index term) { return terms_.jacobian(term); }
  /// r
  [[nodiscard]] double* residual(Index term) { return terms_.residual(term); }

  /// A variable's solution is counted from another point from now on: it becomes 0. All its terms must change too.
  void set_solution_zero(Index variable) {
    journal_.add_numbers(detail::Change::solution, variable, solution(variable));
    std::fill_n(solution_.data() + Offset{variable} * BlockSize, BlockSize, 0.0);
  }

  /// Adds `factor` times its own diagonal to the matrix from the next `factorize` on (Marquardt 1963). For systems that
  /// are never rolled back nor saved, get no more variables, and are not asked for their squared error or excess: from
  /// here on changes cannot be undone, and each `solve` is exact.
  void set_damping(double factor) {
    journal_.leave_numbers_out();
    damping_ = factor;
    diagonal_.resize(solution_.size(), 0.0);
    for (Index variable = 0; variable < size(); ++variable) mark(tree_.node_of(variable), Stale::numbers);
  }
  /// A variable's part of the diagonal of J^T J, as the last damped `factorize` found it; zeros where it is fixed.
  [[nodiscard]] const double* diagonal(Index variable) const { return diagonal_.data() + Offset{variable} * BlockSize; }

  /// All variables are reordered by the next `factorize`.
  void reorder_all() {
    for (Index variable = 0; variable < size(); ++variable) reorder(variable);
  }

  /// Whether fronts keep what they leave to their parents, as they do at first. Where they do not, it takes no memory,
  /// and all is computed again by the next `factorize`: for callers who change all terms each time.
  void keep_updates(bool keep);

  /// Brings the factor up to date: where that is much work, subtrees and the columns of large fronts are shared out by
  /// an executor, bit-identically for any. If it fails, `rollback` is due.
  template <Executor Exec = Serial>
  [[nodiscard]] FactorizationResult factorize(const Exec& executor = {});

  /// Brings the solution up to date, as far as it changes.
  /// @param exact  all that changes at all, whatever the options tolerate.
  void solve(bool exact = false);

  /// The least sum of |r + J x|^2.
  [[nodiscard]] double squared_error() const { return totals_.squared_residuals - totals_.lowered; }
  [[nodiscard]] double lowered() const { return totals_.lowered; }  ///< what the exact solution lowers the sum by
  [[nodiscard]] double excess() const { return totals_.excess; }    ///< what the solution at hand exceeds it by

  /// Of the last `solve`.
  [[nodiscard]] std::span<const double> solution(Index variable) const {
    return solution_.range(Offset{variable} * BlockSize, Offset{variable} * BlockSize + BlockSize);
  }
  /// E^T H^-1 E with the matrix H of the last `factorize`. E has `BlockSize` rows for each of `variables`, none of
  /// which is fixed; both are column-major. Costs the ways from there to the root.
  [[gnu::cold]] void inverse_product(std::span<const Index> variables, const double* E, Index columns,
                                     double* product) const {
    detail::PathSolver<BlockSize>(tree_, variables).inverse_product(variables, E, columns, product);
  }
  /// Calls visit(node, Z, stride) for each front of `tree`: Z is H^-1 among its variables, column-major.
  void for_each_inverse(auto&& visit) const { detail::TreeInverse<BlockSize>(tree_, size()).run(visit); }
  /// The diagonal blocks of H^-1, column-major, at `BlockSize`^2 times their variable's number; zeros for what is not
  /// eliminated. Costs, as `for_each_inverse` does, about two factorizations of everything; allocates.
  [[nodiscard]] std::vector<double> inverse_diagonal() const {
    return detail::TreeInverse<BlockSize>(tree_, size()).diagonal();
  }
  /// Whether a variable was part of the last `factorize`, neither new nor fixed.
  [[nodiscard]] bool is_eliminated(Index variable) const { return tree_.node_of(variable) != -1; }
  /// Whether the next `factorize` will recompute what a variable leaves to others, or eliminates it at all.
  [[nodiscard]] bool is_due(Index variable) const {
    const Index node = tree_.node_of(variable);
    return node == -1 || tree_[node].stale != Stale::none;
  }
  /// Calls visit(variable) for those that are due because of the changes made so far, new ones left out.
  template <class Visit>
  void for_each_due(Visit&& visit) const {
    for (const Index node : stale_) {
      for (const Index variable : tree_.columns(node)) visit(variable);
    }
  }
  /// Variables whose solution the last `solve` changed.
  [[nodiscard]] std::span<const Index> changed() const { return changed_.range(0, changed_.size()); }
  /// Of the last `factorize` and `solve`.
  [[nodiscard]] const FactorizationWork& work() const { return work_; }
  void reset_work() { work_ = {}; }  ///< sets the figures of its work to zero
  [[nodiscard]] const detail::FrontTree<BlockSize>& tree() const { return tree_; }  ///< the elimination tree

  /// Everything as it is after `solve`, but for what could be undone.
  void save(ByteSink& out) const;
  /// What `save` wrote, of a system with the same options: what follows is bit-identical. Costs a factorization.
  void load(ByteSource& in);

 private:
  using Journal = detail::ChangeJournal;
  using Assembly = detail::FrontAssembly<BlockSize>;
  using Front = detail::Front<BlockSize>;
  using Stale = detail::Stale;

  struct Totals {
    double squared_residuals = 0.0;
    double lowered = 0.0;
    double excess = 0.0;
    double multiplications = 0.0;
    Index factorizations = 0;
    Index nodes = 0;
  };

  [[nodiscard]] bool damped() const { return !diagonal_.empty(); }

  void discount(Index term) {
    if (terms_.counted(term)) totals_.squared_residuals -= terms_.squared_residual(term);
    terms_.set_counted(term, false);
  }

  void reorder(Index variable) {
    reordered_.push_back(variable);
    mark(tree_.node_of(variable), Stale::order);
  }
  void reorder_term(Index term) {
    for (const auto& slot : terms_.slots(term)) reorder(slot.variable);
  }

  /// Marks a node and all above it.
  void mark(Index node, Stale stale) {
    for (; node != -1 && tree_[node].stale < stale; node = tree_[node].parent) {
      if (tree_[node].stale == Stale::none) stale_.push_back(node);
      tree_[node].stale = stale;
    }
  }

  void clear_changes();
  /// Where factorization costs much more than ordering, it is worth looking for a better order each time.
  void promote_heavy();
  /// Where much is reordered, what is nearest to the newest is too, and late: the next closures then reach little else.
  void reorder_near();
  /// Removes the nodes that are to be reordered; lists their variables and the subtrees that they leave.
  void collect_affected();

  /// Sorts the affected variables: those that are to be eliminated late behind the others.
  void sort_affected();
  [[nodiscard]] Index near_count() const;
  void affect(Index variable) {
    if (is_fixed(variable)) tree_.set_node_of(variable, -1);
    if (is_fixed(variable) || local_[variable] != -1) return;
    local_[variable] = 0;
    affected_.push_back(variable);
  }

  /// Lists the nodes on the stack and below, as far as `descends` says of a child, children first.
  template <class Descends>
  void list_below(detail::Table<Index>& nodes, Descends&& descends);
  /// Discards what the children of a node in a small subtree have left, once it is taken.
  void forget_updates(Index node, std::mutex* memory = nullptr);

  /// Lists the nodes that stay in the tree and are stale, and before each those below that have not kept what it needs
  /// of them: these are recomputed, bit-identically.
  void list_refreshed();

  /// Orders the affected variables and makes their nodes.
  void order_affected();
  void create_nodes();
  /// Adds the damping of a front's own columns, whose diagonal is complete, to it.
  void damp(Index node, const Front& front);

  /// Assembles a node's front and factorizes it.
  /// @param memory  null where no other thread computes.
  template <Executor Exec = Serial>
  [[nodiscard]] FactorizationResult compute(Index node, Assembly& assembly, std::mutex* memory = nullptr,
                                            const Exec& executor = {});
  [[nodiscard]] FactorizationResult compute(Index node) { return compute(node, assembly_); }
  /// Computes nodes, children before parents, and forgets what they leave where it is not to be kept.
  template <Executor Exec>
  [[nodiscard]] FactorizationResult compute_all(std::span<const Index> nodes, const Exec& executor);

  struct PartResult {
    Index stop;  ///< place of the node that failed, or where to stop in any case
    FactorizationResult result;
  };
  template <Executor Exec>
  [[nodiscard]] FactorizationResult compute_parts(std::span<const Index> nodes, const Exec& executor);
  /// Places in `nodes` of subtrees that may be computed at the same time; last, of what is above them.
  [[nodiscard]] std::vector<std::vector<Index>> parts_of(std::span<const Index> nodes);
  /// Computes the nodes at some places, up to the first that fails or place `stop`.
  /// @param memory  held where memory is taken or given back.
  template <Executor Exec>
  [[nodiscard]] PartResult compute_part(std::span<const Index> nodes, std::span<const Index> places, Index stop,
                                        std::mutex& memory, const Exec& executor);

  /// Solves for a node's columns, given all above; keeps their old solution if it is nearly as good.
  void substitute(Index node);
  /// Whether a node's numbers or its rows' solution have changed.
  [[nodiscard]] bool is_outdated(Index node) const;
  /// Substitutes nodes on the stack and below: those that `solves` says, as far as `descends` says of a child.
  template <class Solves, class Descends>
  void substitute_below(Solves&& solves, Descends&& descends);
  /// Solves again for the nodes whose excess is more than tolerated, and what follows from that.
  void lower_excess(const detail::ExcessTolerance& tolerance);
  /// Whether a front keeps its solution for certain, however its rows' have moved.
  [[nodiscard]] bool keeps(Index node);
  void set_excess(Index node, double excess);

  [[gnu::cold]] void undo(const Journal::Entry& entry);
  [[gnu::cold]] void compute_restored();

  Options options_;
  detail::BlockTerms<BlockSize> terms_;
  detail::FrontTree<BlockSize> tree_;
  Assembly assembly_;
  std::vector<Assembly> assemblies_;  ///< of threads, while none of them needs it
  detail::Table<Index> place_of_;     ///< of nodes that are listed, in their order; -1 else
  Journal journal_;
  detail::PartialElimination plan_;
  detail::Table<char> fixed_;
  detail::Table<double> solution_;
  detail::Table<Index> local_;  ///< of each affected variable: its number among them; -1 else
  detail::Table<Index> reordered_;
  detail::Table<Index> stale_;
  detail::Table<Index> fresh_;
  detail::Table<Index> affected_;
  detail::Table<Index> late_;  ///< places among them from which on they are eliminated late, and later still
  detail::NearVariables<BlockSize> near_;
  detail::Surroundings<BlockSize> surroundings_;
  bool far_ = false;  ///< whether what lies beyond these comes first
  detail::Table<Index> orphans_;
  detail::Table<Index> ready_;
  detail::Table<Index> stack_;
  detail::Table<Index> changed_;  ///< `local_` of these: their places here
  detail::Table<double> moves_;   ///< of their solutions' coordinates, sizes
  detail::Table<Index> written_;
  detail::Table<Index> recalled_;
  detail::Table<Index> recomputed_;  ///< nodes whose numbers a rollback has to compute again, last first,
  detail::Table<Index> restored_;    ///< and those that it brings back
  detail::Table<double> gathered_;
  detail::Table<double> diagonal_;  ///< of J^T J, of each scalar row; empty: no damping
  Totals totals_;
  Totals totals_before_;
  detail::ExcessTolerance tolerance_;
  double damping_ = 0.0;
  bool keeps_updates_ = true;
  FactorizationWork work_;
};

}  // namespace chainslam

// Bodies of its members.
#include "chainslam/sparse/detail/incremental_cholesky_compute.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_rollback.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_solve.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_update.hpp"
