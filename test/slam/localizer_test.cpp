#include "chainslam/slam/localizer.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "slam/courtyard.hpp"
#include "slam/street.hpp"

namespace chainslam {
namespace {

struct WithoutGuess {
  void remember(std::span<const Keyframe>, Index, auto&&, const Serial&) {}
  std::vector<KeyframeId> recognize(std::span<const Keyframe>, KeyframeId) { return {}; }
};
static_assert(!PlaceRecognition<WithoutGuess>);

/// Lists which keyframes of the map may be compared with its first.
struct ComparedPlaces : WithoutGuess {
  std::vector<bool>* comparable_with_first = nullptr;
  template <class Comparable>
  void remember(std::span<const Keyframe> keyframes, Index end, const Comparable& comparable, const Serial&) {
    for (const Keyframe& one : keyframes.first(static_cast<std::size_t>(end)))
      comparable_with_first->push_back(comparable(keyframes[0].id, one.id));
  }
  std::optional<SE3d> guess(KeyframeId, KeyframeId) { return std::nullopt; }
};
static_assert(MapRegistration<LoopCloser<>>);
static_assert(!MapRegistration<ProximityCandidates>);

/// A block that is driven round twice: once for the map, whose poses are true, once on the other lane.
struct StreetDrives {
  test::Street street{3};
  std::vector<SE3d> truth;  ///< of the second drive
  SE3d T_odom_map{SO3d::exp({0, 0, 2}), {300, -70, 4}};

  StreetDrives() {
    for (const SE3d& pose : test::way_round(1.0, 0)) truth.push_back(pose * SE3d(SO3d(), {0.3, 0.8, 0.1}));
  }
  [[nodiscard]] SlamMap map() const {
    SlamMap map;
    const Rng rng(1);
    for (const SE3d& pose : test::way_round(2.0, 20)) {
      const KeyframeId id{to_index(map.keyframes.size())};
      map.keyframes.push_back(
          {id, SessionId{0}, Timestamp::from_seconds(id.value), pose, pose, scan(pose, rng, id.value), {}});
    }
    map.sessions.push_back({SessionId{0}, "round", 0, to_index(map.keyframes.size()), SessionId{0}, {}, {}});
    return map;
  }
  /// Odometry of the second drive, which starts anywhere and drifts by 1 cm and 0.2 mrad a metre.
  [[nodiscard]] std::vector<Frame> drive(std::size_t begin, std::size_t end) const {
    std::vector<Frame> frames;
    const Rng rng(2);
    SE3d T_odom_body = T_odom_map * truth[begin];
    for (std::size_t i = begin; i < end; ++i) {
      if (i > begin)
        T_odom_body = T_odom_body * truth[i - 1].inverse() * truth[i] * SE3d(SO3d::exp({0, 0, 2e-4}), {0.01, 0, 0});
      Frame frame;
      frame.time = Timestamp::from_seconds(1000.0 + static_cast<double>(i));
      frame.T_odom_body = T_odom_body;
      frame.covariance = 1e-4 * Matrix6d::Identity();
      frame.cloud = *scan(truth[i], rng, to_index(i));
      frames.push_back(std::move(frame));
    }
    return frames;
  }

 private:
  [[nodiscard]] std::shared_ptr<const PointCloud<float>> scan(const SE3d& pose, const Rng& rng, Index number) const {
    return street.scan(pose, rng.fork(static_cast<std::uint64_t>(number)), 20000);
  }
};

double off(const Localization& now, const SE3d& truth) {
  return (now.T_map_body->translation() - truth.translation()).norm();
}

/// A scan of a day on which much is in front of what the map has: every sixth point is 0.3 to 0.9 m nearer.
PointCloud<float> overgrown(PointCloud<float> cloud, Rng rng) {
  for (std::size_t i = 0; i < cloud.size(); i += 6) {
    Eigen::Vector3f& p = cloud.positions[i];
    p *= std::max(0.0F, 1 - static_cast<float>(rng.uniform(0.3, 0.9)) / p.norm());
  }
  return cloud;
}

/// Registers each scan to where it is by this map, or anywhere along a street that is the same everywhere.
struct SlidingCloser {
  ClosureVerdict verdict = ClosureVerdict::accepted;
  bool slides = false, fits_mostly = true;
  SE3d T_from_to;
  std::vector<SE3d> guesses{};

  LoopClosure align(std::span<const Keyframe>, KeyframeId from, KeyframeId to, const SE3d& guess, Serial = {}) {
    guesses.push_back(guess);
    LoopClosure closure{.from = from, .to = to, .T_from_to = slides ? guess : T_from_to, .verdict = verdict};
    closure.sqrt_information = SqrtInformation<6>(10.0 * Matrix6d::Identity());
    return closure;
  }
  [[nodiscard]] bool fits_in_part(std::span<const Keyframe>, const LoopClosure&) const { return fits_mostly; }
};

}  // namespace

TEST_SUITE("slam/pose_filter") {
  TEST_CASE("a measurement counts by its share of the information, and its distance by both covariances") {
    const detail::UncertainPose predicted{SE3d(SO3d(), {1, 2, 3}), 4 * Matrix6d::Identity()};
    const detail::UncertainPose measured{SE3d(SO3d(), {2, 2, 3}), Matrix6d::Identity()};
    const detail::CorrectedPose pose = detail::corrected(predicted, measured);
    CHECK(pose.pose.pose.translation().x() == doctest::Approx(1.8));
    CHECK(pose.pose.covariance.isApprox(0.8 * Matrix6d::Identity(), 1e-12));
    CHECK(pose.squared_distance == doctest::Approx(1.0 / 5));
    CHECK_THROWS_AS((void)detail::corrected({predicted.pose, Matrix6d::Zero()}, {measured.pose, Matrix6d::Zero()}),
                    std::invalid_argument);
  }

  TEST_CASE("an error of the heading becomes one of the position along the path, and odometry adds its own") {
    detail::UncertainPose from;
    from.covariance(5, 5) = 0.01 * 0.01;
    const detail::UncertainPose to = detail::moved(from, SE3d(SO3d(), {100, 0, 0}), 1e-4 * Matrix6d::Identity());
    CHECK(to.pose.translation().x() == 100);
    CHECK(to.covariance(1, 1) == doctest::Approx(1.0 + 1e-4));
    CHECK(to.covariance(0, 0) == doctest::Approx(1e-4));
    CHECK(detail::covariance_of(SqrtInformation<6>(0.5 * Matrix6d::Identity()))
              .isApprox(4 * Matrix6d::Identity(), 1e-12));
  }
}

TEST_SUITE("slam/start_hypotheses") {
  const detail::UncertainPose here{SE3d(SO3d(), {5, 0, 0}), Matrix6d::Identity()};
  SE3d along(double metres) { return SE3d(SO3d(), {metres, 0, 0}); }

  TEST_CASE("a start needs recognitions, scans and travel between them; a refusal takes as much as two scans give") {
    const StartOptions asked{.min_evidence = 6, .min_scans = 3, .min_travel = 5};
    detail::StartHypotheses hypotheses(asked);
    detail::StartHypothesis* one = hypotheses.recognized(SessionId{0}, KeyframeId{7}, here, along(0), 0);
    REQUIRE(one != nullptr);
    const auto at = [](double metres) { return detail::UncertainPose{SE3d(SO3d(), {5 + metres, 0, 0}), {}}; };
    hypotheses.tried(*one, KeyframeId{8}, at(3), along(3), 3);
    hypotheses.tried(*one, KeyframeId{8}, at(4), along(4), 4);
    CHECK(hypotheses.recognized(SessionId{0}, KeyframeId{8}, at(4), along(4), 4) == nullptr);
    CHECK(hypotheses.accepted() == nullptr);  // 4 m
    hypotheses.tried(*one, KeyframeId{9}, at(6.2), along(6), 6);
    REQUIRE(hypotheses.accepted() == one);
    CHECK(one->agreeing == 4);
    CHECK(one->recognitions == 2);
    CHECK(one->reference == KeyframeId{9});
    CHECK(one->evidence() == 6);
    hypotheses.tried(*one, KeyframeId{9}, at(12), along(10), 10);  // 2 m off: no agreement
    CHECK(one->refusing == 1);
    CHECK(hypotheses.accepted() == nullptr);
    hypotheses.tried(*one, KeyframeId{9}, at(10.2), along(10), 10);
    CHECK(hypotheses.accepted() == nullptr);
    hypotheses.tried(*one, KeyframeId{9}, at(10.2), along(10), 10);
    CHECK(hypotheses.accepted() == one);
  }

  TEST_CASE("a rival in the same frame forbids a start, one in another frame does not") {
    for (const SessionId frame : {SessionId{0}, SessionId{1}}) {
      detail::StartHypotheses hypotheses({.min_evidence = 1, .min_recognitions = 1, .min_scans = 1, .min_travel = 0});
      REQUIRE(hypotheses.recognized(SessionId{0}, KeyframeId{7}, here, along(0), 0) != nullptr);
      CHECK(hypotheses.accepted() != nullptr);
      const detail::UncertainPose there{SE3d(SO3d(), {50, 0, 0}), Matrix6d::Identity()};
      REQUIRE(hypotheses.recognized(frame, KeyframeId{9}, there, along(0), 0) != nullptr);
      CHECK((hypotheses.accepted() == nullptr) == (frame == SessionId{0}));
      hypotheses.tried(hypotheses.all().back(), {}, {}, along(1), 1);
      hypotheses.tried(hypotheses.all().back(), {}, {}, along(2), 2);
      hypotheses.prune();
      CHECK(hypotheses.all().size() == 1);
      CHECK(hypotheses.accepted() != nullptr);
    }
    // As many scans agree with a rival, but hardly any place of the map looks like it.
    detail::StartHypotheses hypotheses({.min_evidence = 1, .min_recognitions = 1, .min_scans = 1, .min_travel = 0});
    REQUIRE(hypotheses.recognized(SessionId{0}, KeyframeId{7}, here, along(0), 0) != nullptr);
    const detail::UncertainPose there{SE3d(SO3d(), {50, 0, 0}), Matrix6d::Identity()};
    REQUIRE(hypotheses.recognized(SessionId{0}, KeyframeId{9}, there, along(0), 0) != nullptr);
    CHECK(hypotheses.recognized(SessionId{0}, KeyframeId{7}, here, along(0), 0) == nullptr);
    CHECK(hypotheses.accepted() == nullptr);  // 3 to 2
    CHECK(hypotheses.recognized(SessionId{0}, KeyframeId{7}, here, along(0), 0) == nullptr);
    CHECK(hypotheses.accepted() == &hypotheses.all().front());  // 4 to 2
    CHECK_THROWS_AS(detail::StartHypotheses({.min_scans = 0}), std::invalid_argument);
    CHECK_THROWS_AS(detail::StartHypotheses({.shift = -1}), std::invalid_argument);
    CHECK_THROWS_AS(detail::StartHypotheses({.lead = 0.5}), std::invalid_argument);
  }
}

TEST_SUITE("slam/start_pose") {
  /// Two keyframes of the map, and two scans of a drive to the left.
  const std::vector<Keyframe> keyframes = [] {
    std::vector<Keyframe> some = test::keyframes_at({SE3d(), test::shift(5, 0, 0), SE3d(), test::shift(0, 3, 0)});
    some[2].session = some[3].session = SessionId{1};
    return some;
  }();
  const SE3d T_from_to = test::shift(1, 0, 0);

  std::optional<detail::UncertainPose> placed_by(SlidingCloser & closer, const StartOptions& options = {}) {
    const LoopClosure closure = closer.align(keyframes, KeyframeId{1}, KeyframeId{3}, T_from_to);
    closer.guesses.clear();
    return detail::start_pose(closer, keyframes, closure, detail::StartHypotheses(options), 0.5, Serial{});
  }

  TEST_CASE("a scan counts if it comes back to its place from either side along the path") {
    SlidingCloser closer{.T_from_to = T_from_to};
    const auto at = placed_by(closer);
    REQUIRE(at);
    CHECK(at->pose.translation() == Eigen::Vector3d(6, 0, 0));
    CHECK(at->covariance.isApprox(0.01 * Matrix6d::Identity(), 1e-12));
    REQUIRE(closer.guesses.size() == 2);
    for (const SE3d& guess : closer.guesses) CHECK(std::abs(guess.translation().y()) == doctest::Approx(2));
    closer.slides = true;
    CHECK(!placed_by(closer));
    CHECK(closer.guesses.size() == 1);
    CHECK(placed_by(closer, {.shift = 0}));
    CHECK(closer.guesses.empty());
  }

  TEST_CASE("a scan that lies badly on the map counts if it comes back, as well known as what agrees with it") {
    SlidingCloser closer{.verdict = ClosureVerdict::high_residual, .T_from_to = T_from_to};
    const auto at = placed_by(closer);
    REQUIRE(at);
    CHECK(at->pose.translation() == Eigen::Vector3d(6, 0, 0));
    CHECK(at->covariance(0, 0) == doctest::Approx(0.25 * 0.25));
    CHECK(at->covariance(4, 4) == doctest::Approx(0.025 * 0.025));
    CHECK(!placed_by(closer, {.shift = 0}));
    closer.fits_mostly = false;
    CHECK(!placed_by(closer));
    closer = {.verdict = ClosureVerdict::high_residual, .slides = true, .T_from_to = T_from_to};
    CHECK(!placed_by(closer));
    closer = {.verdict = ClosureVerdict::too_few_inliers, .T_from_to = T_from_to};
    CHECK(!placed_by(closer));
  }

  TEST_CASE("the path's direction is that to the scan before or after, forward if there is none of the drive") {
    CHECK(detail::direction_of_path(keyframes, KeyframeId{3}, 0.2) == Eigen::Vector3d(0, -1, 0));
    CHECK(detail::direction_of_path(keyframes, KeyframeId{2}, 0.2) == Eigen::Vector3d(0, 1, 0));
    CHECK(detail::direction_of_path(std::span(keyframes).first(3), KeyframeId{2}, 0.2) == Eigen::Vector3d(1, 0, 0));
    CHECK(detail::direction_of_path(keyframes, KeyframeId{3}, 5) == Eigen::Vector3d(1, 0, 0));
  }
}

TEST_SUITE("slam/localizer") {
  TEST_CASE("a drive is found within 20 m of path, wherever it starts, and followed within decimetres") {
    const StreetDrives drives;
    Localizer<> localizer(drives.map());
    for (const std::size_t start : {std::size_t{0}, std::size_t{37}, std::size_t{125}}) {
      CAPTURE(start);
      localizer.restart();
      std::size_t found = 0;
      double worst = 0;
      const std::vector<Frame> frames = drives.drive(start, std::min(start + 35, drives.truth.size()));
      for (std::size_t i = 0; i < frames.size(); ++i) {
        const Localization now = localizer.process(frames[i]);
        REQUIRE(now.T_map_body.has_value() == (now.status == LocalizationStatus::tracking));
        if (!now.T_map_body) continue;
        if (found == 0) found = i + 1;
        worst = std::max(worst, off(now, drives.truth[start + i]));
        CHECK(now.frame == SessionId{0});
        CHECK(std::sqrt(now.covariance(0, 0)) < 0.2);
      }
      MESSAGE("start ", start, ": found at scan ", found, ", worst ", worst, " m");
      CHECK(found > 0);
      CHECK(found <= 20);
      CHECK(worst < 0.25);
    }
    CHECK(localizer.counts().starts == 3);
    CHECK(localizer.counts().losses == 0);
  }

  TEST_CASE("places of the map are compared by their poses within a frame alone") {
    SlamMap map = StreetDrives().map();
    const Index first_of_second = to_index(map.keyframes.size()) - 5;
    map.sessions[0].keyframes = first_of_second;
    map.sessions.push_back({SessionId{1}, "elsewhere", first_of_second, 5, SessionId{1}, {}, {}});
    for (std::size_t i = 0; i < 5; ++i) map.keyframes[static_cast<std::size_t>(first_of_second) + i].session = {1};
    std::vector<bool> compared;
    ComparedPlaces places;
    places.comparable_with_first = &compared;
    const Localizer<LoopCloser<>, ComparedPlaces> localizer(map, {}, LoopCloser<>(), places);
    REQUIRE(compared.size() == map.keyframes.size());
    for (Index i = 0; i < to_index(compared.size()); ++i)
      CHECK(compared[static_cast<std::size_t>(i)] == (i < first_of_second));
  }

  TEST_CASE("a drive is found where much is in front of what the map has, repeated by the localizer or not") {
    const StreetDrives drives;
    for (const double shift : {StartOptions{}.shift, 0.0}) {
      Localizer<> localizer(drives.map(), {.start = {.shift = shift}});
      std::vector<Frame> frames = drives.drive(70, 90);
      bool found = false;
      for (std::size_t i = 0; i < frames.size() && !found; ++i) {
        frames[i].cloud = overgrown(frames[i].cloud, Rng(100 + i));
        const Localization now = localizer.process(frames[i]);
        found = now.T_map_body.has_value();
        if (found) CHECK(off(now, drives.truth[70 + i]) < 0.3);
      }
      CHECK(found);
    }
  }

  TEST_CASE("another block is not mistaken for the map") {
    StreetDrives elsewhere;
    const StreetDrives drives;
    elsewhere.street = test::Street(8);
    Localizer<> localizer(drives.map());
    for (const Frame& frame : elsewhere.drive(0, 40))
      CHECK(localizer.process(frame).status == LocalizationStatus::searching);
    CHECK(localizer.counts().searches >= 35);
    CHECK(localizer.counts().starts == 0);
  }

  TEST_CASE("odometry that jumps unnoticed makes the pose uncertain, and the place is found again") {
    const StreetDrives drives;
    LocalizerOptions options;
    options.max_distance = 5;
    options.lost_distance = 15;
    Localizer<> localizer(drives.map(), options);
    std::vector<Frame> frames = drives.drive(0, 100);
    const SE3d T_odom_before = frames[39].T_odom_body, slip(SO3d::exp({0, 0, 1}), {12, 0, 0});
    for (std::size_t i = 40; i < frames.size(); ++i)
      frames[i].T_odom_body = T_odom_before * slip * T_odom_before.inverse() * frames[i].T_odom_body;
    bool uncertain = false;
    Localization now;
    for (std::size_t i = 0; i < frames.size(); ++i) {
      now = localizer.process(frames[i]);
      uncertain |= now.status == LocalizationStatus::uncertain;
      if (i == 39) CHECK(now.status == LocalizationStatus::tracking);
      if (now.status == LocalizationStatus::tracking && i > 60) CHECK(off(now, drives.truth[i]) < 0.3);
    }
    CHECK(uncertain);
    CHECK(now.status == LocalizationStatus::tracking);
    CHECK(localizer.counts().starts == 2);
  }

  TEST_CASE("beyond the map the pose is odometry's, then uncertain, then lost; back in the map it is found again") {
    const StreetDrives drives;
    LocalizerOptions options;
    options.max_distance = 5;
    options.lost_distance = 10;
    Localizer<> localizer(drives.map(), options);
    std::vector<Frame> frames = drives.drive(0, 110);
    for (std::size_t i = 40; i < 60; ++i) frames[i].cloud = {};  // nothing is seen
    std::vector<LocalizationStatus> seen;
    for (const Frame& frame : frames) {
      const Localization now = localizer.process(frame);
      if (seen.empty() || seen.back() != now.status) seen.push_back(now.status);
      if (now.status == LocalizationStatus::lost) {
        CHECK(!now.T_map_body);
        CHECK(!now.frame.valid());
      }
    }
    using enum LocalizationStatus;
    CHECK(seen == std::vector{searching, tracking, uncertain, lost, tracking});
    CHECK(localizer.counts().losses == 1);
    CHECK(localizer.counts().starts == 2);
    CHECK(localizer.counts().tracked + localizer.counts().uncertain + localizer.counts().lost <= 110);
  }

  TEST_CASE("results do not depend on threads, and a frame that has no scan moves by odometry") {
    const StreetDrives drives;
    const ThreadPool threads(2);
    Localizer<> serial(drives.map());
    Localizer<> parallel(drives.map(), {}, LoopCloser<>(), PlaceCandidates(localizer_places()), threads);
    std::vector<Frame> frames = drives.drive(0, 30);
    frames[27].cloud = {};
    Localization before;
    for (const Frame& frame : frames) {
      const Localization a = serial.process(frame), b = parallel.process(frame, threads);
      REQUIRE(a.T_map_body.has_value() == b.T_map_body.has_value());
      if (a.T_map_body) CHECK(a.T_map_body->matrix() == b.T_map_body->matrix());
      CHECK(a.covariance == b.covariance);
      if (frame.cloud.empty()) {
        CHECK(!a.registered);
        const SE3d moved = frames[26].T_odom_body.inverse() * frame.T_odom_body;
        CHECK((*before.T_map_body * moved).matrix().isApprox(a.T_map_body->matrix(), 1e-9));
        CHECK(a.covariance(0, 0) > before.covariance(0, 0));
      }
      before = a;
    }
  }

  TEST_CASE("scans of a fast drive are registered no more often than asked for") {
    const StreetDrives drives;
    std::vector<Frame> frames = drives.drive(0, 60);
    for (std::size_t i = 0; i < frames.size(); ++i)
      frames[i].time = Timestamp::from_seconds(1000.0 + 0.1 * static_cast<double>(i));  // 10 m/s
    for (const double period : {LocalizerOptions{}.min_period, 0.0}) {
      Localizer<> localizer(drives.map(), {.min_period = period});
      std::vector<Timestamp> registered;
      Localization now;
      for (const Frame& frame : frames) {
        now = localizer.process(frame);
        if (now.registered) registered.push_back(now.time);
      }
      CHECK(now.status == LocalizationStatus::tracking);
      CHECK(off(now, drives.truth[59]) < 0.25);
      for (std::size_t i = 1; i < registered.size(); ++i)
        CHECK(to_seconds(registered[i] - registered[i - 1]) > period - 1e-6);
      CHECK(registered.size() >= (period > 0 ? 10 : 40));
      CHECK(registered.size() <= (period > 0 ? 20 : 60));
    }
    CHECK_THROWS_AS(Localizer<>(drives.map(), {.min_period = -1}), std::invalid_argument);
  }

  TEST_CASE("what cannot be used is refused") {
    const StreetDrives drives;
    SlamMap map = drives.map();
    CHECK_THROWS_AS(Localizer<>(SlamMap{}), std::invalid_argument);
    CHECK_THROWS_AS(Localizer<>(map, LocalizerOptions{.gate = 0}), std::invalid_argument);
    CHECK_THROWS_AS(Localizer<>(map, LocalizerOptions{.max_distance = 20, .lost_distance = 10}), std::invalid_argument);
    Localizer<> localizer(map);
    Frame frame = drives.drive(0, 1).front();
    (void)localizer.process(frame);
    CHECK_THROWS_AS(localizer.process(frame), std::invalid_argument);  // the same time
    frame.time = frame.time - seconds(5);
    CHECK_THROWS_AS(localizer.process(frame), std::invalid_argument);
    frame.time = frame.time + seconds(3600);
    frame.T_odom_body = SE3d(SO3d(), {std::numeric_limits<double>::quiet_NaN(), 0, 0});
    CHECK_THROWS_AS(localizer.process(frame), std::invalid_argument);
    frame.T_odom_body = SE3d();
    frame.covariance(2, 2) = std::numeric_limits<double>::infinity();
    CHECK_THROWS_AS(localizer.process(frame), std::invalid_argument);
    frame.covariance = Matrix6d::Identity();
    frame.cloud.positions.assign(100, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
    CHECK(localizer.process(frame).status == LocalizationStatus::searching);
    for (Keyframe& one : map.keyframes) one.cloud.reset();
    CHECK_THROWS_AS(Localizer<>{map}, std::invalid_argument);
    map = drives.map();
    map.keyframes[3].T_map_body = SE3d(SO3d(), {0, std::numeric_limits<double>::infinity(), 0});
    CHECK_THROWS_AS(Localizer<>{map}, std::invalid_argument);
  }

  TEST_CASE("real: a courtyard walked twice; the second walk is found in the first from any start, never elsewhere") {
    const std::optional<test::TwoSessions> sessions = test::two_walks(2.0);
    if (!sessions) return;
    SlamMap map = sessions->map;
    const Index first = map.sessions[1].first_keyframe;
    std::vector<Frame> walk;
    for (const Keyframe& one : std::span(sessions->map.keyframes).subspan(static_cast<std::size_t>(first)))
      walk.push_back({one.time, one.T_odom_body, Matrix6d::Zero(), *one.cloud.load(), {}});
    map.keyframes.resize(static_cast<std::size_t>(first));
    map.sessions.resize(1);
    PlaceCandidateOptions places = test::for_courtyard();
    places.min_share = 0;
    places.max_count = 4;
    LocalizerOptions options;
    options.scans.distance = 0.5;
    Localizer<> localizer(map, options, LoopCloser<>(), PlaceCandidates(places));
    int found = 0, starts = 0;
    double worst = 0, seconds_to_fix = 0;
    for (std::size_t start = 0; start + 60 < walk.size(); start += 20, ++starts) {
      localizer.restart();
      bool is_found = false;
      for (std::size_t i = start; i < walk.size(); ++i) {
        const Localization now = localizer.process(walk[i]);
        if (!now.T_map_body) continue;
        if (!is_found) seconds_to_fix = std::max(seconds_to_fix, to_seconds(walk[i].time - walk[start].time));
        is_found = true;
        worst = std::max(worst, off(now, sessions->T_first_second * walk[i].T_odom_body));
      }
      found += is_found ? 1 : 0;
    }
    MESSAGE(found, " of ", starts, " starts found within ", seconds_to_fix, " s, worst ", worst, " m");
    CHECK(found == starts);
    CHECK(worst < 0.5);
  }
}

}  // namespace chainslam
