#include "datasets/transform_tree.hpp"

#include <cmath>
#include <utility>

#include "chainslam/core/types.hpp"

namespace chainslam::datasets {
namespace {

/// tf of ROS 1 wrote frames as /base, tf2 writes base.
std::string plain(std::string name) {
  if (name.starts_with('/')) name.erase(0, 1);
  return name;
}

}  // namespace

void TransformTree::add(MessageReader message) {
  const auto count = message.count(64, "transforms");
  for (std::uint32_t i = 0; i < count; ++i) {
    const RosHeader header = read_header(message);
    std::string child = plain(message.text("child_frame_id"));
    const auto t = message.doubles<3>("translation");
    const auto q = message.doubles<4>("rotation");
    const Eigen::Quaterniond rotation(q[3], q[0], q[1], q[2]);
    const Eigen::Vector3d translation(t[0], t[1], t[2]);
    if (!(std::abs(rotation.norm() - 1) < 0.01) || !is_finite(translation)) continue;
    parents_.insert_or_assign(
        std::move(child), Parent{plain(header.frame), SE3d(SO3d::from_quaternion(rotation.normalized()), translation)});
  }
}

TransformTree::Parent TransformTree::root_of(std::string name) const {
  Parent root{plain(std::move(name)), SE3d()};
  for (std::size_t steps = 0; steps <= parents_.size(); ++steps) {  // statements may go round in a circle
    const auto parent = parents_.find(root.name);
    if (parent == parents_.end()) break;
    root = {parent->second.name, parent->second.T_parent_child * root.T_parent_child};
  }
  return root;
}

std::optional<SE3d> TransformTree::between(const std::string& a, const std::string& b) const {
  const Parent of_a = root_of(a), of_b = root_of(b);
  if (of_a.name != of_b.name) return std::nullopt;
  return of_a.T_parent_child.inverse() * of_b.T_parent_child;
}

}  // namespace chainslam::datasets
