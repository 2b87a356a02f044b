#include "chainslam/odometry/lidar_odometry.hpp"

namespace chainslam {

template class LidarOdometry<>;
template std::optional<Frame> LidarOdometry<>::process(const Packet&, const Serial&);
template std::optional<Frame> LidarOdometry<>::process(const Packet&, const ThreadPool&);

}  // namespace chainslam
