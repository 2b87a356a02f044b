#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/ranked.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/prior_factor.hpp"
#include "chainslam/map/slam_map.hpp"
#include "chainslam/slam/georeference.hpp"

namespace chainslam {

/// Holds a map's keyframes where their GNSS fixes say, once it is known where each frame of the map lies on the Earth.
///
/// That is found out by the estimate, and again when a frame has a quarter more fixes than the last time; so is each
/// session's bias, which would otherwise pull sessions apart that closures have put together.
/// @tparam Gnc  takes the priors as candidates: `IncrementalGnc`. Its keys are the map's keyframes.
template <class Gnc>
class GnssFactors {
 public:
  explicit GnssFactors(const GnssFactorOptions& options) : options_(options) {}  ///< starts without fixes

  /// Takes a keyframe's fix, which the next `add` will put into the graph; none or one of no use: does nothing.
  [[gnu::cold]] void wait(const Keyframe& keyframe) {
    if (options_.enabled && keyframe.gnss && is_usable(*keyframe.gnss, options_)) waiting_.push_back(keyframe.id.value);
  }
  [[nodiscard]] Index waiting() const { return to_index(waiting_.size()); }  ///< fixes that wait for a factor

  /// Keyframes go over to another frame: their fixes wait again.
  [[gnu::cold]] void carry(std::span<const Index> keyframes, Gnc& gnc) {
    for (const Index i : keyframes) {
      if (i >= priors_.size() || priors_[i] < 0) continue;
      gnc.remove(std::exchange(priors_[i], -1));
      waiting_.push_back(i);
    }
  }

  /// Where frames lie on the Earth is determined again by the next `add`.
  void renew() {
    for (Index i = 0; i < on_earth_.size(); ++i) on_earth_[i].fitted = 0;
  }

  /// Puts into the graph what waits.
  [[gnu::cold]] void add(const SlamMap& map, Gnc& gnc) {
    if (!options_.enabled) return;
    on_earth_.resize(to_index(map.sessions.size()));
    biases_.resize(to_index(map.sessions.size()), Eigen::Vector3d::Zero());
    priors_.resize(to_index(map.keyframes.size()), -1);
    const std::vector<Index> fresh = std::exchange(waiting_, {});
    for (const Index i : fresh) ++on_earth_[frame(map, i).value].fixes;
    for (const Session& session : map.sessions)
      if (session.frame == session.id) fit(map, session.id, gnc);
    for (const Index i : fresh)
      if (const Earth& earth = on_earth_[frame(map, i).value]; earth.T_frame_ecef && priors_[i] < 0)
        put(map, i, *earth.T_frame_ecef, gnc);
  }

  /// How much better the fixes of the newest session are explained, in squared deviations, if its path moves by
  /// `T_new_old` from some keyframe on, `last` at the latest.
  [[nodiscard]] [[gnu::cold]] double gain(const SlamMap& map, const SE3d& T_new_old, Index last, const Gnc& gnc) const {
    double sum = 0, best = 0;
    for (Index i = to_index(map.keyframes.size()); i-- > map.sessions.back().first_keyframe;) {
      if (i < priors_.size() && priors_[i] >= 0) {
        const auto& fix = gnc.factor(priors_[i]);
        const SE3d& here = map.keyframes[static_cast<std::size_t>(i)].T_map_body;
        const auto squared = [&](const SE3d& pose) {
          const auto residual = whitened<6, 1>(fix.sqrt_information, (fix.measurement.inverse() * pose).log());
          return std::min(residual.squaredNorm(), options_.threshold);
        };
        sum += squared(here) - squared(T_new_old * here);
      }
      if (i <= last) best = std::max(best, sum);
    }
    return best;
  }

 private:
  /// A frame on the Earth.
  struct Earth {
    std::optional<SE3d> T_frame_ecef;
    Index fixes = 0, fitted = 0;  ///< so far, and when it was found out
  };

  [[nodiscard]] static SessionId frame(const SlamMap& map, Index i) {
    const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
    return map.sessions[static_cast<std::size_t>(keyframe.session.value)].frame;
  }

  [[gnu::cold]] void fit(const SlamMap& map, SessionId id, Gnc& gnc) {
    Earth& earth = on_earth_[id.value];
    if (earth.fixes <= earth.fitted || 4 * earth.fixes < 5 * earth.fitted) return;
    std::vector<FixedPosition> fixed;
    std::vector<Index> of;
    for (const Keyframe& one : map.keyframes) {
      if (!one.gnss || frame(map, one.id.value) != id || !is_usable(*one.gnss, options_)) continue;
      fixed.push_back({one.T_map_body * options_.antenna, one.gnss->position_ecef});
      of.push_back(one.id.value);
    }
    const std::optional<SE3d> found = georeference(fixed, options_);
    if (!found) return;
    earth.T_frame_ecef = found;
    earth.fitted = earth.fixes;
    find_biases(map, id, fixed, of);
    for (const Index i : of) put(map, i, *found, gnc);
  }

  /// Medians of each session's differences, drawn towards zero where there are few.
  [[gnu::cold]] void find_biases(const SlamMap& map, SessionId id, std::span<const FixedPosition> fixed,
                                 std::span<const Index> of) {
    for (const Session& session : map.sessions) {
      if (session.frame != id) continue;
      std::array<detail::Table<Ranked>, 3> off;
      for (std::size_t k = 0; k < of.size(); ++k) {
        if (of[k] < session.first_keyframe || of[k] >= session.end_keyframe()) continue;
        const Eigen::Vector3d there = *on_earth_[id.value].T_frame_ecef * fixed[k].ecef;
        for (std::size_t axis = 0; axis < 3; ++axis)
          off[axis].push_back({there.data()[axis] - fixed[k].position.data()[axis], of[k]});
      }
      if (off[0].empty()) continue;
      const double count = static_cast<double>(off[0].size());
      for (std::size_t axis = 0; axis < 3; ++axis) {
        sort_ranked(off[axis].all());
        biases_[session.id.value].data()[axis] =
            off[axis][off[axis].size() / 2].rank * count / (count + options_.correlated);
      }
    }
  }

  [[gnu::cold]] void put(const SlamMap& map, Index i, const SE3d& T_frame_ecef, Gnc& gnc) {
    const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
    const Eigen::Vector3d antenna = T_frame_ecef * keyframe.gnss->position_ecef - biases_[keyframe.session.value];
    const PriorFactor<SE3d> prior =
        position_prior(i, antenna, *keyframe.gnss, T_frame_ecef.rotation(), keyframe.T_map_body.rotation(), options_);
    if (priors_[i] < 0)
      priors_[i] = gnc.add(prior, {.threshold = options_.threshold});
    else if (differs(gnc.factor(priors_[i]), prior))
      gnc.replace(priors_[i], prior.mean, prior.sqrt_information);
  }

  /// Whether it is worth the linearization of all that hangs on it to put one prior in place of another.
  template <class Prior>
  [[nodiscard]] static bool differs(const Prior& present, const PriorFactor<SE3d>& next) {
    constexpr double negligible = 0.1;  // standard deviations
    const Vector6d off = (present.measurement.inverse() * next.mean).log();
    return whitened<6, 1>(present.sqrt_information, off).squaredNorm() > negligible * negligible;
  }

  GnssFactorOptions options_;
  std::vector<Index> waiting_;             ///< keyframes whose fixes are to be added
  detail::Table<Index> priors_;            ///< of each keyframe its fix's number among the candidates, -1 if none
  detail::Table<Earth> on_earth_;          ///< of each session that defines a frame
  detail::Table<Eigen::Vector3d> biases_;  ///< of each session's fixes, in its frame, metres
};

}  // namespace chainslam
