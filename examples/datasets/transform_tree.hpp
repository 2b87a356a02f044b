#pragma once

#include <map>
#include <optional>
#include <string>

#include "chainslam/lie/se3.hpp"
#include "datasets/ros_message.hpp"

namespace chainslam::datasets {

/// Where frames that do not move sit on each other, as the messages on /tf_static state it.
class TransformTree {
 public:
  /// Takes a tf2_msgs/TFMessage; of two statements on one child the later holds. Names may begin with a slash.
  /// Statements that are no motion are left out. @throws MessageError if it is cut short.
  void add(MessageReader message);

  /// T_a_b, if both frames hang together.
  [[nodiscard]] std::optional<SE3d> between(const std::string& a, const std::string& b) const;

 private:
  struct Parent {
    std::string name;
    SE3d T_parent_child;
  };

  /// The last frame above `name`, and T_last_name.
  [[nodiscard]] Parent root_of(std::string name) const;

  std::map<std::string, Parent> parents_;  ///< of each child
};

}  // namespace chainslam::datasets
