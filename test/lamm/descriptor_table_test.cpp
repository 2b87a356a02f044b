#include "descriptor_table.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <map>
#include <memory>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "lamm/keypoint_places.hpp"
#include "place_verification.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

const auto all_places = [](Index /*place*/) { return true; };

/// How many triangles of a query look like one of a place, by trying all pairs.
Index count_matches(const PlaceDescriptor& query, const PlaceDescriptor& place, const TableOptions& options) {
  Index count = 0;
  for (const Triangle& a : query.triangles)
    for (const Triangle& b : place.triangles) {
      if (!((a.sides - b.sides).norm() < options.max_side_difference * a.sides.norm())) continue;
      double sum = 0;
      for (std::size_t k = 0; k < 3; ++k)
        sum += similarity(query.keypoints[a.corners[k]], place.keypoints[b.corners[k]]);
      count += sum / 3 > options.min_similarity;
    }
  return count;
}

}  // namespace

TEST_SUITE("lamm/descriptor_table") {
  TEST_CASE("the right place is found among decoys, from anywhere, with the right motion") {
    test::for_all(25, [](Rng& rng, int /*size*/) {
      DescriptorTable table;
      std::vector<std::shared_ptr<const PlaceDescriptor>> places;
      for (int i = 0; i < 30; ++i) {
        places.push_back(std::make_shared<const PlaceDescriptor>(test::random_place(rng)));
        CHECK(table.add(places.back()) == i);
      }
      const Index right = rng.uniform_index(30);
      const SE3d T = test::random_motion(rng, 100);
      const PlaceDescriptor view = test::seen_again(*places[static_cast<std::size_t>(right)], T, 0.02, rng);
      const auto candidates = table.candidates(view, all_places);
      REQUIRE(!candidates.empty());
      CHECK(candidates.front().place == right);
      const auto found = recognize(view, table, candidates);
      REQUIRE(found);
      CHECK(found->place == right);
      const SE3d error = found->T_place_query * T;
      CHECK(error.translation().norm() < 0.2);
      CHECK(error.rotation().log().norm() < 0.01);
      CHECK(found->overlap > 0.9);
    });
  }

  TEST_CASE("a place that was never seen is not recognized") {
    test::for_all(25, [](Rng& rng, int /*size*/) {
      DescriptorTable table;
      for (int i = 0; i < 30; ++i) table.add(std::make_shared<const PlaceDescriptor>(test::random_place(rng)));
      const PlaceDescriptor elsewhere = test::random_place(rng);
      CHECK(!recognize(elsewhere, table, table.candidates(elsewhere, all_places)));
    });
  }

  TEST_CASE("votes are those of brute force, for any number of threads") {
    test::for_all(10, [](Rng& rng, int /*size*/) {
      // Cells as wide as sides may differ, so that the neighbouring cells hold all matches.
      const TableOptions options{.side_resolution = 0.6, .min_similarity = 0.3, .min_votes = 1, .max_candidates = 100};
      DescriptorTable table(options);
      std::vector<PlaceDescriptor> places;
      for (int i = 0; i < 8; ++i) {
        places.push_back(test::random_place(rng, 30));
        table.add(std::make_shared<const PlaceDescriptor>(places.back()));
      }
      const PlaceDescriptor view = test::seen_again(places[3], SE3d(), 0.05, rng);
      const auto candidates = table.candidates(view, all_places);
      std::map<Index, Index> votes;
      for (const PlaceCandidate& candidate : candidates) votes[candidate.place] = to_index(candidate.matches.size());
      for (Index i = 0; i < 8; ++i) {
        const Index expected = count_matches(view, places[static_cast<std::size_t>(i)], options);
        CHECK(votes[i] == expected);
      }
      CHECK(std::ranges::is_sorted(candidates, std::ranges::greater{},
                                   [](const PlaceCandidate& one) { return one.matches.size(); }));
      const auto threaded = table.candidates(view, all_places, ThreadPool(3));
      REQUIRE(threaded.size() == candidates.size());
      for (std::size_t i = 0; i < threaded.size(); ++i) {
        CHECK(threaded[i].place == candidates[i].place);
        CHECK(std::ranges::equal(threaded[i].matches, candidates[i].matches, {}, &TriangleMatch::query,
                                 &TriangleMatch::query));
      }
    });
  }

  TEST_CASE("what is not eligible is not found, and no more candidates than asked for") {
    Rng rng(1);
    DescriptorTable table({.max_candidates = 3});
    const auto place = std::make_shared<const PlaceDescriptor>(test::random_place(rng));
    for (int i = 0; i < 6; ++i) table.add(place);
    const auto first = table.candidates(*place, all_places);
    REQUIRE(first.size() == 3);  // all are equal: those added first
    for (Index i = 0; i < 3; ++i) CHECK(first[static_cast<std::size_t>(i)].place == i);
    const auto odd = table.candidates(*place, [](Index i) { return i == 5; });
    REQUIRE(odd.size() == 1);
    CHECK(odd[0].place == 5);
    CHECK(table.candidates(PlaceDescriptor{}, all_places).empty());
    CHECK(DescriptorTable().candidates(*place, all_places).empty());
  }

  TEST_CASE("a candidate needs as many triangles in common as the options say") {
    const std::vector<BinaryKeypoint> corners{{.position = {0, 0, 0}, .occupancy = 0xfff},
                                              {.position = {6, 0, 0}, .occupancy = 0xfff},
                                              {.position = {0, 9, 0}, .occupancy = 0xfff}};
    PlaceDescriptor place;
    place.keypoints = corners;
    place.triangles = triangles_of(corners);
    REQUIRE(place.triangles.size() == 1);
    DescriptorTable few({.min_votes = 1}), usual;
    few.add(std::make_shared<const PlaceDescriptor>(place));
    usual.add(std::make_shared<const PlaceDescriptor>(place));
    CHECK(few.candidates(place, all_places).size() == 1);
    CHECK(usual.candidates(place, all_places).empty());
  }
}

TEST_SUITE("lamm/place_verification") {
  TEST_CASE("planes of either sign overlap under the right motion, and not under a wrong one") {
    test::for_all(20, [](Rng& rng, int /*size*/) {
      const PlaceDescriptor place = test::random_place(rng);
      const SE3d T = test::random_motion(rng, 50);
      PointCloud<float> view = test::seen_again(place, T, 0.02, rng).planes.cloud();
      for (Eigen::Vector3f& normal : view.normals)
        if (rng.uniform() < 0.5) normal = -normal;
      CHECK(plane_overlap(view, place.planes, T.inverse()) == 1.0);
      const SE3d aside = T.inverse() * SE3d(SO3d::exp({0.5, 0.5, 0.5}), {5, 5, 5});
      CHECK(plane_overlap(view, place.planes, aside) < 0.3);
      CHECK(plane_overlap({}, place.planes, T) == 0.0);
      CHECK(plane_overlap(view, IndexedCloud<>(), T) == 0.0);
    });
  }

  TEST_CASE("refinement brings planes together that are a little off") {
    test::for_all(20, [](Rng& rng, int /*size*/) {
      const PlaceDescriptor place = test::random_place(rng);
      const SE3d off(SO3d::exp({rng.normal(0, 0.005), rng.normal(0, 0.005), rng.normal(0, 0.01)}),
                     {rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2)});
      const RecognizedPlace found = refined({.T_place_query = off}, place.planes.cloud(), place.planes);
      CHECK(found.T_place_query.translation().norm() < 0.02);
      CHECK(found.T_place_query.rotation().log().norm() < 0.002);
    });
  }
}

}  // namespace chainslam
