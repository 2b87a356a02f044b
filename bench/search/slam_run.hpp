#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "chainslam/search/brute_force.hpp"
#include "search/structure.hpp"
#include "search/timing.hpp"
#include "search/workload.hpp"

namespace chainslam::bench {

/// What one structure took for each scan of the walk.
struct Series {
  std::string name;
  std::vector<Elapsed> first;   ///< 5-NN of each point of a scan
  std::vector<Elapsed> again;   ///< the three times that an iterated filter asks again; nothing where it does not
  std::vector<Elapsed> insert;  ///< of the scan
  std::vector<Elapsed> erase;   ///< nothing where the map does not move
  double points = 0;            ///< live, at the end
  double bytes = 0;             ///< of the heap, all in, at the end
  double differing = 0;         ///< share of the checked queries that another map than ours answers otherwise
  double missing = 0;           ///< share of the checked queries whose answer is not that of looking at every point

  [[nodiscard]] Elapsed step(std::size_t i) const {
    Elapsed sum = first[i];
    sum += insert[i];
    sum += erase[i];
    return sum;
  }
};

/// Steps all structures through the walk, scan by scan, each scan beginning with another one; asks, inserts and forgets
/// apart.
///
/// Each answers from its own map. Every thirtieth scan, the clock stopped, a hundred of its answers are compared with
/// those of looking at every point of that map; and, where a structure thins as ours do, all answers with the first
/// structure's. ikd-Tree computes cells and distances to their centres in float: a voxel in some thousands keeps
/// another point, so one answer in a hundred may differ there.
class SlamRun {
 public:
  explicit SlamRun(const std::vector<Maker>& makers) : makers_(makers), series_(makers.size()) {
    for (std::size_t i = 0; i < makers.size(); ++i) {
      structures_.push_back(makers[i].make());
      series_[i].name = makers[i].name;
    }
    const double helpers = helpers_time();
    const std::vector<Step>& steps = walk().steps();
    for (std::size_t s = 0; s < steps.size(); ++s) {
      for (std::size_t i = 0; i < structures_.size(); ++i) {
        const std::size_t turn = (s + i) % structures_.size();
        advance(*structures_[turn], series_[turn], steps[s], s > 0);
      }
      if (s % check_every == check_every / 2) check(steps[s].scan);
    }
    helpers_seconds_ = helpers_time() - helpers;
    finish();
  }

  [[nodiscard]] const std::vector<Series>& series() const { return series_; }
  /// What ikd-Tree's own thread took.
  [[nodiscard]] double helpers_seconds() const { return helpers_seconds_; }

 private:
  static constexpr std::size_t k = 5, check_every = 30;

  static void advance(Structure& structure, Series& series, const Step& step, bool ask) {
    series.first.push_back(ask ? measure([&] { structure.knn(step.scan, k); }) : Elapsed{});
    Elapsed again;
    if (ask)
      for (const Points& moved : step.again) again += measure([&] { structure.knn_again(moved, k); });
    series.again.push_back(again);
    series.insert.push_back(measure([&] { structure.insert(step.scan); }));
    Elapsed erase;
    for (const Move& move : step.moves) erase += measure([&] { structure.erase(move); });
    series.erase.push_back(erase);
  }

  void check(const Points& scan) {
    std::vector<float> reference;
    for (std::size_t i = 0; i < structures_.size(); ++i) {
      Structure& structure = *structures_[i];
      structure.knn(scan, k);
      const std::vector<float> answers = structure.squared_distances();
      const double missing = share_missing(structure, scan, answers);
      if (makers_[i].exact && missing > 0)
        throw std::runtime_error(makers_[i].name + ": answers differ from looking at every point");
      series_[i].missing = std::max(series_[i].missing, missing);
      if (i == 0) reference = answers;
      if (makers_[i].thinning == Thinning::own) continue;
      const double differing = share_differing(answers, reference, structure.reach());
      if (differing > 0.01)
        throw std::runtime_error(makers_[i].name + ": " + std::to_string(100 * differing) +
                                 " % of the answers differ from those of " + makers_[0].name);
      series_[i].differing = std::max(series_[i].differing, differing);
    }
  }

  static bool same(float a, float b, float reach) {
    const float limit = 0.999f * reach * reach;
    return (a >= limit && b >= limit) || std::abs(a - b) <= 1e-4f * std::max(a, b) + 1e-6f;
  }

  static double share_differing(const std::vector<float>& ours, const std::vector<float>& theirs, float reach) {
    std::size_t count = 0;
    for (std::size_t i = 0; i < ours.size(); i += k) {
      bool all_same = true;
      for (std::size_t j = i; j < i + k; ++j) all_same = all_same && same(ours[j], theirs[j], reach);
      count += all_same ? 0 : 1;
    }
    return static_cast<double>(count) / (static_cast<double>(ours.size()) / k);
  }

  static double share_missing(Structure& structure, const Points& scan, const std::vector<float>& answers) {
    constexpr std::size_t checked = 100;
    const BruteForce<float> brute_force(structure.points());
    std::vector<float> found, expected;
    for (std::size_t n = 0; n < checked; ++n) {
      const std::size_t query = n * scan.size() / checked;
      std::array<Neighbor<float>, k> nearest;
      nearest.fill({-1, std::numeric_limits<float>::infinity()});
      brute_force.knn(scan[query], nearest);
      for (std::size_t j = 0; j < k; ++j) {
        expected.push_back(nearest[j].squared_distance);
        found.push_back(answers[query * k + j]);
      }
    }
    return share_differing(found, expected, structure.reach());
  }

  void finish() {
    for (std::size_t i = 0; i < structures_.size(); ++i) {
      series_[i].points = static_cast<double>(structures_[i]->points().size());
      structures_[i]->drop_answers();
      const double held = heap_bytes();
      structures_[i].reset();
      series_[i].bytes = held - heap_bytes();
    }
  }

  const std::vector<Maker>& makers_;
  std::vector<std::unique_ptr<Structure>> structures_;
  std::vector<Series> series_;
  double helpers_seconds_ = 0;
};

}  // namespace chainslam::bench
