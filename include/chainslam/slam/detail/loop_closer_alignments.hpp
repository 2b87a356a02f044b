#pragma once

#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/registration/alignment_checks.hpp"
#include "chainslam/slam/loop_closer.hpp"

// How `LoopCloser` searches and aligns.

namespace chainslam {

template <class Candidates, class Registration, class Covariance>
template <Executor E>
std::vector<LoopClosure> LoopCloser<Candidates, Registration, Covariance>::search(std::span<const Keyframe> keyframes,
                                                                                  const PositionIndex& index,
                                                                                  KeyframeId query, const E& executor) {
  std::vector<LoopClosure> tried;
  const SE3d& here = keyframes[static_cast<std::size_t>(query.value)].T_map_body;
  const auto accepted = [&] { return !tried.empty() && tried.back().verdict == ClosureVerdict::accepted; };
  for (const KeyframeId candidate : candidates_.find(keyframes, index, query)) {
    const SE3d guess = keyframes[static_cast<std::size_t>(candidate.value)].T_map_body.inverse() * here;
    tried.push_back(align(keyframes, candidate, query, guess, executor));
    if (accepted()) break;
  }
  if (!tried.empty() && !accepted()) search_wider(keyframes, index, tried, executor);
  if constexpr (requires { candidates_.recognize(keyframes, index, query); }) {
    if (!accepted())
      for (const KeyframeId candidate : candidates_.recognize(keyframes, index, query)) {
        tried.push_back(align(keyframes, candidate, query, candidates_.guess(candidate, query).value(), executor));
        if (accepted()) break;
      }
  }
  if (accepted()) refused_ = 0;
  return tried;
}

template <class Candidates, class Registration, class Covariance>
template <Executor E>
void LoopCloser<Candidates, Registration, Covariance>::search_wider(std::span<const Keyframe> keyframes,
                                                                    const PositionIndex& index,
                                                                    std::vector<LoopClosure>& tried,
                                                                    const E& executor) {
  if constexpr (requires(const Submap& submap) {
                  registration_.rough(PointCloud<float>{}, submap, SE3d(), executor);
                }) {
    const KeyframeId from = tried.front().from, to = tried.front().to;
    const auto at = [&](KeyframeId id) -> const Keyframe& { return keyframes[static_cast<std::size_t>(id.value)]; };
    const SE3d& T_map_scan = at(to).T_map_body;
    const auto offsets = options_.starts(index.covariance(from, to), T_map_scan.rotation(), ++refused_);
    if (offsets.empty() || !at(to).cloud) return;
    const PlacedSubmap target = submaps_.get(keyframes, from, executor);
    const SE3d guess = target.T_keyframe_submap.inverse() * at(from).T_map_body.inverse() * T_map_scan;
    const double noise = submaps_.surface_noise(*target.submap);
    const PointCloud<float> some = detail::evenly(scan_of(at(to)), options_.starts.points);
    double least = std::numeric_limits<double>::infinity();
    SE3d best = guess;
    for (const Eigen::Vector3d& offset : offsets) {
      const AlignResult rough = registration_.rough(some, *target.submap, guess * SE3d(SO3d(), offset), executor);
      const double misfit = surface_fit(scan_of(at(to)), *target.submap, rough.T_target_source).worst_misfit(noise);
      if (!(misfit < least)) continue;
      least = misfit;
      best = rough.T_target_source;
    }
    tried.push_back(align(keyframes, from, to, target.T_keyframe_submap * best, executor));
  }
}

template <class Candidates, class Registration, class Covariance>
template <Executor E>
std::vector<LoopClosure> LoopCloser<Candidates, Registration, Covariance>::align(
    std::span<const Keyframe> keyframes, std::span<const AlignmentGuess> guesses, KeyframeId to, bool is_good,
    const E& executor) {
  std::vector<LoopClosure> closures;
  std::vector<KeyframeId> from;
  for (const AlignmentGuess& guess : guesses) {
    from.push_back(guess.from);
    closures.push_back(
        {.from = guess.from, .to = to, .T_from_to = guess.T_from_to, .verdict = ClosureVerdict::too_few_inliers});
  }
  const Keyframe& i = keyframes[static_cast<std::size_t>(to.value)];
  if (!i.cloud) return closures;
  const std::vector<PlacedSubmap> submaps = submaps_.get(keyframes, from, executor);
  const PointCloud<float>& scan = scan_of(i);
  std::vector<std::optional<double>> noises;
  for (const PlacedSubmap& one : submaps) noises.push_back(submaps_.known_surface_noise(*one.submap));
  executor.for_chunks(to_index(closures.size()), 1, [&](Index begin, Index /*end*/) {
    const auto k = static_cast<std::size_t>(begin);
    align(closures[k], scan, submaps[k], noises[k], is_good, executor);
  });
  for (std::size_t k = 0; k < noises.size(); ++k)
    if (noises[k]) submaps_.keep_surface_noise(*submaps[k].submap, *noises[k]);
  return closures;
}

template <class Candidates, class Registration, class Covariance>
template <Executor E>
void LoopCloser<Candidates, Registration, Covariance>::align(LoopClosure& closure, const PointCloud<float>& scan,
                                                             const PlacedSubmap& at, std::optional<double>& noise,
                                                             bool is_good, const E& executor) const {
  const SE3d guess = at.T_keyframe_submap.inverse() * closure.T_from_to;
  const AlignResult result = registered(scan, *at.submap, guess, is_good, executor);
  closure.T_from_to = at.T_keyframe_submap * result.T_target_source;
  closure.verdict = options_.gate.judge(result, guess);
  double misfit = 0;
  if (closure.verdict == ClosureVerdict::accepted && options_.gate.max_misfit > 0) {
    if (!noise) noise = surface_noise(*at.submap);
    misfit = options_.gate.misfit(scan, *at.submap, *noise, result.T_target_source);
    closure.verdict = judge_fit(scan, *at.submap, result, misfit, executor);
  }
  closure.mean_squared_error = result.mean_squared_error;
  closure.inlier_ratio = result.inlier_ratio;
  if (closure.verdict == ClosureVerdict::accepted)
    closure.sqrt_information =
        NoiseModel<6>::from_covariance(covariance_(result)).sqrt_information() / inflation(misfit);
}

}  // namespace chainslam
