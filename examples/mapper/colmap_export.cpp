#include "colmap_export.hpp"

#include "chainslam/io/detail/pose_fields.hpp"

namespace chainslam::mapper {

SE3d forward_camera() {
  Eigen::Matrix3d R_body_camera;  // columns: right, down and forward, as the body sees them
  R_body_camera << 0, 0, 1,       //
      -1, 0, 0,                   //
      0, -1, 0;
  return SE3d(SO3d::from_matrix(R_body_camera), Eigen::Vector3d::Zero());
}

void write_colmap_cameras(const FileTarget& target, const PinholeCamera& camera) {
  AtomicFile file(target);
  file.write(std::string_view("# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy\n"));
  std::string line = "1 PINHOLE " + std::to_string(camera.width) + ' ' + std::to_string(camera.height);
  for (const double value : {camera.fx, camera.fy, camera.cx, camera.cy}) {
    line += ' ';
    detail::append_number(line, value);
  }
  file.write(line += '\n');
  file.commit();
}

void write_colmap_images(const FileTarget& target, const SlamMap& map, const std::vector<SessionId>& sessions,
                         const SE3d& T_body_camera) {
  AtomicFile file(target);
  file.write(std::string_view(
      "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then a line of POINTS2D[], which is empty\n"));
  std::string lines;
  for (const SessionId id : sessions) {
    const Session& session = map.sessions[static_cast<std::size_t>(id.value)];
    for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i) {
      const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
      detail::require_finite(target, "keyframe", i, keyframe.T_map_body);
      const SE3d T_camera_map = (keyframe.T_map_body * T_body_camera).inverse();
      const auto& q = T_camera_map.rotation().quaternion();
      lines = std::to_string(i + 1);
      for (const double value : {q.w(), q.x(), q.y(), q.z()}) {
        lines += ' ';
        detail::append_number(lines, value);
      }
      detail::append_position(lines, T_camera_map.translation());
      lines += " 1 " + std::to_string(id.value) + '/' + std::to_string(keyframe.time.nanoseconds()) + ".png\n\n";
      file.write(lines);
    }
  }
  file.commit();
}

void write_colmap_points(const FileTarget& target, const PointCloud<float>& cloud) {
  AtomicFile file(target);
  file.write(std::string_view("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n"));
  std::string line;
  for (std::size_t i = 0; i < cloud.size(); ++i) {
    line = std::to_string(i + 1);
    for (int axis = 0; axis < 3; ++axis) {
      line += ' ';
      detail::append_number(line, cloud.positions[i][axis]);
    }
    file.write(line += " 128 128 128 -1\n");
  }
  file.commit();
}

}  // namespace chainslam::mapper
