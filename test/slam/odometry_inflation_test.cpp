#include "chainslam/slam/odometry_noise.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/back_end.hpp"
#include "slam/scripted.hpp"

namespace chainslam {
namespace {

Matrix6d diagonal(double position_variance, double rotation_variance) {
  Matrix6d covariance = Matrix6d::Zero();
  for (int i = 0; i < 6; ++i) covariance(i, i) = i < 3 ? position_variance : rotation_variance;
  return covariance;
}

/// Frames a metre and a second apart along x, of these statuses and position variances.
std::vector<FrameRecord> frames_of(const std::vector<FrameStatus>& statuses, const std::vector<double>& variances) {
  std::vector<FrameRecord> frames;
  for (std::size_t i = 0; i < statuses.size(); ++i) {
    FrameRecord frame;
    frame.session = SessionId{0};
    frame.time = Timestamp::from_seconds(static_cast<double>(i));
    frame.T_odom_body = SE3d(SO3d(), {static_cast<double>(i), 0, 0});
    frame.covariance = PackedCovariance(diagonal(variances[i], 0));
    frame.health.status = statuses[i];
    frames.push_back(frame);
  }
  return frames;
}

constexpr FrameStatus good = FrameStatus::good, lost = FrameStatus::lost, degenerate = FrameStatus::degenerate;

Keyframe keyframe_of(const FrameRecord& frame) {
  Keyframe keyframe;
  keyframe.time = frame.time;
  keyframe.T_odom_body = frame.T_odom_body;
  return keyframe;
}

/// Covariance of the measurement that a back end makes of two keyframes, the first and the last of `frames`.
Matrix6d measured(const std::vector<FrameRecord>& frames) {
  MapGraph<Cauchy> graph;
  graph.append(std::span(frames).first(1));
  graph.append(keyframe_of(frames.front()));
  graph.append(std::span(frames).subspan(1));
  graph.append(keyframe_of(frames.back()));
  const Matrix6d root = graph.map().odometry.at(0).sqrt_information;
  const Matrix6d inverse = root.inverse();
  return inverse * inverse.transpose();
}

}  // namespace

TEST_SUITE("slam/odometry_inflation") {
  TEST_CASE("good frames add nothing, whatever their covariance") {
    CHECK(OdometryInflation{}(frames_of({good, good, good}, {0.25, 4, 0.5})).isZero(0));
    CHECK(OdometryInflation{}({}).isZero(0));
  }

  TEST_CASE("degenerate frames add what their covariance grows by, and nothing when it shrinks") {
    const Matrix6d doubt =
        OdometryInflation{}(frames_of({good, degenerate, degenerate, degenerate}, {0.25, 1, 2, 1.5}));
    CHECK((doubt - diagonal(1.75, 0)).cwiseAbs().maxCoeff() < 1e-6);
  }

  TEST_CASE("lost frames add a share of the prediction's variance, all of it if the local map was restarted") {
    std::vector<FrameRecord> frames = frames_of({good, lost, lost, good}, {0.25, 1.25, 4.25, 0.25});
    CHECK((OdometryInflation{}(frames)-diagonal(0.4, 0)).cwiseAbs().maxCoeff() < 1e-6);
    frames[2].health.map_restarted = true;
    CHECK((OdometryInflation{}(frames)-diagonal(4, 0)).cwiseAbs().maxCoeff() < 1e-6);
  }

  TEST_CASE("what is matched after a gap is doubted by how far the body may have gone in it") {
    std::vector<FrameRecord> frames = frames_of({good, good, good}, {0.01, 0.01, 0.01});
    frames[2].time = frames[1].time + seconds(4);
    CHECK(
        OdometryInflation{}(frames).isZero(0));  // odometry's own gaps count: with an IMU the motion is known in others
    frames[2].health.after_gap = true;
    const Matrix6d doubt = OdometryInflation{}(frames);
    CHECK(doubt(0, 0) == doctest::Approx(0.1 * 20 * 20));
    CHECK(doubt(5, 5) == doctest::Approx(0.1 * 0.4 * 0.4));
    CHECK(doubt(0, 1) == 0);
    frames[2].health.status = lost;  // whose covariance says it
    CHECK(OdometryInflation{}(frames).isZero(0));
  }

  // A match is wrong with the probability `wrong_rematch`, and then as far off as the pose had been predicted.
  TEST_CASE("where it is switched off, nothing is doubted") {
    const std::vector<FrameRecord> frames = frames_of({good, lost, good, degenerate}, {0.1, 0.5, 0.5, 0.9});
    CHECK_FALSE(OdometryInflation{}(frames).isZero(0));
    CHECK(OdometryInflation{.enabled = false}(frames).isZero(0));
  }

  TEST_CASE("the share is the variance of a pose that is sometimes matched at a wrong place") {
    Rng rng(5);
    double sum = 0;
    constexpr int draws = 200'000;
    const double predicted = 2;
    for (int i = 0; i < draws; ++i) {
      const double error = rng.uniform(0, 1) < OdometryInflation{}.wrong_rematch ? rng.normal(0, predicted) : 0.0;
      sum += error * error;
    }
    const Matrix6d doubt = OdometryInflation{}(frames_of({good, lost, good}, {0, predicted * predicted, 0}));
    CHECK(doubt(1, 1) == doctest::Approx(sum / draws).epsilon(0.05));
  }

  TEST_CASE("an error of the attitude moves the next keyframe by its lever arm, as sampling finds") {
    std::vector<FrameRecord> frames = frames_of({good, lost, good}, {0, 0, 0});
    frames[1].covariance = PackedCovariance(diagonal(0, 1e-4));
    frames[1].health.map_restarted = true;
    frames[2].T_odom_body = SE3d(SO3d::exp({0, 0, 0.5}), {20, 3, 1});
    const SE3d relative = frames[1].T_odom_body.inverse() * frames[2].T_odom_body;
    Rng rng(6);
    Matrix6d sampled = Matrix6d::Zero();
    constexpr int draws = 40'000;
    for (int i = 0; i < draws; ++i) {
      Vector6d error = Vector6d::Zero();
      for (int k = 3; k < 6; ++k) error[k] = rng.normal(0, 1e-2);
      const Vector6d at_end = frames[2].T_odom_body.local(frames[1].T_odom_body.retract(error) * relative);
      sampled += at_end * at_end.transpose() / draws;
    }
    const Matrix6d doubt = OdometryInflation{}(frames);
    CHECK((doubt - sampled).cwiseAbs().maxCoeff() < 0.03 * sampled.cwiseAbs().maxCoeff());
    CHECK(doubt(1, 1) > 0.03);  // m^2: 19 m times 0.01 rad
  }

  TEST_CASE("a back end measures across lost frames by what is known there, and as always where all are good") {
    const std::vector<FrameRecord> fine = frames_of({good, good, good, good}, {0.01, 0.01, 0.01, 0.01});
    const Matrix6d plain = measured(fine);
    const Vector6d noise = OdometryNoise{}(SE3d(SO3d(), {3, 0, 0})).sqrt_information().diagonal();
    for (int i = 0; i < 6; ++i) {
      const double stated = i < 3 ? 0.5 * 0.5 * (0.01 + 0.01) : 0;
      CHECK(plain(i, i) == doctest::Approx(1 / (noise[i] * noise[i]) + stated));
    }
    std::vector<FrameRecord> frames = frames_of({good, lost, lost, good}, {0.01, 25.01, 100.01, 0.01});
    CHECK((measured(frames) - plain - diagonal(10, 0)).cwiseAbs().maxCoeff() < 1e-4);
    frames[2].health.map_restarted = true;
    CHECK((measured(frames) - plain - diagonal(100, 0)).cwiseAbs().maxCoeff() < 1e-4);
  }

  TEST_CASE("two frames' covariances are those of errors that are theirs alone, as sampling finds") {
    std::vector<FrameRecord> frames = frames_of({good, good}, {0, 0});
    Matrix6d stated = diagonal(1e-4, 4e-6);
    stated(0, 0) = 0.04;
    for (FrameRecord& frame : frames) frame.covariance = PackedCovariance(stated);
    frames[1].T_odom_body = SE3d(SO3d::exp({0, 0.2, 1.2}), {8, 5, 1});
    Rng rng(7);
    Matrix6d sampled = Matrix6d::Zero();
    constexpr int draws = 40'000;
    const auto drawn = [&](const SE3d& pose) {
      Vector6d error;
      for (int k = 0; k < 6; ++k) error[k] = rng.normal(0, std::sqrt(stated(k, k)));
      return pose.retract(error);
    };
    const SE3d relative = frames[0].T_odom_body.inverse() * frames[1].T_odom_body;
    for (int i = 0; i < draws; ++i) {
      const Vector6d off = relative.local(drawn(frames[0].T_odom_body).inverse() * drawn(frames[1].T_odom_body));
      sampled += off * off.transpose() / draws;
    }
    const Matrix6d found = stated_covariance(frames);
    CHECK((found - sampled).cwiseAbs().maxCoeff() < 0.03 * sampled.cwiseAbs().maxCoeff());
    CHECK((found - sampled).bottomRightCorner<3, 3>().cwiseAbs().maxCoeff() < 0.05 * 8e-6);
    CHECK(stated_covariance(std::span(frames).first(1)).isZero(0));
  }

  TEST_CASE("in a corridor every step is weak along it and no other way, and what a restart left counts once") {
    std::vector<FrameRecord> frames = frames_of({degenerate, degenerate, degenerate}, {0, 0, 0});
    Matrix6d along = Matrix6d::Zero();
    along(0, 0) = 0.09;  // the scans do not see it: of each frame by itself, the prediction's
    for (FrameRecord& frame : frames) frame.covariance = PackedCovariance(along);
    const Matrix6d plain = measured(frames_of({good, good, good}, {1e-12, 1e-12, 1e-12}));
    CHECK((measured(frames) - plain - 0.25 * 2 * along).cwiseAbs().maxCoeff() < 1e-6);

    std::vector<FrameRecord> after = frames_of({good, good, good}, {25, 25, 25.04});  // of a map restarted before
    CHECK((measured(after) - plain - diagonal(0.25 * 0.04, 0)).cwiseAbs().maxCoeff() < 1e-5);
  }

  TEST_CASE("a turn makes the rotation weaker, and odometry that states nothing is weaker in all") {
    const SE3d straight(SO3d(), {3, 0, 0}), turned(SO3d::exp({0, 0, 0.3}), {3, 0, 0});
    const auto deviation = [](const NoiseModel<6>& noise, int i) { return 1 / noise.sqrt_information()(i, i); };
    const OdometryNoise noise;
    CHECK(deviation(noise(turned), 5) > 4 * deviation(noise(straight), 5));
    CHECK(deviation(noise(turned), 1) == doctest::Approx(deviation(noise(straight), 1)));
    const Matrix6d stated = measured(frames_of({good, good, good}, {1e-12, 1e-12, 1e-12}));
    const Matrix6d silent = measured(frames_of({good, good, good}, {0, 0, 0}));
    for (int i = 0; i < 6; ++i) CHECK(silent(i, i) > 4 * 4 * stated(i, i));
  }

  TEST_CASE("covariances and poses beyond all bounds leave a measurement that says nothing, and a map") {
    const double huge = std::numeric_limits<double>::max();
    std::vector<FrameRecord> frames = frames_of({good, lost, lost, good}, {0, 1e20, huge, 0});
    frames[1].T_odom_body = SE3d(SO3d::exp({1, 2, 3}), {1e200, -1e180, 5});
    frames[1].covariance = PackedCovariance(diagonal(1e28, 1e3));
    frames[2].health.map_restarted = true;
    const Matrix6d covariance = measured(frames);
    CHECK(is_finite(covariance));
    CHECK(covariance(0, 0) >= 1e11);
    CHECK(PackedCovariance(Matrix6d(Matrix6d::Constant(std::nan("")))).matrix()(2, 2) == doctest::Approx(1e30));
  }

  TEST_CASE("a loop that is closed bends the map where scans were lost, and not where they were not") {
    // Ten keyframes along x; odometry was off by 1 m where frames were lost, from 4 to 5.
    MapGraph<Cauchy> graph(MapGraphOptions{}, Cauchy{.width = 1e3});
    std::vector<FrameRecord> frames =
        frames_of({good, good, good, good, good, good, good, good, good, good}, std::vector<double>(10, 1e-4));
    for (std::size_t i = 0; i < frames.size(); ++i) {
      if (i == 5) {
        FrameRecord between = frames[4];
        between.time = between.time + seconds(0.5);
        between.covariance = PackedCovariance(diagonal(1, 0));
        between.health = {.status = lost, .map_restarted = true};
        graph.append(std::span(&between, 1));
      }
      if (i >= 5) frames[i].T_odom_body = SE3d(SO3d(), {static_cast<double>(i) + 1, 0, 0});
      graph.append(std::span(&frames[i], 1));
      graph.append(keyframe_of(frames[i]));
    }
    LoopClosure closure{.from = {0}, .to = {9}, .T_from_to = SE3d(SO3d(), {9, 0, 0})};
    closure.sqrt_information = SqrtInformation<6>::Identity() / 0.01;
    graph.accept(closure);
    graph.converge();
    for (int i = 0; i < 10; ++i)
      CHECK(graph.map().keyframes[static_cast<std::size_t>(i)].T_map_body.translation().x() ==
            doctest::Approx(i).epsilon(0.02).scale(1));
  }

  TEST_CASE("frames are kept in their session, counted on when a map is loaded, and refused if they come late") {
    std::vector<FrameRecord> frames = frames_of({good, lost}, {0, 1});
    MapGraph<Cauchy> graph;
    graph.begin_session("first");
    graph.append(frames);
    CHECK_THROWS_AS(graph.append(std::span(frames).last(1)), std::invalid_argument);
    graph.begin_session("second");
    graph.append(frames);
    frames[0].time = Timestamp::from_seconds(7);
    frames[0].T_odom_body = SE3d(SO3d(), {std::nan(""), 0, 0});
    CHECK_THROWS_AS(graph.append(std::span(frames).first(1)), std::invalid_argument);
    REQUIRE(graph.map().frames.size() == 4);
    CHECK(graph.map().frames[3].session == SessionId{1});
    MapGraph<Cauchy> other;
    other.begin_session("mine");
    other.load(graph.map());
    REQUIRE(other.map().frames.size() == 4);
    CHECK(other.map().frames[0].session == SessionId{1});
    CHECK(other.map().frames[3].session == SessionId{2});
    CHECK(other.map().frames[1].health.status == lost);
  }
}

}  // namespace chainslam
