#pragma once

#include <array>
#include <cmath>
#include <map>
#include <vector>

#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/downsampling.hpp"

namespace chainslam::test {

/// Brute force that thins by a policy, carried out the plain way: the reference for maps that thin.
template <class ScalarType, class Policy, int Dim = 3>
class ThinnedBruteForce : public BruteForce<ScalarType, Dim> {
  using Base = BruteForce<ScalarType, Dim>;

 public:
  using typename Base::Scalar;
  using typename Base::Vector;

  explicit ThinnedBruteForce(const Policy& policy) : policy_(policy) {}

  bool insert(const Vector& p) {
    if (!p.allFinite()) return give(p);
    Voxel& voxel = voxels_[cell(p)];
    std::erase_if(voxel.points, [&](Index i) { return !this->contains(i); });
    if (voxel.points.empty()) return add(voxel, p);
    return decide(policy_, voxel, p);
  }

  Index insert(const std::vector<Vector>& points) {
    const std::size_t before = this->size();
    for (const Vector& p : points) insert(p);
    return static_cast<Index>(this->size() - before);
  }

  /// The voxel that holds p.
  [[nodiscard]] std::array<double, 3> cell(const Vector& p) const {
    std::array<double, 3> whole{};
    for (int axis = 0; axis < Dim; ++axis)
      whole[static_cast<std::size_t>(axis)] = std::floor(static_cast<double>(p[axis]) * (1.0 / policy_.voxel_size));
    return whole;
  }

 private:
  struct Voxel {
    std::vector<Index> points;
    int offered = 0;
  };

  bool give(const Vector& p) {
    ++given_;
    return Base::insert(p);
  }
  [[nodiscard]] Index last_index() const { return given_ - 1; }

  bool add(Voxel& voxel, const Vector& p) {
    give(p);
    voxel.offered = 1;
    voxel.points.push_back(last_index());
    return true;
  }

  void replace(Voxel& voxel, const Vector& p) {
    this->erase(voxel.points[0]);
    give(p);
    voxel.points[0] = last_index();
  }

  [[nodiscard]] double from_center(const Vector& p) const {
    const std::array<double, 3> own = cell(p);
    double sum = 0;
    for (int axis = 0; axis < Dim; ++axis) {
      const double scaled = static_cast<double>(p[axis]) * (1.0 / policy_.voxel_size);
      const double offset = scaled - (own[static_cast<std::size_t>(axis)] + 0.5);
      sum += offset * offset;
    }
    return sum;
  }

  bool decide(const FirstInVoxel&, Voxel&, const Vector&) { return false; }
  bool decide(const NearestToCenter&, Voxel& voxel, const Vector& p) {
    if (!(from_center(p) < from_center(this->position(voxel.points[0])))) return false;
    replace(voxel, p);
    return true;
  }
  bool decide(const MeanOfVoxel&, Voxel& voxel, const Vector& p) {
    ++voxel.offered;
    const Vector old = this->position(voxel.points[0]);
    const Eigen::Matrix<double, Dim, 1> step = (p.template cast<double>() - old.template cast<double>());
    const Vector mean = (old.template cast<double>() + step / voxel.offered).template cast<Scalar>();
    if (cell(mean) == cell(old)) replace(voxel, mean);
    return cell(mean) == cell(old) && mean == p;
  }
  bool decide(const AtMost& policy, Voxel& voxel, const Vector& p) {
    return static_cast<Index>(voxel.points.size()) < policy.count && add(voxel, p);
  }

  Policy policy_;
  std::map<std::array<double, 3>, Voxel> voxels_;
  Index given_ = 0;
};

}  // namespace chainslam::test
