#pragma once

#include <array>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "chainslam/registration/align.hpp"
#include "chainslam/registration/verified_registration.hpp"
#include "chainslam/slam/back_end.hpp"
#include "chainslam/slam/place_candidates.hpp"

namespace chainslam::mapper {

/// Whose method: `paper` does what the paper says, `released` what its code does, front end included, `best` what can
/// be shown to be better.
enum class Preset { best, paper, released };

/// Parameters that go with a vehicle's pace, as the paper's released configurations have them.
enum class Platform { nclt, mars };

enum class ClosureMethod { point_to_plane, point_to_point };

/// Scan to submap, by the method that the configuration names.
struct ClosureRegistration {
  ClosureMethod method = ClosureMethod::point_to_plane;
  CoarseToFine<> point_to_plane{};
  Icp<PointToPoint> point_to_point{.max_iterations = 100, .max_distance = 2.0};

  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess,
                                  const Exec& executor = {}) const {
    return method == ClosureMethod::point_to_plane ? point_to_plane.align(source, target, guess, executor)
                                                   : point_to_point.align(source, target, guess, executor);
  }

  /// For a good guess: `CoarseToFine::refine`.
  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult refine(const Source& source, const Target& target, const SE3d& guess,
                                   const Exec& executor = {}) const {
    return method == ClosureMethod::point_to_plane ? point_to_plane.refine(source, target, guess, executor)
                                                   : point_to_point.align(source, target, guess, executor);
  }

  /// Cheap, to compare guesses: `CoarseToFine::rough`.
  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult rough(const Source& source, const Target& target, const SE3d& guess,
                                  const Exec& executor = {}) const {
    return method == ClosureMethod::point_to_plane ? point_to_plane.rough(source, target, guess, executor)
                                                   : point_to_point.align(source, target, guess, executor);
  }
};

/// The noise of a closure that goes with the method: from the registration's Hessian, or the paper's lambda e I.
struct ClosureNoise {
  bool from_hessian = true;
  HessianCovariance hessian{};
  IsotropicCovariance isotropic{};

  [[nodiscard]] Matrix6d operator()(const AlignResult& result) const {
    return from_hessian ? hessian(result) : isotropic(result);
  }
};

enum class MergeMethod { verified, features };

/// Submap to submap without a guess, by the method that the configuration names.
struct MergeRegistration {
  MergeMethod method = MergeMethod::verified;
  VerifiedRegistration<> verified = VerifiedRegistration<>::for_submaps();
  FeatureRegistration<> features{};

  template <Cloud Source, Cloud Target, Executor Exec = Serial>
  [[nodiscard]] GlobalAlignResult align(const Source& source, const Target& target, const Exec& executor = {}) const {
    return method == MergeMethod::verified ? verified.align(source, target, executor)
                                           : features.align(source, target, executor);
  }
};

/// The parts of the mapper's back end, as the configuration sets them.
struct BackEndParts {
  ProximityCandidates candidates;
  LoopCloserOptions closures;
  ClosureRegistration registration;
  ClosureNoise noise;
  ChainOptions chain;
  GnssCandidateOptions gnss;
  PlaceCandidateOptions places;
  Index closure_places = 2;  ///< `max_count` of places within a frame; what else they are is as for merging
  MergeOptions merge;
  MergeRegistration merging;
  BackEndOptions back_end;
  GroupGnc outliers;
};

/// One setting as the published system has it, in the form in which the configuration file writes it.
struct PresetValue {
  std::string_view key;
  std::array<std::string_view, 2> paper, released;  ///< by platform: nclt, mars
  std::string_view source;                          ///< where paper and code say so
};

/// All that `paper` and `released` set, front end and back end. What is not in the table is as `best` has it.
[[nodiscard]] std::span<const PresetValue> preset_table();

/// Settings that go with a preset on a platform; of `best` those that go with the platform's pace.
[[nodiscard]] std::vector<std::pair<std::string_view, std::string_view>> values_of(Preset preset, Platform platform);

}  // namespace chainslam::mapper
