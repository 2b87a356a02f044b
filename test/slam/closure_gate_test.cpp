#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <memory>
#include <numbers>
#include <optional>
#include <vector>

#include "chainslam/slam/keyframe_selector.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "datasets/dataset.hpp"
#include "support/real_data.hpp"
#include "support/real_matrix.hpp"

// What the gate's defaults accept of real scans: two walks round one courtyard with a Livox Avia.

using namespace chainslam;

namespace {

std::vector<Keyframe> gate_keyframes(const std::filesystem::path& folder, SessionId session) {
  const auto dataset = datasets::open_dataset(folder);
  KeyframeSelector selector;
  std::vector<Keyframe> keyframes;
  while (const std::optional<Frame> frame = dataset->next_frame())
    if (std::optional<Keyframe> keyframe = selector(*frame)) {
      keyframe->id = KeyframeId{to_index(keyframes.size())};
      keyframe->session = session;
      keyframe->T_map_body = keyframe->T_odom_body;
      keyframes.push_back(std::move(*keyframe));
    }
  return keyframes;
}

/// A scan of the second walk with the keyframe of the first that is nearest to it.
struct GateQuery {
  Keyframe scan;
  std::size_t from = 0;
  SE3d T_from_scan{};
  Eigen::Vector3d way = Eigen::Vector3d::UnitX();  ///< of the walk, unit vector in the scan's frame
};

/// Both walks in the first one's frame, and every `step`-th scan of the second.
struct GateWalks {
  std::vector<Keyframe> map;
  std::vector<GateQuery> queries;

  GateWalks(const std::filesystem::path& folder, std::size_t step)
      : map(gate_keyframes(folder / "session1", SessionId{0})) {
    const SE3d T_first_second = test::read_matrix(folder / "T_session1_session2.txt");
    std::vector<Keyframe> scans = gate_keyframes(folder / "session2", SessionId{1});
    for (Keyframe& scan : scans) scan.T_map_body = T_first_second * scan.T_odom_body;
    for (std::size_t i = 1; i + 1 < scans.size(); i += step) {
      GateQuery query{.scan = scans[i]};
      double least = 2;  // metres, and as much for each radian
      for (std::size_t j = 0; j < map.size(); ++j) {
        const SE3d between = map[j].T_map_body.inverse() * scans[i].T_map_body;
        const double distance = between.translation().norm() + 2 * between.rotation().log().norm();
        if (distance >= least) continue;
        least = distance;
        query.from = j;
        query.T_from_scan = between;
      }
      query.way = scans[i].T_map_body.rotation().inverse() *
                  (scans[i + 1].T_map_body.translation() - scans[i - 1].T_map_body.translation()).normalized();
      if (least < 2) queries.push_back(query);
    }
    for (GateQuery& query : queries) query.scan.id = KeyframeId{to_index(map.size())};
    map.emplace_back();  // the place of the scan that is sought
  }

  /// How many scans closed where they are, and how many elsewhere.
  struct Accepted {
    int right = 0, wrong = 0;
  };

  /// Closes each scan from guesses that are off along the way by so many metres.
  [[nodiscard]] Accepted close(const ClosureGate& gate, const std::vector<double>& off) {
    LoopCloser<> closer({.gate = gate});
    Accepted accepted;
    for (const GateQuery& query : queries) {
      map.back() = query.scan;
      for (const double metres : off) {
        const SE3d guess = query.T_from_scan * SE3d(SO3d(), metres * query.way);
        const LoopClosure closure = closer.align(map, KeyframeId{to_index(query.from)}, query.scan.id, guess);
        if (closure.verdict != ClosureVerdict::accepted) continue;
        const SE3d error = query.T_from_scan.inverse() * closure.T_from_to;
        const double distance = error.translation().norm(),
                     degrees = error.rotation().log().norm() * 180 / std::numbers::pi;
        accepted.right += distance < 0.75 && degrees < 2 ? 1 : 0;
        accepted.wrong += distance > 1.5 || degrees > 5 ? 1 : 0;
      }
    }
    return accepted;
  }
};

}  // namespace

TEST_SUITE("slam: the closures' gate on real scans") {
  // Guesses off by more than alignment reaches, and by no more. A change of any default for the worse accepts some of
  // those that slid along the courtyard, or loses some of those that are right.
  TEST_CASE("scans that slid along a courtyard are refused, and none that is right") {
    const auto folder = test::real_data("hku_square_two_sessions");
    if (!folder) return;
    GateWalks walks(*folder, 2);
    const auto queries = static_cast<int>(walks.queries.size());
    REQUIRE(queries > 30);
    const std::vector<double> slid{-6, 5, -4, 7}, near{-1, 1};  // metres
    const auto far = walks.close({}, slid), there = walks.close({}, near);
    MESSAGE(queries, " scans, each from guesses off by 4 to 7 m ", far.right, " right and ", far.wrong,
            " wrong; off by 1 m ", there.right, " and ", there.wrong);
    CHECK(far.wrong == 0);
    CHECK(there.wrong == 0);
    CHECK(far.right >= 2 * queries);
    CHECK(there.right >= 0.98 * 2 * queries);
    const auto lost = [&](const ClosureGate& gate) {
      return walks.close(gate, slid).right < far.right && walks.close(gate, near).right < there.right;
    };
    CHECK(lost({.max_misfit = 0.75}));
    CHECK(lost({.misfit_share = 1}));
    CHECK(lost({.sure_misfit = 0}));
    CHECK(lost({.repeat_below = 0.3}));
    CHECK(walks.close({.misfit_share = 0.5}, slid).wrong >= 3);
    CHECK(walks.close({.sure_misfit = 3.2}, slid).wrong >= 3);
    CHECK(walks.close({.repeat_distance = 1.5}, slid).wrong >= 1);
  }
}

TEST_SUITE("slam: the closures' gate") {
  TEST_CASE("corrections of 8 m and 0.4 rad are accepted, of 20 m or 1 rad refused, by default") {
    AlignResult result;
    result.status = AlignStatus::converged;
    result.inlier_ratio = 0.9;
    const auto verdict = [&](const Eigen::Vector3d& shift, double turn) {
      const SE3d guess(SO3d::exp({0.1, 0, 2}), {300, -100, 5});
      result.T_target_source = guess * SE3d(SO3d::exp({0, 0, turn}), shift);
      return ClosureGate{}.judge(result, guess);
    };
    CHECK(verdict({8, 0, 0}, 0.4) == ClosureVerdict::accepted);
    CHECK(verdict({0, 20, 0}, 0) == ClosureVerdict::implausible);
    CHECK(verdict({0, 0, -20}, 0.4) == ClosureVerdict::implausible);
    CHECK(verdict({0, 0, 0}, 1) == ClosureVerdict::implausible);
    CHECK(verdict({8, 0, 0}, -1) == ClosureVerdict::implausible);
  }

  TEST_CASE("three in ten points without a partner are accepted, half of them is too many, by default") {
    AlignResult result;
    result.status = AlignStatus::converged;
    result.inlier_ratio = 0.7;
    CHECK(ClosureGate{}.judge(result, SE3d()) == ClosureVerdict::accepted);
    result.inlier_ratio = 0.5;
    CHECK(ClosureGate{}.judge(result, SE3d()) == ClosureVerdict::too_few_inliers);
  }
}

TEST_SUITE("slam: the closures' covariance on real scans") {
  TEST_CASE("closures of one walk with another are off by half of what their covariances say, and none by more") {
    const auto folder = test::real_data("hku_square_two_sessions");
    if (!folder) return;
    GateWalks walks(*folder, 4);
    LoopCloser<> closer;
    double sum = 0, most = 0;
    int count = 0;
    for (const GateQuery& query : walks.queries) {
      walks.map.back() = query.scan;
      const LoopClosure closure =
          closer.align(walks.map, KeyframeId{to_index(query.from)}, query.scan.id, query.T_from_scan);
      if (closure.verdict != ClosureVerdict::accepted) continue;
      const Vector6d error = (query.T_from_scan.inverse() * closure.T_from_to).log();
      const double squared = (closure.sqrt_information * error).squaredNorm() / 6;
      sum += squared;
      most = std::max(most, squared);
      ++count;
    }
    MESSAGE(count, " closures: squared error over 6 variances ", sum / count, ", at most ", most);
    REQUIRE(count > 10);
    // Truth is that of the walks, which bend by centimetres themselves.
    CHECK(sum / count < 0.35);
    CHECK(sum / count > 0.15);
    CHECK(most < 0.5);
  }
}
