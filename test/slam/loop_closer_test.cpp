#include "chainslam/slam/loop_closer.hpp"

#include <doctest/doctest.h>

#include <Eigen/LU>
#include <limits>
#include <memory>
#include <span>
#include <vector>

#include "slam/street.hpp"
#include "support/numbers.hpp"

namespace chainslam {
namespace {

using test::degree;
using test::nan;
using test::rotation_error;
using test::Street;
using test::translation_error;
using test::way_round;

/// The first corner of the block, seen once along the way and, a minute later, from beside it: the true pose of that
/// last scan differs from every other one in all six directions, and the graph has it wrong by 0.5 m and 2 degrees.
struct Corner {
  Street street;
  std::vector<Keyframe> keyframes;
  SE3d truth;  ///< of the last keyframe

  Corner() {
    std::vector<SE3d> poses = way_round();
    poses.resize(16);
    truth = poses[8] * SE3d(SO3d::exp({0.02, -0.03, 0.5}), {1.2, -0.8, 0.1});
    poses.push_back(truth);
    keyframes = test::keyframes_at(poses);
    for (std::size_t i = 0; i < keyframes.size(); ++i) keyframes[i].cloud = street.scan(poses[i], Rng(100 + i));
    Vector6d error;
    error << Eigen::Vector3d(0.3, -0.4, 0), 2 * degree * Eigen::Vector3d(0.1, 0.1, 0.99);
    keyframes.back().T_map_body = truth.retract(error);
    keyframes.back().time = keyframes.back().time + seconds(60);
  }

  [[nodiscard]] KeyframeId query() const { return keyframes.back().id; }

  /// What the graph believes: the pose of the query seen from keyframe 8.
  [[nodiscard]] SE3d guess() const { return keyframes[8].T_map_body.inverse() * keyframes.back().T_map_body; }

  [[nodiscard]] LoopClosure align(const ClosureGate& gate) const {
    LoopCloser<> closer({.gate = gate, .submap = test::small_submaps.submap});
    return closer.align(keyframes, KeyframeId{8}, query(), guess());
  }
};

/// Proposes nothing, and remembers for which keyframes it was asked.
struct AskedCandidates {
  std::shared_ptr<std::vector<Index>> asked = std::make_shared<std::vector<Index>>();

  [[nodiscard]] std::vector<KeyframeId> find(std::span<const Keyframe>, const PositionIndex&, KeyframeId query) const {
    asked->push_back(query.value);
    return {};
  }
  [[nodiscard]] bool eligible(const Keyframe&, const Keyframe&) const { return true; }
};

/// For which of `keyframes`, added one by one, candidates are looked for.
std::vector<Index> searches(const std::vector<Keyframe>& keyframes, const LoopCloserOptions& options,
                            std::vector<double>* spacing = nullptr) {
  const AskedCandidates candidates;
  LoopCloser<AskedCandidates> closer(options, candidates);
  const PositionIndex index;
  for (std::size_t i = 1; i <= keyframes.size(); ++i) CHECK(closer.close(std::span(keyframes).first(i), index).empty());
  if (spacing != nullptr) *spacing = closer.search_spacing();
  return *candidates.asked;
}
std::vector<Index> searches(const std::vector<Keyframe>& keyframes, double min_travel) {
  return searches(keyframes, {.min_travel = min_travel});
}

/// Remembers how many points it was given to align.
struct CountingRegistration {
  std::shared_ptr<std::vector<std::size_t>> sizes = std::make_shared<std::vector<std::size_t>>();

  template <Cloud Source, NearestNeighborSearch Target, Executor Exec = Serial>
  [[nodiscard]] AlignResult align(const Source& source, const Target&, const SE3d&, const Exec& = {}) const {
    sizes->push_back(cloud_size(source));
    return {};
  }
};

}  // namespace

TEST_SUITE("slam/loop_closer") {
  TEST_CASE("aligning scan i to the submap of j measures T_j_i, the pose of i seen from j") {
    const Corner corner;
    LoopCloser<> closer(test::small_submaps, {.min_keyframes = 0});
    PositionIndex index;
    index.rebuild(corner.keyframes);
    const std::vector<LoopClosure> tried = closer.close(corner.keyframes, index);
    REQUIRE(tried.size() == 1);
    const LoopClosure& closure = tried.front();
    CHECK(closure.verdict == ClosureVerdict::accepted);
    CHECK(closure.to == corner.query());
    const SE3d T_j_i =
        corner.keyframes[static_cast<std::size_t>(closure.from.value)].T_map_body.inverse() * corner.truth;
    // Points lie a metre apart, with a centimetre of noise; the graph was off by 0.5 m and 2 degrees.
    CHECK(translation_error(T_j_i, closure.T_from_to) < 0.05);
    CHECK(rotation_error(T_j_i, closure.T_from_to) < 0.2 * degree);
    CHECK(translation_error(T_j_i.inverse(), closure.T_from_to) > 1);
    CHECK(closure.inlier_ratio > 0.9);
    const Matrix6d covariance = (closure.sqrt_information.transpose() * closure.sqrt_information).inverse();
    CHECK(covariance.diagonal().head<3>().maxCoeff() < 0.1 * 0.1);
    CHECK(covariance.diagonal().minCoeff() > 0);
  }

  TEST_CASE("submaps whose memory was freed are made again, bit-identically") {
    const Corner corner;
    LoopCloser<> closer(test::small_submaps, {.min_keyframes = 0});
    const auto align = [&] {
      return closer.align(corner.keyframes, KeyframeId{8}, corner.query(), corner.guess()).T_from_to;
    };
    const SE3d before = align();
    CHECK(closer.submaps().bytes() > 0);
    closer.free_submaps();
    CHECK(closer.submaps().bytes() == 0);
    CHECK(align().matrix() == before.matrix());
    CHECK(closer.submaps().bytes() > 0);
  }

  TEST_CASE("a scan of another place has too few partners, and the closer goes on to the next candidate") {
    Corner corner;
    auto elsewhere = std::make_shared<PointCloud<float>>(*corner.keyframes.back().cloud.load());
    for (Eigen::Vector3f& p : elsewhere->positions) p.z() += 40;
    corner.keyframes.back().cloud = elsewhere;
    LoopCloser<> closer(test::small_submaps, {.min_separation = 4, .max_count = 2, .min_keyframes = 0});
    PositionIndex index;
    index.rebuild(corner.keyframes);
    const std::vector<LoopClosure> tried = closer.close(corner.keyframes, index);
    REQUIRE(tried.size() == 2);
    for (const LoopClosure& closure : tried) CHECK(closure.verdict == ClosureVerdict::too_few_inliers);
    CHECK(tried[0].from != tried[1].from);
  }

  TEST_CASE("a fit that is not good enough, and one too far from the graph, are refused by name") {
    const Corner corner;
    CHECK(corner.align({}).verdict == ClosureVerdict::accepted);
    CHECK(corner.align({.max_misfit = 0.05}).verdict == ClosureVerdict::high_residual);
    CHECK(corner.align({.max_mean_squared_error = 0.001}).verdict == ClosureVerdict::high_residual);
    CHECK(corner.align({.max_translation = 0.3}).verdict == ClosureVerdict::implausible);
    CHECK(corner.align({.max_rotation = 1 * degree}).verdict == ClosureVerdict::implausible);
    CHECK(corner.align({.min_inlier_ratio = 1.01}).verdict == ClosureVerdict::too_few_inliers);
  }

  TEST_CASE("between two walls without ends a scan stays where it starts: refused, unless that is not looked at") {
    Street street;
    street.facades = {{{-40, -3, 0}, {120, 0, 0}, {0, 6, 0}},
                      {{-40, -3, 0}, {120, 0, 0}, {0, 0, 5}},
                      {{-40, 3, 0}, {120, 0, 0}, {0, 0, 5}}};
    std::vector<SE3d> poses;
    for (int i = 0; i < 12; ++i) poses.push_back(test::shift(2.0 * i, 0, 1.8));
    poses.push_back(test::shift(10.5, 0.3, 1.8));
    std::vector<Keyframe> keyframes = test::keyframes_at(poses);
    for (std::size_t i = 0; i < keyframes.size(); ++i) keyframes[i].cloud = street.scan(poses[i], Rng(200 + i), 30000);
    const auto verdict = [&](const ClosureGate& gate) {
      LoopCloser<> closer({.gate = gate, .submap = test::small_submaps.submap});
      return closer.align(keyframes, KeyframeId{5}, keyframes.back().id, test::shift(2.5, 0, 0)).verdict;
    };
    constexpr double any = 100;  // misfits are not what is tested
    CHECK(verdict({.max_misfit = any}) == ClosureVerdict::not_converged);
    CHECK(verdict({.max_misfit = any, .sure_misfit = any}) == ClosureVerdict::not_converged);
    CHECK(verdict({.max_misfit = any, .sure_misfit = any, .repeat_below = 0}) == ClosureVerdict::accepted);
    CHECK(verdict({.max_misfit = any, .repeat_distance = 1.5}) == ClosureVerdict::accepted);
    CHECK(verdict({.max_misfit = 0}) == ClosureVerdict::accepted);
  }

  TEST_CASE(
      "a scan of which half lies off the submap is refused, and one of which a tenth does, such as traffic, not") {
    Corner corner;
    const auto original = corner.keyframes.back().cloud.load();
    const auto verdict = [&](std::size_t every, const ClosureGate& gate) {
      auto changed = std::make_shared<PointCloud<float>>(*original);
      Rng rng(7);
      for (std::size_t i = 0; i < changed->size(); i += every)
        for (int axis = 0; axis < 3; ++axis) changed->positions[i][axis] += static_cast<float>(rng.uniform(-0.8, 0.8));
      corner.keyframes.back().cloud = changed;
      return corner.align(gate).verdict;
    };
    CHECK(verdict(10, {}) == ClosureVerdict::accepted);
    CHECK(verdict(2, {}) == ClosureVerdict::high_residual);
    CHECK(verdict(2, {.max_misfit = 6}) == ClosureVerdict::accepted);
  }

  TEST_CASE("what fits worse than usual errs more: its standard deviations grow with its misfit, all of them") {
    const Corner corner;
    const auto deviations = [&](double usual) {
      LoopCloser<> closer({.usual_misfit = usual, .submap = test::small_submaps.submap});
      return closer.align(corner.keyframes, KeyframeId{8}, corner.query(), corner.guess()).sqrt_information;
    };
    const Matrix6d told = deviations(0), grown = deviations(0.05), more = deviations(0.025);
    CHECK(grown(0, 0) < 0.8 * told(0, 0));
    CHECK((2 * more - grown).norm() < 1e-9 * grown.norm());
    CHECK((grown * (told(0, 0) / grown(0, 0)) - told).norm() < 1e-9 * told.norm());
    CHECK((deviations(100) - told).norm() == 0);
  }

  TEST_CASE("the gate tells what the registration reported, and takes nothing that is not a number") {
    const ClosureGate gate{.max_mean_squared_error = 0.3};
    AlignResult good;
    good.status = AlignStatus::converged;
    good.inlier_ratio = 0.9;
    good.mean_squared_error = 0.1;
    good.mean_squared_residual = 0.01;
    const auto verdict = [&](auto&& change) {
      AlignResult result = good;
      change(result);
      return gate.judge(result, SE3d());
    };
    CHECK(verdict([](AlignResult&) {}) == ClosureVerdict::accepted);
    CHECK(verdict([](AlignResult& r) { r.status = AlignStatus::degenerate; }) == ClosureVerdict::accepted);
    CHECK(verdict([](AlignResult& r) { r.status = AlignStatus::iteration_limit; }) == ClosureVerdict::not_converged);
    CHECK(verdict([](AlignResult& r) { r.status = AlignStatus::no_overlap; }) == ClosureVerdict::too_few_inliers);
    CHECK(verdict([](AlignResult& r) { r.status = AlignStatus::too_few_points; }) == ClosureVerdict::too_few_inliers);
    CHECK(verdict([](AlignResult& r) { r.inlier_ratio = nan; }) == ClosureVerdict::too_few_inliers);
    CHECK(verdict([](AlignResult& r) { r.mean_squared_error = nan; }) == ClosureVerdict::high_residual);
    CHECK(verdict([](AlignResult& r) { r.mean_squared_error = 0.31; }) == ClosureVerdict::high_residual);
    CHECK(verdict([](AlignResult& r) { r.T_target_source = test::shift(nan, 0, 0); }) == ClosureVerdict::implausible);
    AlignResult unfinished = good;
    unfinished.status = AlignStatus::iteration_limit;
    CHECK(ClosureGate{.accept_iteration_limit = true}.judge(unfinished, SE3d()) == ClosureVerdict::accepted);
    unfinished.status = AlignStatus::no_overlap;
    CHECK(ClosureGate{.accept_iteration_limit = true}.judge(unfinished, SE3d()) == ClosureVerdict::too_few_inliers);
  }

  TEST_CASE("a scan is aligned as the keyframe has it, or thinned, each scan by itself") {
    const Corner corner;
    const CountingRegistration counting;
    LoopCloser<ProximityCandidates, CountingRegistration> whole(test::small_submaps, {}, counting);
    (void)whole.align(corner.keyframes, KeyframeId{8}, corner.query(), corner.guess());
    LoopCloserOptions options = test::small_submaps;
    options.scan_voxel = 2.0;
    LoopCloser<ProximityCandidates, CountingRegistration> thinned(options, {}, counting);
    for (const KeyframeId scan : {corner.query(), corner.query(), KeyframeId{3}})
      (void)thinned.align(corner.keyframes, KeyframeId{8}, scan, corner.guess());
    const auto size = [&](Index i, double voxel) {
      const auto scan_of_keyframe = corner.keyframes[static_cast<std::size_t>(i)].cloud.load();
      const PointCloud<float>& scan = *scan_of_keyframe;
      return voxel > 0 ? voxel_downsample(scan, voxel).size() : scan.size();
    };
    const Index last = corner.query().value;
    CHECK(*counting.sizes == std::vector{size(last, 0), size(last, 2), size(last, 2), size(3, 2)});
    CHECK(size(last, 2) < size(last, 0));
  }

  TEST_CASE("searches can be a period of time apart, and the way between them is on record") {
    std::vector<SE3d> poses;
    for (int i = 0; i < 10; ++i) poses.push_back(test::shift(0.5 * i * i, 0, 0));  // ever faster; a second apart
    std::vector<Keyframe> keyframes = test::keyframes_at(poses);
    std::vector<double> spacing;
    CHECK(searches(keyframes, {.min_travel = 0, .min_period = 2.5}, &spacing) == std::vector<Index>{0, 3, 6, 9});
    CHECK(spacing == std::vector{4.5, 13.5, 22.5});
    for (std::size_t i = 5; i < keyframes.size(); ++i) keyframes[i].session = SessionId{1};  // another clock
    keyframes[5].time = keyframes[0].time;
    CHECK(searches(keyframes, {.min_travel = 0, .min_period = 2.5}, &spacing) == std::vector<Index>{0, 3, 5, 6, 9});
    CHECK(spacing.size() == 3);  // none from one session to the next
  }

  TEST_CASE("candidates are looked for once in the least travel, counted along the path") {
    std::vector<SE3d> poses;
    for (int i = 0; i < 10; ++i) poses.push_back(test::shift(i % 2, 0, 0));  // to and fro: a metre of path each
    const std::vector<Keyframe> keyframes = test::keyframes_at(poses);
    CHECK(searches(keyframes, 4) == std::vector<Index>{0, 4, 8});
    CHECK(searches(keyframes, 0) == std::vector<Index>{0, 1, 2, 3, 4, 5, 6, 7, 8, 9});
  }

  TEST_CASE("the leap from one session to the next is no travel") {
    std::vector<Keyframe> keyframes =
        test::keyframes_at({test::shift(0, 0, 0), test::shift(1, 0, 0), test::shift(99, 0, 0)});
    CHECK(searches(keyframes, 4) == std::vector<Index>{0, 2});
    keyframes[2].session = SessionId{1};
    CHECK(searches(keyframes, 4) == std::vector<Index>{0});
  }
}

}  // namespace chainslam
