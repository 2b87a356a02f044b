#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/sparse/block_matrix.hpp"

namespace chainslam::test {

/// A chain with random blocks beside it; about `density` blocks per column.
inline BlockPattern random_pattern(Rng& rng, Index size, double density) {
  std::vector<BlockCoordinate> blocks;
  for (Index k = 1; k < size; ++k) {
    if (rng.uniform() < 0.9) blocks.push_back({k, k - 1});
  }
  const Index extra = static_cast<Index>(density * size);
  for (Index k = 0; k < extra; ++k) blocks.push_back({rng.uniform_index(size), rng.uniform_index(size)});
  return BlockPattern(size, blocks);
}

/// The pattern of the edges of a g2o file, whose poses are numbered from 0.
inline BlockPattern pose_graph_pattern(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::vector<BlockCoordinate> blocks;
  Index size = 0;
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    std::string tag;
    BlockCoordinate edge;
    if (!(words >> tag) || !tag.starts_with("EDGE") || !(words >> edge.row >> edge.column)) continue;
    size = std::max({size, edge.row + 1, edge.column + 1});
    blocks.push_back(edge);
  }
  return BlockPattern(size, blocks);
}

/// The normal equations of random factors: one unary factor on column 0, and one binary factor for each block.
template <int N>
BlockMatrix<N> random_normal_equations(const BlockPattern& pattern, Rng& rng, double unary_everywhere = 0.0) {
  using Block = typename BlockMatrix<N>::Block;
  BlockMatrix<N> matrix(pattern);
  const auto random_block = [&] {
    return Block::NullaryExpr([&](Eigen::Index, Eigen::Index) { return rng.normal(); });
  };
  for (Index column = 0; column < pattern.size(); ++column) {
    matrix.block(pattern.begin(column)) += (column == 0 ? 1.0 : unary_everywhere) * Block::Identity();
    for (Offset k = pattern.begin(column) + 1; k < pattern.end(column); ++k) {
      const Block from = Block::Identity() + 0.3 * random_block();
      const Block to = -Block::Identity() + 0.3 * random_block();
      matrix.block(pattern.begin(column)) += from.transpose() * from;
      matrix.block(pattern.begin(pattern.row(k))) += to.transpose() * to;
      matrix.block(k) += to.transpose() * from;
    }
  }
  return matrix;
}

template <int N>
Eigen::MatrixXd dense(const BlockMatrix<N>& matrix) {
  const BlockPattern& pattern = matrix.pattern();
  Eigen::MatrixXd result = Eigen::MatrixXd::Zero(pattern.size() * N, pattern.size() * N);
  for (Index column = 0; column < pattern.size(); ++column) {
    for (Offset k = pattern.begin(column); k < pattern.end(column); ++k) {
      result.block<N, N>(pattern.row(k) * N, column * N) = matrix.block(k);
      result.block<N, N>(column * N, pattern.row(k) * N) = matrix.block(k).transpose();
    }
  }
  return result;
}

inline Eigen::VectorXd random_vector(Rng& rng, Eigen::Index size) {
  return Eigen::VectorXd::NullaryExpr(size, [&](Eigen::Index) { return rng.normal(); });
}

template <class Solver>
Eigen::VectorXd solved(Solver& solver, Eigen::VectorXd x) {
  solver.solve({x.data(), static_cast<std::size_t>(x.size())});
  return x;
}

}  // namespace chainslam::test
