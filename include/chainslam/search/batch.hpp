#pragma once

#include <cstddef>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/point_source.hpp"

namespace chainslam {

/// The k nearest of many queries: a row of up to k neighbours for each.
template <class Scalar = float>
class NeighborRows {
 public:
  [[nodiscard]] Index rows() const { return static_cast<Index>(counts_.size()); }  ///< number of queries
  /// Capacity of a row.
  [[nodiscard]] Index k() const { return k_; }
  /// What was found for query i, ascending by distance.
  [[nodiscard]] std::span<const Neighbor<Scalar>> operator[](Index i) const {
    const auto row = static_cast<std::size_t>(i);
    return std::span(neighbors_).subspan(row * static_cast<std::size_t>(k_), static_cast<std::size_t>(counts_[row]));
  }

  /// Resizes for other answers; what was found before is lost unless neither number changes.
  /// @throws std::invalid_argument if k is negative.
  void resize(Index rows, Index k) {
    if (k < 0) throw std::invalid_argument("NeighborRows: k must not be negative");
    if (rows == this->rows() && k == k_) return;
    neighbors_.resize(static_cast<std::size_t>(rows) * static_cast<std::size_t>(k));
    counts_.assign(static_cast<std::size_t>(rows), 0);
    k_ = k;
  }
  /// Lets `search(room)` write the answers to query i to the front of `room`, which still holds the last ones, and say
  /// how many there are.
  template <class Search>
  void set(Index i, Search&& search) {
    const auto width = static_cast<std::size_t>(k_);
    counts_[static_cast<std::size_t>(i)] =
        search(std::span(neighbors_).subspan(static_cast<std::size_t>(i) * width, width));
  }

 private:
  std::vector<Neighbor<Scalar>> neighbors_;
  std::vector<Index> counts_;
  Index k_ = 0;
};

/// The neighbours of many queries, as many as there are for each.
template <class Scalar = float>
struct NeighborLists {
  std::vector<Neighbor<Scalar>> neighbors;  ///< query after query
  std::vector<std::size_t> first;           ///< where each query's begin, and at the end how many there are

  /// The neighbours of query i.
  [[nodiscard]] std::span<const Neighbor<Scalar>> operator[](Index i) const {
    const auto place = static_cast<std::size_t>(i);
    return std::span(neighbors).subspan(first[place], first[place + 1] - first[place]);
  }
};

namespace detail {

/// Queries a chunk: a fixed number, so that answers do not depend on the number of threads.
inline constexpr Index batch_grain = 256;

}  // namespace detail

/// The k nearest within `max_distance` of each query, as `knn` finds them.
///
/// Queries that follow one another are best near one another, as a scan's points are: each starts from the answer to
/// the one before where the search is a `SeededSearch`. The same bytes for any number of threads.
template <NearestNeighborSearch Search, detail::PointSource<search_dimension<Search>> Queries, Executor Exec = Serial>
void knn_batch(const Search& search, const Queries& queries, Index k, typename Search::Scalar max_distance,
               NeighborRows<typename Search::Scalar>& out, const Exec& exec = {}) {
  using Scalar = typename Search::Scalar;
  constexpr int dim = search_dimension<Search>;
  out.resize(detail::source_size<dim>(queries), k);
  exec.for_chunks(out.rows(), detail::batch_grain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const SearchVector<Search> query = detail::source_position<Scalar, dim>(queries, i);
      out.set(i, [&](std::span<Neighbor<Scalar>> room) {
        if constexpr (SeededSearch<Search>) {
          if (i > begin) return search.knn(query, room, max_distance, std::as_const(out)[i - 1]);
        }
        return search.knn(query, room, max_distance);
      });
    }
  });
}

/// The same for queries that were asked before and have moved a little since, as an iterated filter's do: each starts
/// from its own answer in `out`, whose indices may have been erased since.
template <SeededSearch Search, detail::PointSource<search_dimension<Search>> Queries, Executor Exec = Serial>
void knn_batch_again(const Search& search, const Queries& queries, typename Search::Scalar max_distance,
                     NeighborRows<typename Search::Scalar>& out, const Exec& exec = {}) {
  using Scalar = typename Search::Scalar;
  constexpr int dim = search_dimension<Search>;
  out.resize(detail::source_size<dim>(queries), out.k());
  exec.for_chunks(out.rows(), detail::batch_grain, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const SearchVector<Search> query = detail::source_position<Scalar, dim>(queries, i);
      const std::span<const Neighbor<Scalar>> seeds = std::as_const(out)[i];
      out.set(i, [&](std::span<Neighbor<Scalar>> room) { return search.knn(query, room, max_distance, seeds); });
    }
  });
}

/// All neighbours within `radius` of each query, as `within` finds them. The same bytes for any number of threads.
template <NearestNeighborSearch Search, detail::PointSource<search_dimension<Search>> Queries, Executor Exec = Serial>
void within_batch(const Search& search, const Queries& queries, typename Search::Scalar radius,
                  NeighborLists<typename Search::Scalar>& out, const Exec& exec = {}) {
  using Scalar = typename Search::Scalar;
  constexpr int dim = search_dimension<Search>;
  const Index count = detail::source_size<dim>(queries);
  std::vector<NeighborLists<Scalar>> parts(static_cast<std::size_t>(detail::count_chunks(count, detail::batch_grain)));
  exec.for_chunks(count, detail::batch_grain, [&](Index begin, Index end) {
    NeighborLists<Scalar>& part = parts[static_cast<std::size_t>(begin / detail::batch_grain)];
    std::vector<Neighbor<Scalar>> found;
    for (Index i = begin; i < end; ++i) {
      search.within(detail::source_position<Scalar, dim>(queries, i), radius, found);
      part.first.push_back(part.neighbors.size());
      part.neighbors.insert(part.neighbors.end(), found.begin(), found.end());
    }
  });
  out.neighbors.clear();
  out.first.clear();
  for (const NeighborLists<Scalar>& part : parts) {
    for (const std::size_t first : part.first) out.first.push_back(out.neighbors.size() + first);
    out.neighbors.insert(out.neighbors.end(), part.neighbors.begin(), part.neighbors.end());
  }
  out.first.push_back(out.neighbors.size());
}

}  // namespace chainslam
