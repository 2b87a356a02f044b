#pragma once

#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam::detail {

/// A sum over the terms of a graph, of which only those are computed again that have changed since somebody asked.
class CostSum {
 public:
  /// All are to be computed again; so it begins.
  void outdate() {
    outdated_ = true;
    for (const Key key : changed_) marked_[key] = 0;
    changed_.clear();
  }
  /// Those on a variable are.
  void change(Key key) {
    if (outdated_) return;
    if (key >= marked_.size()) marked_.resize(Offset{key} + 1, 0);
    if (std::exchange(marked_[key], 1) == 0) changed_.push_back(key);
  }
  /// One is there no more.
  void remove(Index term) {
    if (outdated_ || term >= costs_.size()) return;
    sum_ -= std::exchange(costs_[term], 0.0);
  }

  /// @param terms     all there are, as a function that lists them
  /// @param terms_at  calls its second argument for each on a variable
  /// @param cost      of one
  template <class Terms, class TermsAt, class Cost>
  [[nodiscard]] double sum(const Terms& terms, const TermsAt& terms_at, const Cost& cost) {
    if (std::exchange(outdated_, false)) {
      costs_.clear();
      sum_ = 0.0;
      for (const Index term : terms()) set(term, cost(term));
    }
    for (const Key key : changed_) {
      marked_[key] = 0;
      terms_at(key, [&](Index term) { set(term, cost(term)); });
    }
    changed_.clear();
    return sum_;
  }

 private:
  void set(Index term, double cost) {
    if (term >= costs_.size()) costs_.resize(Offset{term} + 1, 0.0);
    sum_ += cost - costs_[term];
    costs_[term] = cost;
  }

  Table<double> costs_;  ///< of each term, 0 where there is none
  double sum_ = 0.0;
  Table<Key> changed_;  ///< variables
  Table<char> marked_;  ///< of each variable, whether it is among them
  bool outdated_ = true;
};

}  // namespace chainslam::detail
