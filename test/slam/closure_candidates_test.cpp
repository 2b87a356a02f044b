#include "chainslam/slam/closure_candidates.hpp"

#include <doctest/doctest.h>

#include <numbers>
#include <vector>

#include "slam/street.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;
using test::keyframes_at;

SE3d at(double x, double y = 0, double heading = 0) { return SE3d(SO3d::exp({0, 0, heading}), {x, y, 0}); }

PositionIndex index_of(const std::vector<Keyframe>& keyframes) {
  PositionIndex index;
  index.rebuild(keyframes);
  return index;
}

std::vector<Index> proposals(const ProximityCandidates& candidates, const std::vector<Keyframe>& keyframes,
                             Index query) {
  std::vector<Index> ids;
  for (const KeyframeId id : candidates.find(keyframes, index_of(keyframes), KeyframeId{query}))
    ids.push_back(id.value);
  return ids;
}

/// Keyframes a second apart at these places, and the query last, a minute after them.
std::vector<Keyframe> visit_again(std::vector<SE3d> places, const SE3d& query) {
  places.push_back(query);
  std::vector<Keyframe> keyframes = keyframes_at(places);
  keyframes.back().time = keyframes.back().time + seconds(60);
  return keyframes;
}

}  // namespace

TEST_SUITE("slam/closure_candidates") {
  TEST_CASE("a session's own keyframes are proposed only after the minimum interval, counted in the data's time") {
    std::vector<Keyframe> keyframes = keyframes_at({at(0), at(50), at(0)});
    const ProximityCandidates candidates{.min_interval = seconds(30), .min_keyframes = 0};
    keyframes[2].time = keyframes[0].time + seconds(30) - Duration(1);
    CHECK(proposals(candidates, keyframes, 2).empty());
    keyframes[2].time = keyframes[0].time + seconds(30);
    CHECK(proposals(candidates, keyframes, 2) == std::vector<Index>{0});
  }

  TEST_CASE("around a session's newest keyframes no submap is proposed that would hold the query's own scan") {
    std::vector<SE3d> standing(40, at(0));
    const ProximityCandidates candidates{.min_separation = 0, .max_count = 100, .min_keyframes = 30, .min_path = 200};
    std::vector<Keyframe> keyframes = visit_again(standing, at(0));
    CHECK(candidates.first_own(keyframes, KeyframeId{40}) == KeyframeId{10});
    CHECK(proposals(candidates, keyframes, 40).size() == 10);
    for (std::size_t i = 0; i < 20; ++i) keyframes[i].session = SessionId{1};  // others may be as near as they are
    CHECK(candidates.first_own(keyframes, KeyframeId{40}) == KeyframeId{20});
    CHECK(proposals(candidates, keyframes, 40).size() == 20);
  }

  TEST_CASE("a long enough path between two keyframes serves as well as many keyframes") {
    const ProximityCandidates candidates{.min_keyframes = 30, .min_path = 200};
    for (const double away : {99.0, 101.0}) {
      const std::vector<Keyframe> keyframes = visit_again({at(0), at(away)}, at(0));
      CHECK(candidates.first_own(keyframes, KeyframeId{2}) == KeyframeId{away > 100 ? 1 : 0});
      CHECK(proposals(candidates, keyframes, 2).empty() == (away < 100));
    }
  }

  TEST_CASE("keyframes of other sessions need no interval, whatever their clock says") {
    for (const double offset : {-1000.0, 0.0, 1.0}) {
      std::vector<Keyframe> keyframes = keyframes_at({at(0), at(1)});
      keyframes[1].session = SessionId{1};
      keyframes[1].time = keyframes[0].time + seconds(offset);
      CHECK(proposals({}, keyframes, 1) == std::vector<Index>{0});
    }
  }

  TEST_CASE("only what lies within the radius is proposed, by where the graph puts it") {
    std::vector<Keyframe> keyframes = visit_again({at(14.9), at(15.1)}, at(0));
    const ProximityCandidates candidates{.radius = 15, .min_separation = 0, .min_keyframes = 0};
    CHECK(proposals(candidates, keyframes, 2) == std::vector<Index>{0});
    keyframes[1].T_map_body = at(3);
    keyframes[0].T_map_body = at(30);
    CHECK(proposals(candidates, keyframes, 2) == std::vector<Index>{1});
  }

  TEST_CASE("the nearer comes first, and one that looks the same way before a nearer one that looks back") {
    const std::vector<Keyframe> keyframes =
        visit_again({at(4), at(2, 0, std::numbers::pi), at(6), at(2.5, 0, 0.1)}, at(0));
    const ProximityCandidates candidates{.heading_weight = 3, .min_separation = 0, .max_count = 10, .min_keyframes = 0};
    CHECK(proposals(candidates, keyframes, 4) == std::vector<Index>{3, 0, 2, 1});
    const ProximityCandidates by_distance{
        .heading_weight = 0, .min_separation = 0, .max_count = 10, .min_keyframes = 0};
    CHECK(proposals(by_distance, keyframes, 4) == std::vector<Index>{1, 3, 0, 2});
  }

  TEST_CASE("of keyframes whose submaps are largely the same only the best is proposed, unless sessions differ") {
    std::vector<Keyframe> keyframes = visit_again({at(6), at(5), at(4), at(3), at(2), at(1)}, at(0));
    const ProximityCandidates candidates{.min_separation = 3, .max_count = 10, .min_keyframes = 0};
    CHECK(proposals(candidates, keyframes, 6) == std::vector<Index>{5, 2});
    for (std::size_t i = 4; i < keyframes.size(); ++i) keyframes[i].session = SessionId{1};
    CHECK(proposals(candidates, keyframes, 6) == std::vector<Index>{5, 3, 0});
  }

  TEST_CASE("no more are proposed than the count, and never the query itself") {
    const std::vector<Keyframe> keyframes = visit_again({at(1), at(2), at(3), at(4)}, at(0));
    CHECK(proposals({.min_separation = 0, .max_count = 2, .min_keyframes = 0}, keyframes, 4) ==
          std::vector<Index>{0, 1});
    CHECK(proposals({.min_separation = 0, .max_count = 0}, keyframes, 4).empty());
    CHECK(proposals({.min_interval = seconds(0), .min_separation = 0, .max_count = 9, .min_keyframes = 0}, keyframes,
                    4) == std::vector<Index>{0, 1, 2, 3});
  }

  TEST_CASE("ties are broken by id, and an index grown by appending gives the same proposals as one built at once") {
    for_all(20, [](Rng& rng, int size) {
      std::vector<SE3d> places;
      for (int i = 0; i < 2 + 3 * size; ++i) places.push_back(at(rng.uniform_index(12), rng.uniform_index(12)));
      const std::vector<Keyframe> keyframes = visit_again(places, at(6, 6));
      PositionIndex grown;
      for (const Keyframe& keyframe : keyframes) grown.append(keyframe.id, keyframe.T_map_body.translation());
      const ProximityCandidates candidates{.min_separation = 2, .max_count = 20, .min_keyframes = 0};
      const KeyframeId query = keyframes.back().id;
      const std::vector<KeyframeId> found = candidates.find(keyframes, grown, query);
      CHECK(found == candidates.find(keyframes, index_of(keyframes), query));
      for (std::size_t i = 1; i < found.size(); ++i) {
        const auto distance = [&](KeyframeId id) {
          const Eigen::Vector3d& position = keyframes[static_cast<std::size_t>(id.value)].T_map_body.translation();
          return (position - Eigen::Vector3d(6, 6, 0)).norm();
        };
        const double before = distance(found[i - 1]), after = distance(found[i]);
        CHECK((before < after || (before == after && found[i - 1] < found[i])));
      }
    });
  }
}

}  // namespace chainslam
