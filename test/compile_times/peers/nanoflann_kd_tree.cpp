// A tree of points that stay, by nanoflann.
#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <nanoflann.hpp>
#include <vector>

struct Points {
  std::vector<Eigen::Vector3f> all;

  std::size_t kdtree_get_point_count() const { return all.size(); }
  float kdtree_get_pt(std::size_t i, std::size_t axis) const { return all[i][static_cast<Eigen::Index>(axis)]; }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};

int main() {
  using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, Points>, Points, 3>;
  const Points points{std::vector<Eigen::Vector3f>(100, Eigen::Vector3f::Zero())};
  const Tree tree(3, points);
  std::array<std::uint32_t, 5> found;
  std::array<float, 5> distances;
  return static_cast<int>(tree.knnSearch(points.all[0].data(), 5, found.data(), distances.data()));
}
