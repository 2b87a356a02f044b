#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"

namespace chainslam::detail {

/// How many of `late`, ascending, a node does not come before.
[[nodiscard]] inline Index group_of(std::span<const Index> late, Index node) {
  return static_cast<Index>(std::upper_bound(late.begin(), late.end(), node) - late.begin());
}

/// Eliminates a graph's nodes by approximate minimum degree.
///
/// The graph after some eliminations is kept as variables (nodes not yet eliminated; indistinguishable ones joined) and
/// elements (cliques left behind by eliminated nodes). A variable lists its elements, then its variables; an element
/// lists its variables. Lists of variables only shrink, in place; lists of elements are appended, which takes no more
/// than the factor's own pattern. Names in comments as in Amestoy, Davis and Duff 1996, section 3 and 4.
class QuotientGraph {
 public:
  explicit QuotientGraph(const BlockPattern& pattern) : QuotientGraph(pattern, {}, {}) {}

  /// Part of a larger graph, whose other nodes are eliminated already.
  ///
  /// @param elements  the cliques which those have left among the nodes that remain.
  /// @param late      ascending: nodes from each of these on are eliminated after all before it (Chen et al. 2008,
  ///                  section 2.3).
  QuotientGraph(const BlockPattern& pattern, std::span<const std::span<const Index>> elements,
                std::span<const Index> late)
      : size_(pattern.size()),
        late_(late),
        waits_from_(late.empty() ? size_ : late.front()),
        start_(size_ + to_index(elements.size()), 0),
        element_count_(start_.size(), 0),
        length_(start_.size(), 0),
        weight_(start_.size(), 1),
        degree_(start_.size(), 0),
        stamp_(start_.size(), 0),
        next_(size_, -1),
        previous_(size_, -1),
        bucket_(Offset{size_} + 1, -1),
        next_member_(size_, -1),
        last_member_(size_),
        marks_(start_.size(), 0) {
    for (Index i = 0; i < size_; ++i) last_member_[i] = i;
    list_neighbors(pattern, elements);
  }

  /// The nodes in the order of their elimination.
  [[nodiscard]] Table<Index> eliminate() {
    while (eliminated_ < size_ - to_index(dense_.size())) {
      while (waiting_ > 0 && eliminated_ + waiting_ == size_ - to_index(dense_.size())) release_late();
      const Index pivot = take_least_degree();
      make_element(pivot);
      measure_elements(pivot);
      update_variables(pivot);
      join_indistinguishable();
      finish_element(pivot);
      pivots_.push_back(pivot);
    }
    return order();
  }

 private:
  /// Nodes with more neighbours than this would slow all steps; they go last (Amestoy, Davis and Duff 2004,
  /// section 3.2).
  [[nodiscard]] Index dense_limit() const { return std::max(16, static_cast<Index>(10.0 * std::sqrt(size_))); }

  void list_neighbors(const BlockPattern& pattern, std::span<const std::span<const Index>> elements) {
    Table<Index> neighbors(size_, 0);
    for (Index column = 0; column < size_; ++column) {
      for (const Index row : pattern.rows(column).subspan(1)) {
        ++neighbors[column];
        ++neighbors[row];
      }
    }
    for (const std::span<const Index> element : elements) {
      for (const Index i : element) ++neighbors[i];
    }
    Offset total = 0;
    for (Index i = 0; i < size_; ++i) {
      start_[i] = total;
      total += neighbors[i];
      if (neighbors[i] <= dense_limit()) continue;
      weight_[i] = 0;
      dense_.push_back(i);
    }
    list_.reserve(3 * total);
    list_.resize(total);
    for (Index e = 0; e < to_index(elements.size()); ++e)
      list_element(size_ + e, elements[static_cast<std::size_t>(e)]);
    for (Index column = 0; column < size_; ++column) {
      for (const Index row : pattern.rows(column).subspan(1)) {
        if (weight_[row] == 0 || weight_[column] == 0) continue;
        list_[start_[column] + length_[column]++] = row;
        list_[start_[row] + length_[row]++] = column;
        ++degree_[column];
        ++degree_[row];
      }
    }
    // Backwards, so that among equal degrees the first node is met first.
    for (Index i = size_ - 1; i >= 0; --i) {
      degree_[i] = std::min(degree_[i], size_ - 1);
      if (weight_[i] == 0) continue;
      if (i >= waits_from_) ++waiting_;
      put_in_bucket(i);
    }
  }

  void list_element(Index element, std::span<const Index> variables) {
    start_[element] = list_.size();
    for (const Index i : variables) {
      if (weight_[i] == 0) continue;
      list_.push_back(i);
      list_[start_[i] + length_[i]++] = element;
      ++element_count_[i];
    }
    length_[element] = degree_[element] = to_index(list_.size() - start_[element]);
    for (const Index i : variables) degree_[i] += degree_[element] - 1;
  }

  /// Whether a node may not yet be eliminated.
  [[nodiscard]] bool waits(Index i) const { return i >= waits_from_; }

  /// The next of those that wait no longer do.
  void release_late() {
    const Index begin = waits_from_;
    late_ = late_.subspan(1);
    waits_from_ = late_.empty() ? size_ : late_.front();
    for (Index i = waits_from_ - 1; i >= begin; --i) {
      if (weight_[i] == 0) continue;
      waiting_ -= weight_[i];
      put_in_bucket(i);
    }
  }

  void put_in_bucket(Index i) {
    if (waits(i)) return;
    const Index degree = degree_[i];
    next_[i] = bucket_[degree];
    previous_[i] = -1;
    if (next_[i] != -1) previous_[next_[i]] = i;
    bucket_[degree] = i;
    least_degree_ = std::min(least_degree_, degree);
  }

  void take_from_bucket(Index i) {
    if (waits(i)) return;
    if (next_[i] != -1) previous_[next_[i]] = previous_[i];
    if (previous_[i] != -1) {
      next_[previous_[i]] = next_[i];
    } else {
      bucket_[degree_[i]] = next_[i];
    }
  }

  [[nodiscard]] Index take_least_degree() {
    while (bucket_[least_degree_] == -1) ++least_degree_;
    const Index pivot = bucket_[least_degree_];
    take_from_bucket(pivot);
    eliminated_ += weight_[pivot];
    return pivot;
  }

  /// L_p = (A_p and the variables of p's elements) without p; those elements are absorbed. A variable that is in L_p
  /// has its weight negated until the step is done.
  void make_element(Index pivot) {
    const Offset old_start = start_[pivot];
    const Offset elements_end = old_start + element_count_[pivot];
    const Offset old_end = old_start + length_[pivot];
    weight_[pivot] = 0;
    const Offset new_start = list_.size();
    Index clique_weight = 0;
    const auto gather = [&](Offset begin, Offset end) {
      for (Offset k = begin; k < end; ++k) {
        const Index i = list_[k];
        if (weight_[i] <= 0) continue;
        clique_weight += weight_[i];
        weight_[i] = -weight_[i];
        take_from_bucket(i);
        list_.push_back(i);
      }
    };
    for (Offset k = old_start; k < elements_end; ++k) {
      const Index element = list_[k];
      gather(start_[element], start_[element] + length_[element]);
      absorbed(element);
    }
    gather(elements_end, old_end);
    start_[pivot] = new_start;
    length_[pivot] = to_index(list_.size() - new_start);
    element_count_[pivot] = 0;
    degree_[pivot] = clique_weight;
    stamp_[pivot] = live;
  }

  /// For each element e beside a variable of L_p: stamp(e) - base = |L_e without L_p| (ibid., algorithm 2).
  void measure_elements(Index pivot) {
    base_ += size_ + 1;
    for_clique(pivot, [&](Index i) {
      for (Offset k = start_[i]; k < start_[i] + element_count_[i]; ++k) {
        const Index element = list_[k];
        if (stamp_[element] == dead) continue;
        if (stamp_[element] < base_) stamp_[element] = base_ + degree_[element];
        stamp_[element] += weight_[i];  // negative in L_p
      }
    });
  }

  /// Rewrites the lists of L_p's variables with p for the elements it covers, and bounds their external degrees.
  void update_variables(Index pivot) {
    hashes_.clear();
    for_clique(pivot, [&](Index i) {
      std::uint64_t hash = static_cast<std::uint64_t>(pivot);
      Index outside = 0;
      Offset write = start_[i];
      const Offset elements_end = start_[i] + element_count_[i];
      const Offset end = start_[i] + length_[i];
      for (Offset k = start_[i]; k < elements_end; ++k) {
        const Index element = list_[k];
        if (stamp_[element] == dead) continue;
        const Index beyond = static_cast<Index>(stamp_[element] - base_);
        if (beyond == 0) {  // aggressive absorption: all of the element lies in L_p
          absorbed(element);
          continue;
        }
        outside += beyond;
        hash += static_cast<std::uint64_t>(element);
        list_[write++] = element;
      }
      const Offset variables = write;
      for (Offset k = elements_end; k < end; ++k) {
        const Index j = list_[k];
        if (weight_[j] <= 0) continue;  // eliminated, joined, or covered by p
        outside += weight_[j];
        hash += static_cast<std::uint64_t>(j);
        list_[write++] = j;
      }
      if (write == start_[i] && !waits(i)) {  // nothing beside p: i can be eliminated with it (mass elimination)
        degree_[pivot] += weight_[i];
        eliminated_ -= weight_[i];
        weight_[i] = 0;
        join_members(pivot, i);
        return;
      }
      // i lost at least one entry that led to p, which leaves room for p as its last element.
      list_[write] = list_[variables];
      list_[variables] = pivot;
      element_count_[i] = to_index(variables - start_[i]) + 1;
      length_[i] = to_index(write - start_[i]) + 1;
      degree_[i] = std::min(degree_[i], outside);
      hashes_.push_back({static_cast<double>(hash), i});
    });
  }

  /// Variables with the same neighbours stay so to the end: they are joined, and eliminated together.
  void join_indistinguishable() {
    sort_ranked(hashes_.all());
    for (Offset a = 0; a < hashes_.size(); ++a) {
      const Index i = hashes_[a].index;
      if (weight_[i] == 0) continue;
      bool marked = false;
      for (Offset b = a + 1; b < hashes_.size() && hashes_[b].rank == hashes_[a].rank; ++b) {
        const Index j = hashes_[b].index;
        if (weight_[j] == 0 || length_[j] != length_[i] || element_count_[j] != element_count_[i]) continue;
        if (group_of(late_, i) != group_of(late_, j)) continue;
        if (!marked) mark_list(i);
        marked = true;
        if (!list_is_marked(j)) continue;
        weight_[i] += weight_[j];
        weight_[j] = 0;
        join_members(i, j);
      }
    }
  }

  void mark_list(Index i) {
    ++mark_;
    for (Offset k = start_[i]; k < start_[i] + length_[i]; ++k) marks_[list_[k]] = mark_;
  }

  [[nodiscard]] bool list_is_marked(Index i) const {
    for (Offset k = start_[i]; k < start_[i] + length_[i]; ++k) {
      if (marks_[list_[k]] != mark_) return false;
    }
    return true;
  }

  /// Puts the variables that are left of L_p back into their buckets, with the degrees of ibid., equation 4.
  void finish_element(Index pivot) {
    Offset write = start_[pivot];
    for (Offset k = start_[pivot]; k < start_[pivot] + length_[pivot]; ++k) {
      const Index i = list_[k];
      if (weight_[i] == 0) continue;
      weight_[i] = -weight_[i];
      const Index remaining = size_ - to_index(dense_.size()) - eliminated_ - weight_[i];
      degree_[i] = std::min(remaining, degree_[i] + degree_[pivot] - weight_[i]);
      put_in_bucket(i);
      list_[write++] = i;
    }
    length_[pivot] = to_index(write - start_[pivot]);
    if (length_[pivot] == 0) absorbed(pivot);
    list_.resize(write);
  }

  [[nodiscard]] Table<Index> order() const {
    Table<Index> result;
    result.reserve(size_);
    for (const Index pivot : pivots_) {
      for (Index i = pivot; i != -1; i = next_member_[i]) result.push_back(i);
    }
    result.append(dense_.all());
    return result;
  }

  void join_members(Index i, Index j) {
    next_member_[last_member_[i]] = j;
    last_member_[i] = last_member_[j];
  }

  void absorbed(Index element) { stamp_[element] = dead; }

  template <class Visit>
  void for_clique(Index pivot, Visit&& visit) {
    for (Offset k = start_[pivot]; k < start_[pivot] + length_[pivot]; ++k) {
      if (weight_[list_[k]] != 0) visit(list_[k]);
    }
  }

  static constexpr std::int64_t live = 0;
  static constexpr std::int64_t dead = -1;

  Index size_;
  std::span<const Index> late_;  ///< where nodes begin that are to be eliminated later, and later still
  Index waits_from_;             ///< the first of them
  Index waiting_ = 0;            ///< columns that they stand for
  Table<Offset> start_;
  Table<Index> element_count_;
  Table<Index> length_;
  Table<Index> weight_;  ///< columns that a variable stands for; 0 when eliminated or joined to another
  Table<Index> degree_;  ///< of a variable: bound of its external degree; of an element: columns in its clique
  Table<std::int64_t> stamp_;
  Table<Index> next_;
  Table<Index> previous_;
  Table<Index> bucket_;  ///< first variable of each degree
  Table<Index> next_member_;
  Table<Index> last_member_;
  Table<Index> list_;
  Table<std::int64_t> marks_;
  Table<Ranked> hashes_;  ///< variables by their lists' hashes
  Table<Index> pivots_;
  Table<Index> dense_;
  std::int64_t base_ = 0;
  std::int64_t mark_ = 0;
  Index least_degree_ = 0;
  Index eliminated_ = 0;
};

}  // namespace chainslam::detail
