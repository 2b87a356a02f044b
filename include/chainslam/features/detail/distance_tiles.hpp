#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/lanes.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/detail/nearest_features.hpp"

namespace chainslam::detail {

/// The distances between two sets of features, a tile at a time, offered to the tables of both. A tile whose features'
/// shadows are farther apart than anything it could tell is passed over.
class DistanceTiles {
 public:
  static constexpr std::size_t tile_rows = 6, tile_columns = 2 * lane_count;

  template <Executor Exec>
  DistanceTiles(const FeatureSet& rows, const FeatureSet& columns, const std::vector<float>& center,
                const Exec& executor)
      : length_(rows.length()),
        row_count_(static_cast<std::size_t>(rows.size())),
        column_count_(static_cast<std::size_t>(columns.size())),
        row_norms_(padded(rows.half_squared_norms(), tile_rows)),
        column_norms_(padded(columns.half_squared_norms(), tile_columns)),
        row_spans_(spans(rows.shadows(), tile_rows)),
        column_spans_(spans(columns.shadows(), tile_columns)) {
    const auto longest = [](std::span<const float> half_norms) {
      return half_norms.empty() ? 0.0F : std::sqrt(2 * *std::max_element(half_norms.begin(), half_norms.end()));
    };
    margin_ = std::numeric_limits<float>::epsilon() * static_cast<float>(length_ + 8) *
              (longest(rows.half_squared_norms()) + longest(columns.half_squared_norms()));
    call_both(
        executor, [&] { rows_ = rows.panels(tile_rows, center); },
        [&] { columns_ = columns.panels(tile_columns, center); });
  }

  [[nodiscard]] Index row_panels() const { return static_cast<Index>(row_norms_.size() / tile_rows); }

  /// Compares the features of row panels [begin, end) with those of the column panels whose shadows are nearest,
  /// `reach` to each side.
  void offer(Index begin, Index end, std::size_t reach, NearestTable& of_rows, NearestTable& of_columns) const {
    for (auto row = static_cast<std::size_t>(begin); row < static_cast<std::size_t>(end); ++row) {
      const std::span<const Span> columns = column_spans_.all();
      const float low = row_spans_.all()[row].low;
      const auto first_beside =
          std::partition_point(columns.begin(), columns.end(), [low](const Span& span) { return span.high < low; });
      const auto start = static_cast<std::size_t>(first_beside - columns.begin());
      const std::size_t last = start + std::min(reach, columns.size() - start);
      for (std::size_t column = start; column < last; ++column) offer_tile(row, column, of_rows, of_columns);
      for (std::size_t column = start; column > start - std::min(reach, start); --column)
        offer_tile(row, column - 1, of_rows, of_columns);
    }
  }

 private:
  using Tile = std::array<std::array<FloatLanes, 2>, tile_rows>;
  /// Where a panel's shadows lie.
  struct Span {
    float low, high;
  };

  [[nodiscard]] static Table<Span> spans(std::span<const float> shadows, std::size_t width) {
    Table<Span> result;
    for (std::size_t begin = 0; begin < shadows.size(); begin += width)
      result.push_back({shadows[begin], shadows[std::min(begin + width, shadows.size()) - 1]});
    return result;
  }

  /// Half the squared distance that all pairs of a tile have at least.
  [[nodiscard]] float least_half(std::size_t row_panel, std::size_t column_panel) const {
    constexpr float safely = 1 - 1e-5F;
    const Span &rows = row_spans_.all()[row_panel], &columns = column_spans_.all()[column_panel];
    const float gap = safely * (std::max(rows.low - columns.high, columns.low - rows.high) - margin_);
    return gap > 0 ? 0.5F * gap * gap : 0.0F;
  }

  /// Infinitely long where a panel has no more features: nothing is ever near.
  [[nodiscard]] static std::vector<float> padded(std::span<const float> norms, std::size_t width) {
    std::vector<float> result((norms.size() + width - 1) / width * width, std::numeric_limits<float>::infinity());
    std::copy(norms.begin(), norms.end(), result.begin());
    return result;
  }

  /// |a|^2 / 2 + |b|^2 / 2 - a . b, half the squared distance, of every pair.
  void measure(std::size_t row_panel, std::size_t column_panel, Tile& result) const {
    FloatLanes left, right;
    load(&column_norms_[column_panel * tile_columns], left);
    load(&column_norms_[column_panel * tile_columns + lane_count], right);
    Tile tile;
    const float* norms = &row_norms_[row_panel * tile_rows];
#pragma GCC unroll 6
    for (std::size_t r = 0; r < tile_rows; ++r) tile[r] = {norms[r] + left, norms[r] + right};
    const float* a = &rows_[row_panel * tile_rows * length_];
    const float* b = &columns_[column_panel * tile_columns * length_];
    for (std::size_t k = 0; k < length_; ++k, a += tile_rows, b += tile_columns) {
      load(b, left);
      load(b + lane_count, right);
#pragma GCC unroll 6
      for (std::size_t r = 0; r < tile_rows; ++r) {
        tile[r][0] -= a[r] * left;
        tile[r][1] -= a[r] * right;
      }
    }
    result = tile;
  }

  /// Where a row's distances are within a limit, its own or the columns'.
  static void find_near(const std::array<FloatLanes, 2>& row, float limit, const FloatLanes& left,
                        const FloatLanes& right, MaskLanes& near) {
    near |= (row[0] <= left) | (row[1] <= right) | (row[0] <= limit) | (row[1] <= limit);
  }

  void offer_tile(std::size_t row_panel, std::size_t column_panel, NearestTable& of_rows,
                  NearestTable& of_columns) const {
    const std::size_t first_row = row_panel * tile_rows, first_column = column_panel * tile_columns;
    const float* row_limits = of_rows.limits() + first_row;
    FloatLanes left, right;
    load(of_columns.limits() + first_column, left);
    load(of_columns.limits() + first_column + lane_count, right);
    const float least = least_half(row_panel, column_panel);
    if (least > *std::max_element(row_limits, row_limits + tile_rows) && !any((left >= least) | (right >= least)))
      return;
    Tile tile;
    measure(row_panel, column_panel, tile);
    MaskLanes near{};
#pragma GCC unroll 6
    for (std::size_t r = 0; r < tile_rows; ++r) find_near(tile[r], row_limits[r], left, right, near);
    if (!any(near)) return;
    const std::size_t rows = std::min(tile_rows, row_count_ - first_row);
    const std::size_t columns = std::min(tile_columns, column_count_ - first_column);
    for (std::size_t r = 0; r < rows; ++r) {
      near = MaskLanes{};
      find_near(tile[r], row_limits[r], left, right, near);
      if (!any(near)) continue;
      for (std::size_t c = 0; c < columns; ++c) {
        const auto row = static_cast<Index>(first_row + r), column = static_cast<Index>(first_column + c);
        const float half = tile[r][c / lane_count][c % lane_count];
        if (half <= of_rows.limit(row)) of_rows.offer(row, column, half);
        if (half <= of_columns.limit(column)) of_columns.offer(column, row, half);
      }
    }
  }

  std::vector<float> rows_, columns_;
  std::size_t length_, row_count_, column_count_;
  std::vector<float> row_norms_, column_norms_;
  Table<Span> row_spans_, column_spans_;
  float margin_ = 0;  ///< what rounding can do to two shadows
};

/// The nearest both ways.
struct NearestBothWays {
  NearestTable of_source, of_target;
};

/// Of the features of both sets the nearest of the other, from one pass over the distances that may matter.
template <Executor Exec>
[[nodiscard]] NearestBothWays nearest_both_ways(const FeatureSet& source, const FeatureSet& target,
                                                const std::vector<float>& center, bool with_second,
                                                const Exec& executor) {
  // A sum of n products is off by at most n eps |a| |b| <= n eps (|a|^2 + |b|^2) / 2; twice that, and the norms' own.
  const float rounding = std::numeric_limits<float>::epsilon() * static_cast<float>(2 * source.length() + 16);
  NearestBothWays found{NearestTable(source, target, rounding, with_second),
                        NearestTable(target, source, rounding, with_second)};
  if (source.size() == 0 || target.size() == 0) return found;
  const DistanceTiles tiles(source, target, center, executor);
  // What those with near shadows tell spares most of the others' tiles.
  constexpr std::size_t beside = 3, all = std::numeric_limits<std::size_t>::max();
  const Index panels = tiles.row_panels(), grain = std::max(Index{96}, (panels + 5) / 6);
  for (const std::size_t reach : {beside, all}) {
    std::vector<NearestTable> parts(static_cast<std::size_t>(count_chunks(panels, grain)), found.of_target);
    executor.for_chunks(panels, grain, [&](Index begin, Index end) {
      tiles.offer(begin, end, reach, found.of_source, parts[static_cast<std::size_t>(begin / grain)]);
    });
    for (const NearestTable& part : parts) found.of_target.offer(part);
  }
  return found;
}

}  // namespace chainslam::detail
