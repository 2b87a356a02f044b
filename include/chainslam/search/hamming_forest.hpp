#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <stdexcept>
#include <vector>

#include "chainslam/core/binary_descriptor.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

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
    for (Tree& tree : trees_) {
      tree.nodes.push_back({.bit = -1, .next = {0, 0}});
      tree.leaves.emplace_back();
    }
  }

  /// Adds a descriptor. @returns its number: they are counted from 0.
  Index insert(const BinaryDescriptor& descriptor) {
    const Index id = to_index(descriptors_.size(), "number of descriptors");
    descriptors_.push_back(descriptor);
    for (Tree& tree : trees_) insert(tree, descriptor, id);
    return id;
  }

  [[nodiscard]] std::size_t size() const { return descriptors_.size(); }  ///< descriptors that were inserted
  /// A descriptor by its number.
  [[nodiscard]] const BinaryDescriptor& descriptor(Index id) const {
    return descriptors_[static_cast<std::size_t>(id)];
  }

  /// A similar descriptor.
  struct Found {
    Index id = 0;        ///< number of the descriptor
    Index distance = 0;  ///< bits
  };

  /// Puts into `found` what lies within `max_distance` bits of the query and in one of its leaves, by number.
  void near(const BinaryDescriptor& query, Index max_distance, std::vector<Found>& found) const {
    found.clear();
    const Index most_of_first = max_distance / 4 + 10;  // of 64 bits: see hamming_distance_within
    for (const Tree& tree : trees_)
      for (const Entry& entry : leaf(tree, query)) {
        if (std::popcount(entry.first_word ^ query[0]) > most_of_first) continue;
        const Index distance = hamming_distance(query, descriptor(entry.id));
        if (distance <= max_distance) found.push_back({entry.id, distance});
      }
    std::sort(found.begin(), found.end(), [](const Found& a, const Found& b) { return a.id < b.id; });
    found.erase(std::unique(found.begin(), found.end(), [](const Found& a, const Found& b) { return a.id == b.id; }),
                found.end());
  }

 private:
  /// The first word is kept beside the number: most others differ in it, which needs no look into memory far away.
  struct Entry {
    std::uint64_t first_word = 0;
    Index id = 0;
  };
  struct Node {
    Index bit = -1;  ///< by which it is split; -1: it is a leaf, number next[0]
    std::array<Index, 2> next{};
  };
  struct Tree {
    std::vector<Node> nodes;
    std::vector<detail::Table<Entry>> leaves;
  };

  [[nodiscard]] static std::size_t bit_of(const BinaryDescriptor& descriptor, Index bit) {
    return (descriptor[static_cast<std::size_t>(bit / 64)] >> (bit % 64)) & 1U;
  }
  [[nodiscard]] static std::size_t leaf_node(const Tree& tree, const BinaryDescriptor& descriptor) {
    std::size_t at = 0;
    while (tree.nodes[at].bit >= 0)
      at = static_cast<std::size_t>(tree.nodes[at].next[bit_of(descriptor, tree.nodes[at].bit)]);
    return at;
  }
  [[nodiscard]] static const detail::Table<Entry>& leaf(const Tree& tree, const BinaryDescriptor& descriptor) {
    return tree.leaves[static_cast<std::size_t>(tree.nodes[leaf_node(tree, descriptor)].next[0])];
  }

  void insert(Tree& tree, const BinaryDescriptor& descriptor, Index id) {
    const std::size_t at = leaf_node(tree, descriptor);
    detail::Table<Entry>& entries = tree.leaves[static_cast<std::size_t>(tree.nodes[at].next[0])];
    if (entries.size() >= options_.max_leaf_size) return;
    entries.push_back({descriptor[0], id});
    if (entries.size() > options_.leaf_size) split(tree, at);
  }

  /// The bit, of some at random, that parts a leaf most evenly; -1 if none parts it.
  [[nodiscard]] Index best_bit(const detail::Table<Entry>& entries) {
    Index best = -1;
    Offset most_even = entries.size();
    for (Index k = 0; k < options_.bits_tried; ++k) {
      const Index bit = rng_.uniform_index(256);
      Offset ones = 0;
      for (const Entry& entry : entries) ones += static_cast<Offset>(bit_of(descriptor(entry.id), bit));
      const Offset unevenness = std::abs(2 * ones - entries.size());
      if (unevenness < most_even) best = bit, most_even = unevenness;
    }
    return best;
  }

  void split(Tree& tree, std::size_t at) {
    const Index low = tree.nodes[at].next[0];
    const detail::Table<Entry> all = tree.leaves[static_cast<std::size_t>(low)];
    const Index bit = best_bit(all);
    if (bit < 0) return;
    const Index high = to_index(tree.leaves.size());
    tree.leaves.emplace_back();
    tree.leaves[static_cast<std::size_t>(low)] = {};
    for (const Entry& entry : all)
      tree.leaves[static_cast<std::size_t>(bit_of(descriptor(entry.id), bit) != 0 ? high : low)].push_back(entry);
    const Index first = to_index(tree.nodes.size());
    tree.nodes.push_back({.bit = -1, .next = {low, 0}});
    tree.nodes.push_back({.bit = -1, .next = {high, 0}});
    tree.nodes[at] = {.bit = bit, .next = {first, first + 1}};
  }

  HammingForestOptions options_;
  Rng rng_;
  std::vector<BinaryDescriptor> descriptors_;
  std::vector<Tree> trees_;
};

}  // namespace chainslam
