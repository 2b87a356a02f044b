#include "chainslam/odometry/lidar_inertial_odometry.hpp"

namespace chainslam {

template class LidarInertialOdometry<>;
template std::optional<Frame> LidarInertialOdometry<>::process(const Packet&, const Serial&);
template std::optional<Frame> LidarInertialOdometry<>::process(const Packet&, const ThreadPool&);
template std::optional<Frame> LidarInertialOdometry<>::flush(const Serial&);
template std::optional<Frame> LidarInertialOdometry<>::flush(const ThreadPool&);

}  // namespace chainslam
