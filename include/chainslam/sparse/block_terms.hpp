#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/detail/arena.hpp"

namespace chainslam::detail {

/// The terms J^T J and J^T r whose sums are a matrix and a gradient, each on a few block variables.
///
/// Of each term the transposed Jacobian is kept, column-major with a column for each residual row, and the residual.
/// Each variable has a list of its terms. A term may be taken out of the lists and put back: if that is done in the
/// opposite order, the lists are as they were.
template <int B>
class BlockTerms {
 public:
  struct Slot {
    Index variable;
    Index term;
    Index next;  ///< in the list of the variable; -1 at its end
    Index previous;
  };

  void add_variable() { first_.push_back(-1); }
  void drop_last_variable() { first_.pop_back(); }

  /// @returns the new term, linked; its numbers are zero.
  Index add(std::span<const Index> variables, Index rows) {
    const Index arity = to_index(variables.size());
    const Index term = take(arity);
    Term& added = terms_[term];
    added.rows = rows;
    added.counted = false;
    added.data = arena_.take(size(term));
    std::fill_n(added.data, size(term), 0.0);
    for (Index k = 0; k < arity; ++k) slots_[added.first_slot + k].variable = variables[static_cast<std::size_t>(k)];
    link(term);
    return term;
  }

  /// Gives a term's memory and number back; it must not be linked.
  void release(Index term) {
    Term& released = terms_[term];
    arena_.give_back(released.data, size(term));
    released.data = nullptr;
    if (released.arity >= to_index(free_.size())) free_.resize(static_cast<std::size_t>(released.arity) + 1);
    free_[static_cast<std::size_t>(released.arity)].push_back(term);
  }

  void link(Index term) {
    terms_[term].linked = true;
    for (Offset k = terms_[term].first_slot; k < end_slot(term); ++k) {
      Slot& slot = slots_[k];
      slot.previous = -1;
      slot.next = first_[slot.variable];
      if (slot.next != -1) slots_[slot.next].previous = static_cast<Index>(k);
      first_[slot.variable] = static_cast<Index>(k);
    }
  }
  void unlink(Index term) {
    terms_[term].linked = false;
    for (Offset k = terms_[term].first_slot; k < end_slot(term); ++k) {
      const Slot& slot = slots_[k];
      (slot.previous == -1 ? first_[slot.variable] : slots_[slot.previous].next) = slot.next;
      if (slot.next != -1) slots_[slot.next].previous = slot.previous;
    }
  }
  /// Undoes the last `unlink` that was not yet undone.
  void relink(Index term) {
    terms_[term].linked = true;
    for (Offset k = end_slot(term) - 1; k >= terms_[term].first_slot; --k) {
      const Slot& slot = slots_[k];
      (slot.previous == -1 ? first_[slot.variable] : slots_[slot.previous].next) = static_cast<Index>(k);
      if (slot.next != -1) slots_[slot.next].previous = static_cast<Index>(k);
    }
  }

  /// @param released  terms that are taken as if they had been released, in this order.
  void save(ByteSink& out, std::span<const Index> released) const {
    out.put_list(first_);
    out.put(static_cast<std::uint64_t>(terms_.size()));
    for (Index term = 0; term < count(); ++term) {
      out.put(arity(term));
      out.put(linked(term) ? rows(term) : Index{-1});
      for (const Slot& slot : slots(term)) {
        for (const Index index : {slot.variable, slot.next, slot.previous}) out.put(index);
      }
      if (!linked(term)) continue;
      out.put(static_cast<std::uint8_t>(counted(term)));
      for (Offset k = 0; k < size(term); ++k) out.put(jacobian(term)[k]);
    }
    std::vector<std::vector<Index>> unused = free_;
    for (const Index term : released) {
      if (arity(term) >= to_index(unused.size())) unused.resize(static_cast<std::size_t>(arity(term)) + 1);
      unused[static_cast<std::size_t>(arity(term))].push_back(term);
    }
    out.put(static_cast<std::uint64_t>(unused.size()));
    for (const std::vector<Index>& terms : unused) out.put_list(terms);
  }
  /// What `save` wrote, into an empty list of terms.
  void load(ByteSource& in) {
    in.take_list(first_);
    const auto count = in.take<std::uint64_t>();
    for (std::uint64_t term = 0; term < count; ++term) {
      Term added{nullptr, to_index(slots_.size()), in.take<Index>(), in.take<Index>(), false, false};
      for (Index k = 0; k < added.arity; ++k) {
        const auto variable = in.take<Index>();
        const auto next = in.take<Index>();
        slots_.push_back({variable, static_cast<Index>(term), next, in.take<Index>()});
      }
      terms_.push_back(added);
      if (added.rows < 0) continue;
      Term& linked = terms_.back();
      linked.linked = true;
      linked.counted = in.take<std::uint8_t>() != 0;
      linked.data = arena_.take(size(static_cast<Index>(term)));
      for (Offset k = 0; k < size(static_cast<Index>(term)); ++k) linked.data[k] = in.take<double>();
    }
    free_.resize(in.take<std::uint64_t>());
    for (std::vector<Index>& terms : free_) in.take_list(terms);
  }

  /// Terms, be they in use or not.
  [[nodiscard]] Index count() const { return to_index(terms_.size()); }

  [[nodiscard]] bool linked(Index term) const { return terms_[term].linked; }
  /// A mark for the owner: whether the term's squared residual is part of a sum.
  [[nodiscard]] bool counted(Index term) const { return terms_[term].counted; }
  void set_counted(Index term, bool counted) { terms_[term].counted = counted; }
  [[nodiscard]] Index arity(Index term) const { return terms_[term].arity; }
  [[nodiscard]] Index rows(Index term) const { return terms_[term].rows; }
  [[nodiscard]] std::span<const Slot> slots(Index term) const {
    return slots_.range(terms_[term].first_slot, end_slot(term));
  }
  /// Head of a variable's list, -1 if it has no term.
  [[nodiscard]] Index first(Index variable) const { return first_[variable]; }
  [[nodiscard]] const Slot& slot(Index k) const { return slots_[k]; }

  /// Numbers of Jacobian and residual.
  [[nodiscard]] Offset size(Index term) const { return (Offset{arity(term)} * B + 1) * rows(term); }
  /// J^T: `arity * B` rows, a column for each residual row.
  [[nodiscard]] double* jacobian(Index term) const { return terms_[term].data; }
  /// r, behind the Jacobian.
  [[nodiscard]] double* residual(Index term) const { return terms_[term].data + Offset{arity(term)} * B * rows(term); }
  [[nodiscard]] double squared_residual(Index term) const {
    double sum = 0.0;
    for (Index row = 0; row < rows(term); ++row) sum += residual(term)[row] * residual(term)[row];
    return sum;
  }

 private:
  struct Term {
    double* data = nullptr;
    Index first_slot = 0;
    Index arity = 0;
    Index rows = 0;
    bool linked = false;
    bool counted = false;
  };

  [[nodiscard]] Offset end_slot(Index term) const { return Offset{terms_[term].first_slot} + terms_[term].arity; }

  /// An unused term of this arity.
  [[nodiscard]] Index take(Index arity) {
    if (arity < to_index(free_.size()) && !free_[static_cast<std::size_t>(arity)].empty()) {
      std::vector<Index>& unused = free_[static_cast<std::size_t>(arity)];
      const Index term = unused.back();
      unused.pop_back();
      return term;
    }
    const Index term = to_index(terms_.size(), "number of factors");
    terms_.push_back({nullptr, to_index(slots_.size(), "number of factors' variables"), arity, 0, false, false});
    for (Index k = 0; k < arity; ++k) slots_.push_back({-1, term, -1, -1});
    return term;
  }

  Table<Index> first_;  ///< of each variable
  Table<Term> terms_;
  Table<Slot> slots_;
  std::vector<std::vector<Index>> free_;  ///< unused terms of each arity
  Arena<double> arena_;
};

}  // namespace chainslam::detail
