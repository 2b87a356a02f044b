#include "chainslam/registration/rejectors.hpp"

#include <doctest/doctest.h>

#include <limits>

#include "chainslam/registration/icp.hpp"
#include "registration/scenes.hpp"

namespace chainslam::test {
namespace {

struct ListedPair {
  Index target;
  double squared_distance;
  double cosine = 1.0;
  bool kept = true;
};

/// Pairs as a rejector sees them, from a list.
struct ListedPairs {
  std::vector<ListedPair> list;

  [[nodiscard]] const ListedPair& at(Index i) const { return list[static_cast<std::size_t>(i)]; }
  [[nodiscard]] Index size() const { return static_cast<Index>(list.size()); }
  [[nodiscard]] bool kept(Index i) const { return at(i).kept; }
  [[nodiscard]] Index target(Index i) const { return at(i).target; }
  [[nodiscard]] double squared_distance(Index i) const { return at(i).squared_distance; }
  [[nodiscard]] double cosine(Index i) const { return at(i).cosine; }
  void reject(Index i) { list[static_cast<std::size_t>(i)].kept = false; }

  [[nodiscard]] std::vector<Index> left() const {
    std::vector<Index> result;
    for (Index i = 0; i < size(); ++i)
      if (kept(i)) result.push_back(i);
    return result;
  }
};
static_assert(RejectablePairs<ListedPairs>);

template <class Rejector>
std::vector<Index> left_by(const Rejector& rejector, ListedPairs pairs) {
  rejector(pairs);
  return pairs.left();
}

struct Incomplete {
  static constexpr bool needs_normals = false;
};
static_assert(!MatchRejector<Incomplete>);

}  // namespace

TEST_SUITE("registration/rejectors") {
  TEST_CASE("each drops what its name says, and what was dropped stays dropped") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const ListedPairs pairs{{{7, 0.01, 1.0},
                             {7, 0.04, -0.99},
                             {2, 0.04, 0.3},
                             {2, 0.04, nan},
                             {5, 1.00, 0.9},
                             {5, 0.00, 0.9, false},
                             {9, 0.09, 0.95}}};
    CHECK(left_by(KeepPairs{}, pairs) == std::vector<Index>{0, 1, 2, 3, 4, 6});
    CHECK(left_by(WithinDistance{.max_distance = 0.2}, pairs) == std::vector<Index>{0, 1, 2, 3});
    CHECK(left_by(WithinMedian{.factor = 1.4}, pairs) == std::vector<Index>{0, 1, 2, 3});
    CHECK(left_by(WithinAngle{.max_angle = 0.5}, pairs) == std::vector<Index>{0, 1, 4, 6});
    CHECK(left_by(WithinAngle{.max_angle = 0.5, .oriented = true}, pairs) == std::vector<Index>{0, 4, 6});
    CHECK(left_by(OneToOne{}, pairs) == std::vector<Index>{0, 2, 4, 6});
    CHECK(left_by(Trimmed{.share = 0.5}, pairs) == std::vector<Index>{0, 1, 2, 3});
    CHECK(left_by(Trimmed{.share = 1.0}, pairs) == std::vector<Index>{0, 1, 2, 3, 4, 6});
    const AllOf<WithinDistance, OneToOne> both{{WithinDistance{.max_distance = 0.2}, OneToOne{}}};
    CHECK(left_by(both, pairs) == std::vector<Index>{0, 2});
    const auto none = ListedPairs{};
    CHECK(left_by(AllOf<WithinMedian, Trimmed, OneToOne>{}, none).empty());
  }

  TEST_CASE("in an alignment: rejected pairs count as overlap, not as inliers, and do not pull") {
    Rng rng(21);
    const SE3d truth = asymmetric_pose();
    PointCloud<float> seen = sample(rng, yard(), 6000, 0.01);
    for (std::size_t i = 0; i < seen.size(); i += 4) {  // moved furniture, its surfaces turned
      seen.positions[i].z() += 0.5F;
      seen.normals[i] = Eigen::Vector3f(0.6F, 0.64F, 0.48F);
    }
    PointCloud<float> source = seen_from(seen, truth);
    for (const Eigen::Vector3f& n : seen.normals)
      source.normals.push_back((truth.rotation().inverse() * n.cast<double>().eval()).cast<float>());
    const IndexedCloud<> target(sample(rng, yard(), 8000));
    const SE3d guess = truth * random_motion(rng, 0.05, 0.005);
    const AlignResult pulled = PointToPlaneIcp{}.align(source, target, guess);
    CHECK(translation_error(truth, pulled.T_target_source) > 0.03);
    CHECK(pulled.overlap == pulled.inlier_ratio);

    const AlignResult by_angle =
        Icp<PointToPlane, Trivial, WithinAngle>{.rejector = {.max_angle = 0.3}}.align(source, target, guess);
    CHECK(by_angle.status == AlignStatus::converged);
    CHECK(translation_error(truth, by_angle.T_target_source) < 0.004);
    CHECK(by_angle.inlier_ratio == doctest::Approx(0.74).epsilon(0.03));
    CHECK(by_angle.overlap > 0.95);

    const AlignResult trimmed =
        Icp<PointToPlane, Trivial, AllOf<Trimmed, OneToOne>>{.rejector = {{Trimmed{.share = 0.7}, OneToOne{}}}}.align(
            source, target, guess);
    CHECK(trimmed.status == AlignStatus::converged);
    CHECK(translation_error(truth, trimmed.T_target_source) < 0.01);
    CHECK(trimmed.inlier_ratio < 0.7 * trimmed.overlap);

    PointCloud<float> bare = source;
    bare.normals.clear();
    CHECK_THROWS_AS((void)(Icp<PointToPlane, Trivial, WithinAngle>{}.align(bare, target, guess)),
                    std::invalid_argument);
  }
}

}  // namespace chainslam::test
