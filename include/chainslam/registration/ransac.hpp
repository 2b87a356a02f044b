#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/features/matching.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/registration/overlap.hpp"
#include "chainslam/search/concepts.hpp"

namespace chainslam {

namespace detail {

/// The two ends of all matches, metres.
struct MatchedPoints {
  std::vector<Eigen::Vector3d> source, target;

  [[nodiscard]] Index size() const { return static_cast<Index>(source.size()); }
};

/// A pose and what the matches say of it.
struct Hypothesis {
  SE3d T_target_source;
  Index consensus = 0;  ///< matches brought together
  double gain = 0;      ///< by how much their squared distances fall short of the largest allowed, summed, m^2
};

}  // namespace detail

/// Finds the rigid motion that most matches agree on, where most matches may be wrong: random sample consensus
/// (Fischler and Bolles 1981) over triples of matches.
///
/// A triple whose two triangles differ in an edge is dropped before a motion is fitted to it, and the motion is dropped
/// if it does not bring the triple itself together. The best is the one with the least sum of squared distances, each
/// cut off at the largest allowed (Torr and Zisserman 2000, MSAC): fitting it again to the matches that agree, as is
/// done with each triple that beats those before it (Chum, Matas and Kittler 2003), cannot make it worse. The number of
/// hypotheses follows from its consensus.
struct Ransac {
  double max_distance = 1.0;       ///< metres, of a match that agrees; of an inlier
  double edge_length_ratio = 0.9;  ///< least ratio of the shorter to the longer edge
  Index max_iterations = 10'000;   ///< hypotheses
  double confidence = 0.999;       ///< that a triple of right matches is among the hypotheses, for stopping early
  Index min_consensus = 10;  ///< matches that must agree; three always do, and of other places eight did by chance
  Index refits = 10;         ///< times a new best motion is fitted again, at most, while it gets better; 0: not at all
  std::uint64_t seed = 0;

  /// @param source    points in the source's frame, metres.
  /// @param target    search over points in the target's frame; `position(i)` takes the matches' target indices.
  /// @param matches   putative; those with a point that is not finite are passed over.
  /// @param executor  runs the hypotheses; the result is the same to the bit for any.
  /// @returns pose, figures and status; never throws for what points and matches are like.
  /// @throws std::invalid_argument if an option makes no sense or a match names a source point that is not there.
  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] GlobalAlignResult align(const Source& source, const Target& target,
                                        std::span<const FeatureMatch> matches, const Exec& executor = {}) const {
    check();
    const detail::MatchedPoints points = gather(source, target, matches);
    GlobalAlignResult result;
    result.matches = points.size();
    result.status = GlobalAlignStatus::too_few_matches;
    if (points.size() < sample_size) return result;
    const detail::Hypothesis best = search(points, result.iterations, executor);
    result.status = GlobalAlignStatus::no_consensus;
    if (best.consensus < std::max(min_consensus, sample_size)) return result;
    result.status = GlobalAlignStatus::found;
    result.T_target_source = best.T_target_source;
    result.consensus = best.consensus;
    result.putative_ratio = static_cast<double>(best.consensus) / points.size();
    const Overlap overlap = measure_overlap(source, target, best.T_target_source, max_distance, executor);
    result.inliers = overlap.inliers;
    result.fitness_target = overlap.share_of_target;
    result.fitness_source = overlap.share_of_source;
    result.inlier_rmse = overlap.rmse;
    return result;
  }

 private:
  static constexpr Index sample_size = 3;

  void check() const {
    if (!(max_distance > 0) || !(edge_length_ratio >= 0 && edge_length_ratio <= 1))
      throw std::invalid_argument("Ransac: max_distance must be positive, edge_length_ratio in [0, 1]");
    if (max_iterations < 1 || !(confidence > 0 && confidence < 1))
      throw std::invalid_argument("Ransac: max_iterations must be at least 1, confidence in (0, 1)");
  }

  template <class Source, class Target>
  [[nodiscard]] static detail::MatchedPoints gather(const Source& source, const Target& target,
                                                    std::span<const FeatureMatch> matches) {
    const Index count = to_index(cloud_size(source), "cloud");
    detail::MatchedPoints points;
    for (const FeatureMatch& match : matches) {
      if (match.source < 0 || match.source >= count || match.target < 0)
        throw std::invalid_argument("Ransac: a match names a point that is not there");
      const Eigen::Vector3d p = position(source, static_cast<std::size_t>(match.source));
      const auto& q = target.position(match.target);
      const Eigen::Vector3d q_target(static_cast<double>(q[0]), static_cast<double>(q[1]), static_cast<double>(q[2]));
      if (!is_finite(p) || !is_finite(q_target)) continue;
      points.source.push_back(p);
      points.target.push_back(q_target);
    }
    return points;
  }

  /// Tries hypotheses 0, 1, ... as one thread would, which stops after the one that makes it confident; batches only
  /// look ahead.
  template <class Exec>
  [[nodiscard]] detail::Hypothesis search(const detail::MatchedPoints& points, Index& iterations,
                                          const Exec& executor) const {
    constexpr Index grain = 32, largest_batch = 2048;
    const Rng rng(seed);
    detail::Hypothesis best;
    double most_by_triple = 0;  // triples compete as they are: one fitted again would keep better ones out
    std::vector<detail::Hypothesis> batch;
    Index enough = max_iterations;
    for (Index size = 2 * grain; iterations < enough; size = std::min(2 * size, largest_batch)) {
      batch.assign(static_cast<std::size_t>(std::min(size, enough - iterations)), {});
      executor.for_chunks(static_cast<Index>(batch.size()), grain, [&](Index begin, Index end) {
        for (Index i = begin; i < end; ++i)
          batch[static_cast<std::size_t>(i)] = hypothesis(points, rng.fork(static_cast<std::uint64_t>(iterations + i)));
      });
      for (std::size_t i = 0; i < batch.size() && iterations < enough; ++i, ++iterations) {
        if (!(batch[i].gain > most_by_triple)) continue;
        most_by_triple = batch[i].gain;
        const detail::Hypothesis refitted = refit(points, batch[i]);
        if (refitted.gain > best.gain) best = refitted;
        enough = std::min(enough, needed(best.consensus, points.size()));
      }
    }
    return best;
  }

  /// Hypotheses after which a triple of right matches has been among them with `confidence`, if `consensus` of `count`
  /// matches are right: log(1 - confidence) / log(1 - ratio^3).
  [[nodiscard]] Index needed(Index consensus, Index count) const {
    const double ratio = static_cast<double>(consensus) / count;
    const double iterations = std::log1p(-confidence) / std::log1p(-ratio * ratio * ratio);
    return static_cast<Index>(std::ceil(std::clamp(iterations, 1.0, static_cast<double>(max_iterations))));
  }

  /// One triple, the motion that it tells and all that agree; no consensus if the triple itself does not.
  [[nodiscard]] detail::Hypothesis hypothesis(const detail::MatchedPoints& points, Rng rng) const {
    const Index count = points.size();
    std::array<Index, sample_size> chosen{rng.uniform_index(count), rng.uniform_index(count), rng.uniform_index(count)};
    if (chosen[0] == chosen[1] || chosen[0] == chosen[2] || chosen[1] == chosen[2]) return {};
    std::array<Eigen::Vector3d, sample_size> source, target;
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      source[i] = points.source[static_cast<std::size_t>(chosen[i])];
      target[i] = points.target[static_cast<std::size_t>(chosen[i])];
    }
    if (!edges_alike(source, target)) return {};
    const std::optional<Sim3d> fit = umeyama(source, target, false);
    if (!fit) return {};
    const SE3d T(fit->rotation(), fit->translation());
    for (std::size_t i = 0; i < chosen.size(); ++i)
      if ((T * source[i] - target[i]).squaredNorm() > max_distance * max_distance) return {};
    return score(points, T);
  }

  [[nodiscard]] bool edges_alike(std::span<const Eigen::Vector3d> source,
                                 std::span<const Eigen::Vector3d> target) const {
    for (std::size_t i = 0; i < source.size(); ++i) {
      const std::size_t next = (i + 1) % source.size();
      const double a = (source[i] - source[next]).norm(), b = (target[i] - target[next]).norm();
      if (!(std::min(a, b) >= edge_length_ratio * std::max(a, b))) return false;
    }
    return true;
  }

  [[nodiscard]] detail::Hypothesis score(const detail::MatchedPoints& points, const SE3d& T) const {
    const Eigen::Matrix3d R = T.rotation().matrix();
    const Eigen::Vector3d t = T.translation();
    detail::Hypothesis scored{.T_target_source = T};
    for (std::size_t i = 0; i < points.source.size(); ++i) {
      const double squared = (R * points.source[i] + t - points.target[i]).squaredNorm();
      if (squared > max_distance * max_distance) continue;
      ++scored.consensus;
      scored.gain += max_distance * max_distance - squared;
    }
    return scored;
  }

  [[nodiscard]] detail::Hypothesis refit(const detail::MatchedPoints& points, detail::Hypothesis best) const {
    for (Index i = 0; i < refits && best.consensus >= sample_size; ++i) {
      detail::MatchedPoints agreeing;
      for (std::size_t k = 0; k < points.source.size(); ++k) {
        if ((best.T_target_source * points.source[k] - points.target[k]).squaredNorm() > max_distance * max_distance)
          continue;
        agreeing.source.push_back(points.source[k]);
        agreeing.target.push_back(points.target[k]);
      }
      const std::optional<Sim3d> fit = umeyama(agreeing.source, agreeing.target, false);
      if (!fit) break;
      const detail::Hypothesis next = score(points, SE3d(fit->rotation(), fit->translation()));
      if (!(next.gain > best.gain)) break;
      best = next;
    }
    return best;
  }
};

}  // namespace chainslam
