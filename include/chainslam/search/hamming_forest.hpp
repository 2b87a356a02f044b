#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// 256 answers of yes or no about a place; similar places differ in few.
using BinaryDescriptor = std::array<std::uint64_t, 4>;

namespace detail {

/// Number of ones. Without an instruction for it, `std::popcount` calls a function that looks bytes up.
[[nodiscard]] inline int count_ones(std::uint64_t bits) {
#ifdef __POPCNT__
  return std::popcount(bits);
#else
  bits -= (bits >> 1U) & 0x5555555555555555U;
  bits = (bits & 0x3333333333333333U) + ((bits >> 2U) & 0x3333333333333333U);
  return static_cast<int>((((bits + (bits >> 4U)) & 0x0f0f0f0f0f0f0f0fU) * 0x0101010101010101U) >> 56U);
#endif
}

}  // namespace detail

/// Number of bits that differ.
[[nodiscard]] inline Index hamming_distance(const BinaryDescriptor& a, const BinaryDescriptor& b) {
  int count = 0;
  for (std::size_t word = 0; word < a.size(); ++word) count += detail::count_ones(a[word] ^ b[word]);
  return count;
}

/// The same, but without looking at all words where the first one makes it more than `limit` almost surely: it differs
/// in so many bits more than its share that of random differences one in a thousand would.
/// @returns the distance, or more than `limit`.
[[nodiscard]] inline Index hamming_distance_within(const BinaryDescriptor& a, const BinaryDescriptor& b, Index limit) {
  const Index first = detail::count_ones(a[0] ^ b[0]);
  if (first > limit / 4 + 10) return limit + 1;
  return first + detail::count_ones(a[1] ^ b[1]) + detail::count_ones(a[2] ^ b[2]) + detail::count_ones(a[3] ^ b[3]);
}

/// How descriptors are divided among leaves.
struct HammingForestOptions {
  Index trees = 6;            ///< more find more of what is near, in proportional time
  Index leaf_size = 32;       ///< descriptors of a leaf before it is split
  Index bits_tried = 16;      ///< random bits of which a leaf is split by the most balanced one
  Index max_leaf_size = 128;  ///< what no bit parts is common, and forgotten beyond so many
  std::uint64_t seed = 1;     ///< of the bits that are looked at
};

/// Finds descriptors at a small Hamming distance, most of them, in logarithmic time.
///
/// Each tree sends a descriptor down by single bits until a leaf of at most `leaf_size`; a query is compared with the
/// leaves that it reaches. Two descriptors that differ in a share of d bits meet in one of n leaves at depth k with
/// probability 1 - (1 - (1 - d)^k)^n. An LSH forest (Bawa, Condie and Ganesan 2005) whose bits are chosen by the data,
/// as in HBST (Schlegel and Grisetti 2018).
class HammingForest {
 public:
  /// @throws std::invalid_argument if an option makes no sense.
  explicit HammingForest(const HammingForestOptions& options = {}) : options_(options), rng_(options.seed) {
    if (options.trees < 1 || options.leaf_size < 1 || options.bits_tried < 1 ||
        options.max_leaf_size < options.leaf_size)
      throw std::invalid_argument(
          "HammingForest: trees, leaf_size and bits_tried must be positive, max_leaf_size no less than leaf_size");
    trees_.resize(static_cast<std::size_t>(options.trees));
    for (Tree& tree : trees_) tree.leaves.emplace_back();
  }

  /// Adds a descriptor. @returns its number: they are counted from 0.
  Index insert(const BinaryDescriptor& descriptor) {
    const Index id = to_index(static_cast<std::size_t>(descriptors_.size()), "number of descriptors");
    descriptors_.push_back(descriptor);
    for (Tree& tree : trees_) insert(tree, descriptor, id);
    return id;
  }

  [[nodiscard]] std::size_t size() const {  ///< descriptors that were inserted
    return static_cast<std::size_t>(descriptors_.size());
  }
  /// A descriptor by its number.
  [[nodiscard]] const BinaryDescriptor& descriptor(Index id) const { return descriptors_[id]; }

  /// A similar descriptor.
  struct Found {
    Index id = 0;        ///< number of the descriptor
    Index distance = 0;  ///< bits
    Index query = 0;     ///< number of the query that it is similar to
  };

  /// Puts into `found` what lies within `max_distance` bits of a query and in one of its leaves, by query and number.
  /// Many queries at once take less time than one by one: while one waits for memory, others go on.
  void near_each(std::span<const BinaryDescriptor> queries, Index max_distance, std::vector<Found>& found) const {
    constexpr std::size_t group = 32;  // more than a processor fetches at a time; their leaves fit into its first cache
    found.clear();
    detail::Table<Found> similar;
    std::array<Index, group> leaves{};
    for (std::size_t first = 0; first < queries.size(); first += group) {
      const auto some = queries.subspan(first, std::min(group, queries.size() - first));
      for (const Tree& tree : trees_) {
        find_leaves(tree, some, leaves);
        scan_leaves(tree, some, leaves, max_distance, similar);
        for (const Found& one : similar) {
          const Index distance = hamming_distance(some[static_cast<std::size_t>(one.query)], descriptor(one.id));
          if (distance <= max_distance) found.push_back({one.id, distance, static_cast<Index>(first) + one.query});
        }
      }
    }
    std::sort(found.begin(), found.end(),
              [](const Found& a, const Found& b) { return a.query != b.query ? a.query < b.query : a.id < b.id; });
    const auto is_same = [](const Found& a, const Found& b) { return a.query == b.query && a.id == b.id; };
    found.erase(std::unique(found.begin(), found.end(), is_same), found.end());
  }
  /// The same for one query.
  void near(const BinaryDescriptor& query, Index max_distance, std::vector<Found>& found) const {
    near_each(std::span(&query, 1), max_distance, found);
  }

 private:
  /// The first word is kept beside the number: most others differ in it, which needs no look into memory far away.
  struct Entry {
    std::array<std::uint32_t, 2> first_word{};  ///< in halves, which leave no gap before or after the number
    Index id = 0;
  };
  using Leaf = std::vector<Entry>;
  struct Node {
    Index bit = 0;                ///< by which it is split
    std::array<Index, 2> next{};  ///< node, or ~leaf
  };
  struct Tree {
    Index root = ~0;
    detail::Table<Node> nodes;
    std::vector<Leaf> leaves;
  };

  [[nodiscard]] static std::size_t bit_of(const BinaryDescriptor& descriptor, Index bit) {
    return (descriptor[static_cast<std::size_t>(bit / 64)] >> (bit % 64)) & 1U;
  }
  [[nodiscard]] static const Leaf& leaf(const Tree& tree, Index next) {
    return tree.leaves[static_cast<std::size_t>(~next)];
  }
  static void fetch(const void* memory) { __builtin_prefetch(memory); }

  /// Goes down a tree with all queries, a level at a time. @param at  becomes ~leaf
  static void find_leaves(const Tree& tree, std::span<const BinaryDescriptor> queries, std::span<Index> at) {
    std::fill(at.begin(), at.end(), tree.root);
    for (bool is_below = tree.root < 0; !is_below;) {
      is_below = true;
      for (std::size_t q = 0; q < queries.size(); ++q) {
        if (at[q] < 0) continue;
        const Node& node = tree.nodes[at[q]];
        at[q] = node.next[bit_of(queries[q], node.bit)];
        if (at[q] < 0) {
          fetch(&leaf(tree, at[q]));
        } else {
          fetch(&tree.nodes[at[q]]);
          is_below = false;
        }
      }
    }
  }

  /// Puts into `similar` the entries whose first word does not show that they are too far away.
  void scan_leaves(const Tree& tree, std::span<const BinaryDescriptor> queries, std::span<const Index> at,
                   Index max_distance, detail::Table<Found>& similar) const {
    const Index most_of_first = max_distance / 4 + 10;  // of 64 bits: see hamming_distance_within
    constexpr std::size_t in_line = 64 / sizeof(Entry);
    for (std::size_t q = 0; q < queries.size(); ++q)
      for (std::size_t i = 0; i < leaf(tree, at[q]).size(); i += in_line) fetch(&leaf(tree, at[q])[i]);
    similar.clear();
    for (std::size_t q = 0; q < queries.size(); ++q)
      for (const Entry& entry : leaf(tree, at[q])) {
        if (detail::count_ones(std::bit_cast<std::uint64_t>(entry.first_word) ^ queries[q][0]) > most_of_first)
          continue;
        similar.push_back({entry.id, 0, static_cast<Index>(q)});
        fetch(&descriptor(entry.id));
      }
  }

  void insert(Tree& tree, const BinaryDescriptor& descriptor, Index id) {
    Index* next = &tree.root;
    while (*next >= 0) {
      Node& node = tree.nodes[*next];
      next = &node.next[bit_of(descriptor, node.bit)];
    }
    Leaf& entries = tree.leaves[static_cast<std::size_t>(~*next)];
    if (to_index(entries.size()) >= options_.max_leaf_size) return;
    append(entries, {std::bit_cast<std::array<std::uint32_t, 2>>(descriptor[0]), id});
    if (to_index(entries.size()) > options_.leaf_size) split(tree, *next);
  }
  /// Adds to a leaf, which takes memory for few more at a time: most of the forest's memory is that of leaves.
  static void append(Leaf& entries, const Entry& entry) {
    constexpr std::size_t step = 4;
    if (entries.size() == entries.capacity()) entries.reserve(entries.size() + step);
    entries.push_back(entry);
  }

  /// The bit, of some at random, that parts a leaf most evenly; -1 if none parts it.
  [[nodiscard]] Index best_bit(const Leaf& entries) {
    Index best = -1;
    const Index count = to_index(entries.size());
    Index most_even = count;
    for (Index k = 0; k < options_.bits_tried; ++k) {
      const Index bit = rng_.uniform_index(256);
      Index ones = 0;
      for (const Entry& entry : entries) ones += static_cast<Index>(bit_of(descriptor(entry.id), bit));
      const Index unevenness = std::abs(2 * ones - count);
      if (unevenness < most_even) best = bit, most_even = unevenness;
    }
    return best;
  }

  /// @param next  where the tree names the leaf
  void split(Tree& tree, Index& next) {
    const Index low = ~next, high = to_index(tree.leaves.size());
    const Index bit = best_bit(tree.leaves[static_cast<std::size_t>(low)]);
    if (bit < 0) return;
    next = to_index(static_cast<std::size_t>(tree.nodes.size()));
    tree.nodes.push_back({.bit = bit, .next = {~low, ~high}});
    tree.leaves.emplace_back();
    const Leaf all = std::exchange(tree.leaves[static_cast<std::size_t>(low)], {});
    for (const Entry& entry : all)
      append(tree.leaves[static_cast<std::size_t>(bit_of(descriptor(entry.id), bit) != 0 ? high : low)], entry);
  }

  HammingForestOptions options_;
  Rng rng_;
  detail::Table<BinaryDescriptor> descriptors_;  // whose memory grows where it is
  std::vector<Tree> trees_;
};

}  // namespace chainslam
