#include "drive_choice.hpp"

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/input_stream.hpp"
#include "simulator/lidar_model.hpp"

namespace chainslam::mapper {

namespace {

/// A number that the command line would have taken.
double number_within(const nlohmann::json& json, const char* key, double least, double most) {
  const double value = json.at(key).get<double>();
  if (!(value >= least && value <= most)) throw std::out_of_range(std::string(key) + " = " + std::to_string(value));
  return value;
}

std::uint64_t seed_of(const nlohmann::json& json) {
  const nlohmann::json& seed = json.at("seed");
  if (!seed.is_number_unsigned()) throw std::out_of_range("seed = " + seed.dump());
  return seed.get<std::uint64_t>();
}

std::string lidar_of(const nlohmann::json& json) {
  const std::string name = json.at("lidar");
  if (!simulator::lidar_kind(name)) throw std::out_of_range("lidar = " + name);
  return name;
}

DriveChoice choice_of(const nlohmann::json& json) {
  const auto pose = json.at("T_body_lidar").get<std::array<double, 7>>();
  const Eigen::Quaterniond q(pose[6], pose[3], pose[4], pose[5]);
  const Eigen::Vector3d t(pose[0], pose[1], pose[2]);
  if (!(std::abs(q.norm() - 1) < 1e-3 && t.norm() < 100)) throw std::out_of_range("T_body_lidar is no pose");
  return {.lidar = lidar_of(json),
          .columns = static_cast<int>(number_within(json, "columns", 36, 8192)),
          .lidar_height = number_within(json, "lidar_height", 0.2, 10.0),
          .seed = seed_of(json),
          .recorded_imu = json.at("recorded_imu"),
          .others = static_cast<std::size_t>(json.contains("others") ? number_within(json, "others", 0, 1000) : 0),
          .gnss = json.value("gnss", false),
          .T_body_lidar = SE3d(SO3d::from_quaternion(q.normalized()), t)};
}

}  // namespace

std::string text_of(const DriveChoice& choice) {
  const SE3d& T = choice.T_body_lidar;
  const auto& q = T.rotation().quaternion();
  const std::array<double, 7> pose{
      T.translation().x(), T.translation().y(), T.translation().z(), q.x(), q.y(), q.z(), q.w()};
  return nlohmann::json{{"lidar", choice.lidar},
                        {"columns", choice.columns},
                        {"lidar_height", choice.lidar_height},
                        {"seed", choice.seed},
                        {"recorded_imu", choice.recorded_imu},
                        {"T_body_lidar", pose},
                        {"others", choice.others},
                        {"gnss", choice.gnss}}
             .dump(2) +
         "\n";
}

DriveChoice read_choice(const std::filesystem::path& path) {
  try {
    auto file = detail::input_stream(path);
    return choice_of(nlohmann::json::parse(file));
  } catch (const std::out_of_range& error) {
    throw_input_error(path.string(), "", error.what(), "simulate the drive again");
  } catch (const nlohmann::json::exception& error) {
    throw_input_error(path.string(), "", error.what(), "simulate the drive again");
  }
}

}  // namespace chainslam::mapper
