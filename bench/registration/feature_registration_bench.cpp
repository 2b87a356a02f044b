#include "chainslam/registration/feature_registration.hpp"

#include <benchmark/benchmark.h>

#include <array>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "clouds.hpp"
#include "registration/crops.hpp"
#include "registration/global_methods.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

using bench::CropPair;

struct NamedCrop {
  std::string name;
  CropPair pair;
};

/// Crops of KITTI with 90, 50 and 30 % overlap, the first that are not
/// ambiguous (see `CropSource`); and two scans of the made city, 3 m apart and
/// turned, each in its sensor's frame.
const std::vector<NamedCrop>& crops() {
  static const std::vector<NamedCrop> made = [] {
    std::vector<NamedCrop> all;
    if (const auto folder = bench::CropSource::find_data()) {
      bench::CropSource source(*folder);
      for (const int percent : {90, 50, 30}) {
        std::optional<CropPair> pair;
        for (std::uint64_t seed = 1; !pair; ++seed) pair = source.crop(percent / 100.0, seed);
        all.push_back({"kitti_crop" + std::to_string(percent), std::move(*pair)});
      }
    }
    const bench::City city;
    const SE3d T_city_source(SO3d::exp(Eigen::Vector3d(0.05, -0.02, 2.0)), bench::City::position(3));
    const SE3d T_city_target(SO3d(), bench::City::position(0));
    const auto seen = [](PointCloud<float> scan, const SE3d& T_city_sensor) {
      for (Eigen::Vector3f& p : scan.positions) p = (T_city_sensor.inverse() * p.cast<double>().eval()).cast<float>();
      return scan;
    };
    CropPair pair{seen(city.scan(3), T_city_source), seen(city.scan(0), T_city_target),
                  T_city_target.inverse() * T_city_source, 0};
    all.push_back({"city", std::move(pair)});
    return all;
  }();
  return made;
}

void report(benchmark::State& state, const CropPair& pair, const SE3d& T_target_source) {
  const SE3d off = pair.T_target_source.inverse() * T_target_source;
  state.counters["error_m"] = off.translation().norm();
  state.counters["error_deg"] = off.rotation().log().norm() * 180 / std::numbers::pi;
}

/// Two crops, thinned and described, and what matches.
struct Matched {
  DescribedCloud source, target;
  std::vector<FeatureMatch> matches;

  explicit Matched(const CropPair& pair)
      : source(bench::feature_registration<Ransac>().describe(pair.source)),
        target(bench::feature_registration<Ransac>().describe(pair.target)),
        matches(match_features(source.features, target.features)) {}
};

#if defined(CHAINSLAM_PEER_OPEN3D) || defined(CHAINSLAM_PEER_TEASER)
bench::IndexPairs index_pairs(const std::vector<FeatureMatch>& matches) {
  bench::IndexPairs pairs;
  for (const FeatureMatch& match : matches) pairs.emplace_back(match.source, match.target);
  return pairs;
}
#endif

/// From matches to a pose: the same points and matches for all.
void ransac(benchmark::State& state, const CropPair& pair) {
  const Matched matched(pair);
  const Ransac ours{.max_distance = bench::global_distance};
  GlobalAlignResult result;
  const auto by_us = [&] {
    result = ours.align(matched.source.cloud.cloud(), matched.target.cloud, matched.matches);
    return result.consensus;
  };
#ifdef CHAINSLAM_PEER_OPEN3D
  const bench::Open3dCloud source(matched.source.cloud.cloud().positions);
  const bench::Open3dCloud target(matched.target.cloud.cloud().positions);
  const bench::IndexPairs pairs = index_pairs(matched.matches);
  bench::versus(state, "open3d", by_us,
                [&] { return bench::open3d_ransac(source, target, pairs, bench::global_distance).inliers; });
#else
  bench::versus(state, by_us);
#endif
  report(state, pair, result.T_target_source);
  state.counters["matches"] = result.matches;
  state.counters["iterations"] = result.iterations;
}

void graph(benchmark::State& state, const CropPair& pair) {
  const Matched matched(pair);
  const GraphConsensus<> ours{.max_distance = bench::global_distance};
  GlobalAlignResult result;
  const auto by_us = [&] {
    result = ours.align(matched.source.cloud.cloud(), matched.target.cloud, matched.matches);
    return result.consensus;
  };
#ifdef CHAINSLAM_PEER_TEASER
  const bench::IndexPairs pairs = index_pairs(matched.matches);
  const bench::Positions &source = matched.source.cloud.cloud().positions,
                         &target = matched.target.cloud.cloud().positions;
  bench::versus(state, "teaser", by_us,
                [&] { return bench::teaser_align(source, target, pairs, bench::global_voxel).inliers; });
#else
  bench::versus(state, by_us);
#endif
  report(state, pair, result.T_target_source);
  state.counters["matches"] = result.matches;
}

/// Everything from the raw crops on: thinning, normals, features, matches,
/// pose, refinement, verification.
void global(benchmark::State& state, const CropPair& pair) {
  const VerifiedRegistration<> ours = bench::verified_registration();
  GlobalAlignResult result;
  const auto by_us = [&] {
    result = ours.align(pair.source, pair.target);
    return result.consensus;
  };
#ifdef CHAINSLAM_PEER_KISS_MATCHER
  bench::versus(state, "kiss_matcher", by_us, [&] {
    return bench::kiss_matcher_align(pair.source.positions, pair.target.positions, bench::global_voxel).inliers;
  });
#else
  bench::versus(state, by_us);
#endif
  report(state, pair, result.T_target_source);
  state.counters["fitness_source"] = result.fitness_source;
}

/// Runs chunks one after the other and adds up the time of loops that have several: what threads could share.
class SharedTime {
 public:
  template <class Body>
  void for_chunks(Index count, Index grain, Body&& body) const {
    const bool counts = !inside_ && count > grain;
    const double start = bench::ThreadTime::now();
    if (counts) inside_ = true;
    Serial{}.for_chunks(count, grain, body);
    if (!counts) return;
    inside_ = false;
    seconds_ += bench::ThreadTime::now() - start;
  }
  [[nodiscard]] double seconds() const { return seconds_; }

 private:
  mutable bool inside_ = false;
  mutable double seconds_ = 0;
};

/// What more threads cost: process time beside the time on the wall; and what share of the work only one can do.
void global_threads(benchmark::State& state, const CropPair& pair) {
  const VerifiedRegistration<> ours = bench::verified_registration();
  const ThreadPool pool(static_cast<Index>(state.range(0)));
  for (auto _ : state) benchmark::DoNotOptimize(ours.align(pair.source, pair.target, pool));
  const SharedTime shared;
  const double start = bench::ThreadTime::now();
  const GlobalAlignResult alone = ours.align(pair.source, pair.target, shared);
  state.counters["serial_share"] = 1 - shared.seconds() / (bench::ThreadTime::now() - start);
  if (!(alone.T_target_source.matrix() == ours.align(pair.source, pair.target, pool).T_target_source.matrix()))
    state.SkipWithError("threads change the pose");
}

[[maybe_unused]] const bool global_registered = [] {
  for (const NamedCrop& crop : crops()) {
    const CropPair& pair = crop.pair;
    const auto add = [&](const char* name, void (*run)(benchmark::State&, const CropPair&)) {
      return benchmark::RegisterBenchmark(("registration/" + std::string(name) + "/" + crop.name).c_str(),
                                          [&pair, run](benchmark::State& state) { run(state, pair); })
          ->Unit(benchmark::kMillisecond);
    };
    add("ransac", ransac)->UseManualTime();
    add("graph", graph)->UseManualTime();
    add("global", global)->UseManualTime();
    add("global_threads", global_threads)->ArgName("threads")->Arg(1)->Arg(2)->MeasureProcessCPUTime()->UseRealTime();
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
