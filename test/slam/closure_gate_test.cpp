#include <doctest/doctest.h>

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
  TEST_CASE("scans that slid along a courtyard do not fit in the direction in which they slid") {
    const auto folder = test::real_data("hku_square_two_sessions");
    if (!folder) return;
    GateWalks walks(*folder, 2);
    const auto queries = static_cast<int>(walks.queries.size());
    REQUIRE(queries > 30);
    const std::vector<double> shifts{-6, 5, -4, 7};  // metres: more than alignment reaches
    const auto told = walks.close({}, shifts), untold = walks.close({.by_direction = false}, shifts);
    const auto kept = walks.close({}, {-1, 1});
    MESSAGE(queries, " scans, each from guesses off by 4 to 7 m ", told.right, " right and ", told.wrong,
            " wrong, by all points at once ", untold.right, " and ", untold.wrong, "; off by 1 m ", kept.right, " and ",
            kept.wrong);
    CHECK(untold.wrong >= 2);
    CHECK(told.wrong <= 0.03 * static_cast<double>(shifts.size()) * queries);
    CHECK(2 * told.wrong < untold.wrong);
    CHECK(told.right >= 0.95 * untold.right);
    CHECK(kept.right >= 0.95 * 2 * queries);
    CHECK(kept.wrong == 0);
  }
}
