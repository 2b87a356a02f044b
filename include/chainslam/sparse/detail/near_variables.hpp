#pragma once

#include <algorithm>
#include <limits>
#include <span>
#include <utility>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"

namespace chainslam::detail {

/// The variables nearest to one in the graph whose edges are terms.
template <int B>
class NearVariables {
 public:
  static constexpr Index beyond = std::numeric_limits<Index>::max();

  /// Lists up to `count` of `size` variables, `from` first, by breadth-first search.
  void list(const BlockTerms<B>& terms, Index size, Index from, Index count) {
    clear();
    rank_.resize(size, beyond);
    const auto reach = [&](Index variable) {
      if (rank_[variable] != beyond || near_.size() >= count) return;
      rank_[variable] = to_index(near_.size());
      near_.push_back(variable);
    };
    reach(from);
    for (Offset k = 0; k < near_.size() && near_.size() < count; ++k) {
      for (Index s = terms.first(near_[k]); s != -1; s = terms.slot(s).next) {
        for (const auto& slot : terms.slots(terms.slot(s).term)) reach(slot.variable);
      }
    }
  }

  void clear() {
    for (const Index variable : near_) rank_[variable] = beyond;
    near_.clear();
  }

  [[nodiscard]] bool empty() const { return near_.empty(); }
  [[nodiscard]] bool contains(Index variable) const { return rank_[variable] != beyond; }
  /// How many are nearer than a variable; `beyond` where it is not listed.
  [[nodiscard]] Index rank(Index variable) const { return rank_[variable]; }
  /// Up to `count` of them, the nearest first.
  [[nodiscard]] std::span<const Index> nearest(Index count) const {
    return near_.range(0, std::min(Offset{count}, near_.size()));
  }
  /// All, the nearest first.
  [[nodiscard]] std::span<const Index> all() const { return near_.all(); }
  /// Lists these, the nearest first, instead.
  void set(Table<Index> near, Index size) {
    clear();
    rank_.resize(size, beyond);
    near_ = std::move(near);
    for (Offset k = 0; k < near_.size(); ++k) rank_[near_[k]] = to_index(k);
  }

 private:
  Table<Index> near_;
  Table<Index> rank_;  ///< of each variable
};

/// What lies around the newest variables, listed once for a while: what is beyond then stays so, and so does the order
/// in which it was eliminated.
template <int B>
class Surroundings {
 public:
  /// From here on, changes can be undone.
  void begin() { changed_ = false; }
  void rollback() {
    if (!changed_) return;
    listed_.set(std::move(before_), size_before_);
    size_ = size_before_;
    changed_ = false;
  }

  /// Lists up to `count` of `size` variables around the newest, unless the nearest to it that was there when they were
  /// last listed is still within their inner half.
  /// @param near  what is nearest to the newest.
  void follow(const BlockTerms<B>& terms, const NearVariables<B>& near, Index size, Index count) {
    const std::span<const Index> nearest = near.all();
    const auto known = std::find_if(nearest.begin(), nearest.end(), [&](Index variable) { return variable < size_; });
    if (known != nearest.end() && listed_.rank(*known) < count / 2) return;
    if (!changed_) {
      before_ = Table<Index>(listed_.all());
      size_before_ = size_;
      changed_ = true;
    }
    listed_.list(terms, size, size - 1, count);
    size_ = size;
  }

  /// Whether a variable is one of them, or newer.
  [[nodiscard]] bool contains(Index variable) const { return variable >= size_ || listed_.contains(variable); }

  void save(ByteSink& out) const {
    out.put(size_);
    out.put_list(listed_.all());
  }
  void load(ByteSource& in) {
    size_ = in.take<Index>();
    Table<Index> variables;
    in.take_list(variables);
    listed_.set(std::move(variables), size_);
  }

 private:
  NearVariables<B> listed_;
  Index size_ = 0;       ///< variables when they were listed
  Table<Index> before_;  ///< as at `begin`
  Index size_before_ = 0;
  bool changed_ = false;  ///< since `begin`
};

}  // namespace chainslam::detail
