#include "chainslam/lie/product.hpp"
#include "chainslam/lie/rn.hpp"
#include "chainslam/lie/s2.hpp"
#include "chainslam/lie/se2.hpp"
#include "chainslam/lie/se3.hpp"
#include "lie/laws.hpp"

namespace chainslam::test {

namespace {

struct NoGroup {
  using Scalar = double;
  using Tangent = Eigen::Vector3d;
  static constexpr int dof = 3;
  NoGroup retract(const Tangent&) const { return {}; }
  Tangent local(const NoGroup&) const { return Tangent::Zero(); }
};
static_assert(Manifold<NoGroup> && !LieGroup<NoGroup>);
static_assert(!Manifold<Eigen::Vector3d> && !Manifold<double>);

}  // namespace

using Navigation = Product<SE3d, R3d, SO2d>;
using FilterState = Product<SO3d, R3d, S2d>;

TEST_SUITE("lie/product") {
  TEST_CASE_TEMPLATE("products and vector spaces obey the laws of a Lie group", G, Navigation, R3d) {
    check_manifold_laws<G>();
    check_lie_group_laws<G>();
    check_numeric_jacobians<G>();
  }

  TEST_CASE("a product with a sphere is a manifold and no group") {
    static_assert(Manifold<FilterState> && !LieGroup<FilterState>);
    static_assert(LieGroup<Navigation> && LieGroup<Product<Navigation, R3d>>);
    check_manifold_laws<FilterState>();
  }

  TEST_CASE("tangents are stacked in the order of the parts") {
    static_assert(FilterState::dof == 8 && FilterState::size == 3);
    static_assert(FilterState::offset<0>() == 0 && FilterState::offset<1>() == 3 && FilterState::offset<2>() == 6);
    FilterState::Tangent d;
    d << 0.1, 0.2, 0.3, 4, 5, 6, 0, 0;
    const FilterState moved = FilterState().retract(d);
    CHECK(near(moved.get<0>().log(), Eigen::Vector3d(0.1, 0.2, 0.3), 1e-15));
    CHECK(moved.get<1>().value() == Eigen::Vector3d(4, 5, 6));
    CHECK(moved.get<2>() == S2d());
    CHECK(FilterState::segment<1>(d) == Eigen::Vector3d(4, 5, 6));
  }
}

TEST_SUITE("lie/s2") {
  TEST_CASE_TEMPLATE("directions obey the laws of a manifold", M, S2d, S2f) { check_manifold_laws<M>(); }

  TEST_CASE("the basis is orthonormal and tangent everywhere, poles and equator included") {
    for_all(100, [](Rng& rng, int) {
      Eigen::Vector3d v = random_tangent<Eigen::Vector3d>(rng, 1.0);
      for (const double z : {v.z(), 0.0, -0.0, 1e9, -1e9}) {
        v.z() = z;
        const S2d direction = S2d::from_vector(v);
        Eigen::Matrix3d frame;
        frame << direction.basis(), direction.direction();
        CHECK(near(frame.transpose() * frame, Eigen::Matrix3d::Identity(), 1e-14));
      }
    });
  }

  TEST_CASE("the basis is the derivative of the direction") {
    for_all(50, [](Rng& rng, int) {
      const S2d x = random_point<S2d>(rng);
      const auto jacobian = numeric_jacobian([](const S2d& s) { return s.direction(); }, x);
      CHECK(near(jacobian, x.basis(), 1e-11));
    });
  }

  TEST_CASE("the opposite direction is pi away, and reached") {
    for (const Eigen::Vector3d& v : {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(1, 2, 3), Eigen::Vector3d(0, 0, -1)}) {
      const S2d x = S2d::from_vector(v);
      const S2d opposite = S2d::from_vector(-v);
      CHECK(x.local(opposite).norm() == doctest::Approx(std::numbers::pi).epsilon(1e-15));
      CHECK(near(x.retract(x.local(opposite)).direction(), opposite.direction(), 1e-15));
    }
  }

  TEST_CASE("rotations turn directions") {
    const SO3d quarter = SO3d::exp(Eigen::Vector3d(0, 0, std::numbers::pi / 2));
    CHECK(near((quarter * S2d::from_vector(Eigen::Vector3d(3, 0, 0))).direction(), Eigen::Vector3d::UnitY(), 1e-15));
  }
}

}  // namespace chainslam::test
