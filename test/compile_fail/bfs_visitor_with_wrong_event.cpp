// expect: breadth_first_search: Visitor needs one or more of
// expect: see chainslam/graph/concepts.hpp
// A visitor that wants to be told more about a node than a search knows.
#include "chainslam/graph/adjacency_graph.hpp"
#include "chainslam/graph/breadth_first_search.hpp"

struct MyVisitor {
#ifdef CHAINSLAM_RIGHT
  void discover(chainslam::Index node);
#else
  void discover(chainslam::Index node, double distance);
#endif
};

void visit(const chainslam::AdjacencyGraph<>& graph, MyVisitor& visitor, chainslam::BfsWorkspace& workspace) {
  chainslam::breadth_first_search(graph, 0, visitor, {}, workspace);
}
