#pragma once

#include <algorithm>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/compiled.hpp"
#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/factor_graph/incremental_smoother.hpp"
#include "chainslam/map/append_map.hpp"
#include "chainslam/map/slam_map.hpp"
#include "chainslam/slam/frame_parting.hpp"
#include "chainslam/slam/group_gnc.hpp"
#include "chainslam/slam/kernel_factors.hpp"
#include "chainslam/slam/map_graph_options.hpp"
#include "chainslam/slam/odometry_doubt.hpp"
#include "chainslam/slam/odometry_noise.hpp"

namespace chainslam {

/// A map and its pose graph: a variable for each keyframe, a prior for each frame, factors for odometry and closures.
///
/// Sessions start in frames of their own. `join` carries one frame over into another. What changes the map is called by
/// one thread; `snapshot` may be called by any.
/// What is done once a session, a merge or a load is compiled for size (`gnu::cold`).
/// @tparam Outliers  what becomes of measurements that the rest of the graph contradicts: `GroupGnc`, or a robust
/// kernel of closures, in standard deviations.
template <class Outliers = GroupGnc>
class MapGraph {
  static constexpr bool decides = std::is_same_v<Outliers, GroupGnc>;
  static_assert(decides || RobustCost<Outliers>,
                "BackEnd: Outliers is GroupGnc, or a kernel with `double weight(double squared_residual) const` and "
                "`double cost(double squared_residual) const`, as in Cauchy");
  using Factors = typename std::conditional_t<decides, std::type_identity<GroupGncFactors>,
                                              std::type_identity<KernelFactors<Outliers>>>::type;

 public:
  using ClosureFactor = typename Factors::ClosureFactor;  ///< the factor of a closure
  using Smoother = typename Factors::Smoother;            ///< the smoother behind

  /// An empty map.
  [[gnu::cold]] explicit MapGraph(const MapGraphOptions& options = {}, Outliers outliers = {})
      : options_(options), outliers_(std::move(outliers)), factors_(std::in_place, options, outliers_) {}

  /// For the thread that changes the map.
  [[nodiscard]] const SlamMap& map() const { return map_; }
  /// The map as it is, whole: copied where it has changed since the last call, at the cost of the thread that asks.
  [[nodiscard]] [[gnu::cold]] std::shared_ptr<const SlamMap> snapshot() const;
  /// The map, given away: this has none any more.
  [[nodiscard]] [[gnu::cold]] std::shared_ptr<const SlamMap> release() {
    const Change change(*this);
    return std::make_shared<const SlamMap>(std::move(map_));
  }
  /// The variables are the keyframes, by number.
  [[nodiscard]] const Smoother& smoother() const { return factors_->smoother(); }
  /// The session whose start defines the frame of a keyframe's T_map_body.
  [[nodiscard]] SessionId frame(const Keyframe& keyframe) const { return session(keyframe.session).frame; }

  /// Keyframes appended from now on are of a new session, in a frame of its own.
  [[gnu::cold]] void begin_session(std::string name);

  /// Adds the session's next keyframe, where odometry puts it.
  /// @throws std::invalid_argument if its time is not later than the session's last, or T_odom_body is not finite; the
  /// map is then as it was.
  KeyframeId append(Keyframe keyframe);

  /// Adds the newest session's next frames, with their health. Those up to a keyframe come before it: what they say of
  /// odometry since the last keyframe is in the measurement between the two.
  /// @throws std::invalid_argument if times do not increase or something is not finite; the map is then as it was.
  [[gnu::cold]] void append(std::span<const FrameRecord> frames);

  /// Gives a keyframe a fix, now or `with_previous`: together with that of the keyframe before.
  void set_gnss(KeyframeId id, const GnssFix& fix, bool with_previous = false);
  /// Fixes that the next optimisation will take in.
  [[nodiscard]] Index waiting_fixes() const { return factors_->waiting(); }

  /// @returns the closure's position among the map's closures.
  [[gnu::cold]] Index accept(const LoopClosure& closure);
  [[gnu::cold]] void refuse(const LoopClosure& closure);  ///< notes a closure that was refused

  /// Carries all sessions of the frame `joined` over into `frame`, as one body: what lies between their keyframes stays
  /// as it is linearised. They keep priors at the aligned poses, or none.
  [[gnu::cold]] void join(SessionId frame, SessionId joined, const SE3d& T_frame_joined);

  /// Joins the frames of a closure's keyframes where it puts them, the later one to the earlier. One frame stays as it
  /// is.
  [[gnu::cold]] void join(const LoopClosure& closure);

  /// Takes closures back, by their positions, with all that they led to, and parts frames that no accepted closure
  /// holds together any more: what leaves a frame goes back to where odometry has it. Poses are to be optimised then.
  /// @returns whether anything changed.
  [[gnu::cold]] bool part(std::span<const Index> withdrawn = {});

  /// Adds another map: its sessions follow those that are here, in frames of their own, and everything in it keeps the
  /// measurements it had. If the map is empty, all numbers stay the same.
  [[gnu::cold]] void load(const SlamMap& other);

  /// Takes in what was added, and moves the keyframes to the optimum, as near as the smoother's tolerances say. If that
  /// fails they stay, and what was added waits for the next time.
  [[gnu::cold]] UpdateReport optimise();
  /// Whether the last one left something to the next (`MapGraphOptions::largest_work`).
  [[nodiscard]] bool is_unfinished() const { return unfinished_; }

  /// The same, to the end.
  [[gnu::cold]] ConvergeReport converge();

 private:
  /// While it lives, the map changes, and nobody else reads it.
  class Change {
   public:
    explicit Change(MapGraph& graph) : lock_(graph.changing_) { graph.snapshot_.reset(); }

   private:
    std::scoped_lock<std::mutex> lock_;
  };

  [[nodiscard]] Keyframe& keyframe(Index i) { return map_.keyframes[static_cast<std::size_t>(i)]; }
  [[nodiscard]] const Session& session(SessionId id) const { return map_.sessions[static_cast<std::size_t>(id.value)]; }
  [[nodiscard]] [[gnu::cold]] NoiseModel<6> odometry_noise(const Keyframe& last, const Keyframe& next) const;
  [[gnu::cold]] void remeasure();

  void take(std::span<const Key> keys) {
    for (const Key key : keys) keyframe(key).T_map_body = smoother()[key];
  }

  /// What nothing holds, with closures that wait for a forecast taken in: without them there may be nothing to foresee.
  [[nodiscard]] [[gnu::cold]] std::vector<Key> floating() {
    std::vector<Key> keys = factors_->smoother().floating();
    return keys.empty() || !factors_->admit() ? keys : factors_->smoother().floating();
  }

  /// Takes in what is known of gravity. A frame that it holds may lean from where odometry began it.
  [[gnu::cold]] void hold_upright();
  [[gnu::cold]] void rebuild();
  /// Adds all of the map from these positions on.
  [[gnu::cold]] void add_to_smoother(Index sessions, Index keyframes, Index odometry, Index closures);

  [[gnu::cold]] void add_prior(const Session& session);
  MapGraphOptions options_;
  [[no_unique_address]] Outliers outliers_;
  SlamMap map_;
  std::optional<Factors> factors_;  ///< never empty; optional so that `rebuild` can replace them in place
  detail::Table<FactorId> priors_;  ///< of each session
  bool unfinished_ = false;
  mutable std::mutex changing_;
  mutable std::shared_ptr<const SlamMap> snapshot_;  ///< null where the map has changed since
};

}  // namespace chainslam

#include "chainslam/slam/detail/map_graph_steps.hpp"

namespace chainslam {

#ifdef CHAINSLAM_COMPILED
extern template class IncrementalGnc<IncrementalSmoother<SE3d>>;
extern template class MapGraph<>;
#endif

}  // namespace chainslam
