#include "simulator/wander.hpp"

#include <array>
#include <map>
#include <stdexcept>
#include <utility>
#include <vector>

namespace chainslam::simulator {

Route wander(const Window& window, Index streets, Rng rng) {
  const Index columns = window.high.column - window.low.column + 1;
  const Index rows = window.high.row - window.low.row + 1;
  if (columns < 2 || rows < 2) throw std::invalid_argument("wander: the window needs at least 2 x 2 crossings");
  using Node = std::pair<Index, Index>;
  std::map<std::pair<Node, Node>, int> seen;
  const auto street = [](const Node& a, const Node& b) { return std::pair(std::min(a, b), std::max(a, b)); };

  const Index row = window.low.row + rng.uniform_index(rows);  // first: arguments have no order of evaluation
  Node here(window.low.column + rng.uniform_index(columns), row);
  Node before(-1, -1);
  Route route{{here.first, here.second}};
  for (Index i = 0; i < streets; ++i) {
    std::vector<std::pair<Node, double>> choices;
    double sum = 0.0;
    for (const auto& [dx, dy] : {Node(1, 0), Node(-1, 0), Node(0, 1), Node(0, -1)}) {
      const Node next(here.first + dx, here.second + dy);
      const bool inside = next.first >= window.low.column && next.first <= window.high.column &&
                          next.second >= window.low.row && next.second <= window.high.row;
      if (!inside || next == before) continue;
      sum += seen[street(here, next)] == 0 ? 1.0 : 0.1;
      choices.emplace_back(next, sum);
    }
    const double lot = rng.uniform() * sum;
    std::size_t chosen = 0;
    while (chosen + 1 < choices.size() && choices[chosen].second <= lot) ++chosen;
    before = std::exchange(here, choices[chosen].first);
    ++seen[street(before, here)];
    route.push_back({here.first, here.second});
  }
  return route;
}

}  // namespace chainslam::simulator
