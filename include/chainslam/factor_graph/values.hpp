#pragma once

#include <algorithm>
#include <cassert>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/lie/concepts.hpp"

namespace chainslam {

/// Names a variable of a factor graph: its place in `Values`, in the order of adding, from 0.
using Key = Index;

/// The values of a factor graph's variables, all of one type, by key.
template <Manifold Group>
class Values {
 public:
  /// @returns the new variable's key.
  Key add(const Group& value) {
    const Key key = to_index(values_.size(), "number of variables");
    values_.push_back(value);
    return key;
  }

  /// Removes the variable that was added last.
  void drop_last() {
    assert(!values_.empty());
    values_.pop_back();
  }

  /// The value of a variable.
  [[nodiscard]] const Group& operator[](Key key) const {
    assert(contains(key));
    return values_[static_cast<std::size_t>(key)];
  }
  /// The value of a variable.
  [[nodiscard]] Group& operator[](Key key) {
    assert(contains(key));
    return values_[static_cast<std::size_t>(key)];
  }

  [[nodiscard]] bool contains(Key key) const { return key >= 0 && key < size(); }  ///< whether there is such a variable
  [[nodiscard]] Index size() const { return static_cast<Index>(values_.size()); }  ///< number of variables
  /// The first value; values come in the order of their keys.
  [[nodiscard]] auto begin() const { return values_.begin(); }
  [[nodiscard]] auto end() const { return values_.end(); }              ///< behind the last value
  [[nodiscard]] std::span<const Group> all() const { return values_; }  ///< all values, in the order of their keys

  friend bool operator==(const Values&, const Values&) = default;  ///< whether all members are equal

 private:
  std::vector<Group> values_;
};

namespace detail {

/// Ascending, each once.
inline void sort_unique(std::vector<Key>& keys) {
  std::sort(keys.data(), keys.data() + keys.size());  // by pointers, as all lists of indices
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
}

/// Where a key is in a short list; its size if it is not there.
[[nodiscard]] inline Index place_of(std::span<const Key> keys, Key key) {
  return static_cast<Index>(std::find(keys.data(), keys.data() + keys.size(), key) - keys.data());
}

}  // namespace detail

}  // namespace chainslam
