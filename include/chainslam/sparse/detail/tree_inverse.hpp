#pragma once

#include <algorithm>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/detail/front.hpp"
#include "chainslam/sparse/detail/front_tree.hpp"
#include "chainslam/sparse/detail/inverse_fronts.hpp"

namespace chainslam::detail {

/// The fronts of a `FrontTree`, as `InverseFronts` asks for them.
template <int B>
class TreeInverse {
 public:
  /// @param size  number of variables, eliminated or not.
  TreeInverse(const FrontTree<B>& tree, Index size) : tree_(tree), place_(size, -1) {
    for (Index variable = 0; variable < size; ++variable) {
      const Index node = tree.node_of(variable);
      if (node != -1 && tree[node].parent == -1 && tree.columns(node).front() == variable) roots_.push_back(node);
    }
  }

  /// The diagonal blocks of the inverse, column-major, at B^2 times their variable's number.
  [[nodiscard]] std::vector<double> diagonal() {
    std::vector<double> out(static_cast<std::size_t>(place_.size()) * B * B, 0.0);
    InverseFronts<B>().run(*this, [&](Index node, const double* inverse, Offset stride) {
      for (const Index variable : tree_.columns(node)) {
        double* const to = out.data() + Offset{variable} * B * B;
        for (int c = 0; c < B; ++c) std::copy_n(inverse + c * stride, B, to + c * B);
        inverse += B * (stride + 1);
      }
    });
    return out;
  }

  /// Calls visit(node, Z, stride) for each front, as `InverseFronts` does.
  template <class Visit>
  void run(Visit&& visit) {
    InverseFronts<B>().run(*this, visit);
  }

  [[nodiscard]] const Table<Index>& roots() const { return roots_; }
  [[nodiscard]] Index columns(Index node) const { return tree_[node].columns; }
  [[nodiscard]] Index rows(Index node) const { return tree_[node].rows; }
  [[nodiscard]] const double* panel(Index node) const { return tree_.front(node).panel(); }
  [[nodiscard]] const double* reciprocals(Index node) const { return tree_.front(node).reciprocals(); }

  /// The one with the largest front first.
  template <class Take>
  void for_each_child(Index node, Take&& take) {
    Index place = 0;
    for (const Index variable : tree_.variables(node)) place_[variable] = place++;
    const Index largest = largest_child(node);
    const auto take_one = [&](Index child) {
      places_.clear();
      for (const Index row : tree_.rows(child)) places_.push_back(place_[row]);
      take(child, places_.range(0, places_.size()));
    };
    if (largest != -1) take_one(largest);
    for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next)
      if (child != largest) take_one(child);
  }

 private:
  [[nodiscard]] Index largest_child(Index node) const {
    Index largest = -1;
    for (Index child = tree_[node].first_child; child != -1; child = tree_[child].next)
      if (largest == -1 || columns(child) + rows(child) > columns(largest) + rows(largest)) largest = child;
    return largest;
  }

  const FrontTree<B>& tree_;
  Table<Index> roots_;
  Table<Index> place_;  ///< of each variable in the front at hand
  Table<Index> places_;
};

}  // namespace chainslam::detail
