// expect: breadth_first_search: Visitor needs one or more of
// expect: see chainslam/slam/adjacency_graph.hpp
// A visitor that wants to be told more about a node than a search knows.
#include "chainslam/slam/adjacency_graph.hpp"
#include "chainslam/slam/breadth_first_search.hpp"

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
