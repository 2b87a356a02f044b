#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <span>
#include <unordered_map>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/sparse/detail/front.hpp"
#include "chainslam/sparse/detail/front_tree.hpp"

namespace chainslam::detail {

/// Substitutes right-hand sides that touch few variables: only the fronts from there to the roots take part.
template <int B>
class PathSolver {
 public:
  /// @param variables  that the right-hand sides touch; all are eliminated in the tree.
  PathSolver(const FrontTree<B>& tree, std::span<const Index> variables) : tree_(tree) {
    std::vector<std::vector<Index>> ways;
    for (const Index variable : variables) {
      std::vector<Index> way;
      for (Index node = tree.node_of(variable); node != -1 && !seen(node); node = tree[node].parent) {
        way.push_back(node);
        for (const Index column : tree.columns(node)) row_.emplace(column, static_cast<Eigen::Index>(row_.size()) * B);
      }
      ways.push_back(std::move(way));
    }
    // A later way ends below an earlier one's node: it comes first.
    for (auto way = ways.rbegin(); way != ways.rend(); ++way) nodes_.insert(nodes_.end(), way->begin(), way->end());
  }

  /// E^T H^-1 E, where H is the matrix that was factorised.
  ///
  /// @param variables  of E's block rows; all that the constructor got, or some of them.
  [[nodiscard]] Eigen::MatrixXd inverse_product(std::span<const Index> variables, const Eigen::MatrixXd& E) const {
    Eigen::MatrixXd X = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(row_.size()) * B, E.cols());
    for (std::size_t k = 0; k < variables.size(); ++k)
      X.middleRows<B>(row_.at(variables[k])) += E.middleRows<B>(static_cast<Eigen::Index>(k) * B);
    Eigen::VectorXd gathered;
    for (const Index node : nodes_) {
      const Front<B> front = tree_.front(node);
      gathered.resize(front.stride());
      for (Eigen::Index column = 0; column < E.cols(); ++column) {
        for_each_row(node, [&](Eigen::Index in_front, Eigen::Index row) {
          gathered.segment<B>(in_front) = X.col(column).template segment<B>(row);
        });
        front.substitute_forward(gathered.data());
        for_each_row(node, [&](Eigen::Index in_front, Eigen::Index row) {
          X.col(column).template segment<B>(row) = gathered.segment<B>(in_front);
        });
      }
    }
    return X.transpose().lazyProduct(X);
  }

 private:
  [[nodiscard]] bool seen(Index node) const { return row_.contains(tree_.columns(node).front()); }

  template <class Visit>
  void for_each_row(Index node, Visit&& visit) const {
    Eigen::Index in_front = 0;
    for (const Index variable : tree_.variables(node)) {
      visit(in_front, row_.at(variable));
      in_front += B;
    }
  }

  const FrontTree<B>& tree_;
  std::vector<Index> nodes_;                     ///< children before parents
  std::unordered_map<Index, Eigen::Index> row_;  ///< of each variable eliminated in them
};

}  // namespace chainslam::detail
