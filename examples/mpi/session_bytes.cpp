#include <nlohmann/json.hpp>
#include <utility>

#include "session_task.hpp"

// Tasks and results as JSON on one line. Numbers are written as short as they read back the same.

namespace chainslam::mpi {

namespace {

using Json = nlohmann::json;

std::string line_of(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

Json json_of(const IoError& error) {
  const IoError::Report& report = error.report();
  return {{"kind", error.kind() == IoError::Kind::input ? "input" : "output"},
          {"path", report.path},
          {"place", report.place},
          {"found", report.found},
          {"remedy", report.remedy}};
}

IoError error_of_json(const Json& json) {
  return {json.at("kind") == "input" ? IoError::Kind::input : IoError::Kind::output,
          {json.at("path"), json.at("place"), json.at("found"), json.at("remedy")}};
}

constexpr std::int64_t ImuCheckCounts::*imu_counts[] = {
    &ImuCheckCounts::received,      &ImuCheckCounts::not_finite, &ImuCheckCounts::out_of_range,
    &ImuCheckCounts::spikes,        &ImuCheckCounts::repeated,   &ImuCheckCounts::out_of_order,
    &ImuCheckCounts::invalid_times, &ImuCheckCounts::second_imu, &ImuCheckCounts::stuck_gyro,
    &ImuCheckCounts::stuck_accel,   &ImuCheckCounts::from_g,     &ImuCheckCounts::from_degrees};
static_assert(sizeof(ImuCheckCounts) == std::size(imu_counts) * sizeof(std::int64_t), "name the new count above");

/// Calls `visit` with each number of a calibration, in a fixed order.
template <class Calibration, class Visit>
void visit_numbers(Calibration& calibration, const Visit& visit) {
  auto& found = calibration.found;
  for (auto* number :
       {&calibration.time_offset, &found.time_offset, &found.time_offset_deviation, &found.contradiction_angle,
        &found.seconds_used, &calibration.applied.time_offset, &calibration.scan_time_deviation})
    visit(*number);
  for (auto* matrix : {&found.rotation_covariance, &found.gyro_bias_covariance, &found.accel_bias_covariance})
    for (Eigen::Index i = 0; i < matrix->size(); ++i) visit(matrix->data()[i]);
  for (auto* vector : {&found.gyro_bias, &found.accel_bias, &found.up_odom})
    for (Eigen::Index i = 0; i < vector->size(); ++i) visit(vector->data()[i]);
  for (auto* flag : {&calibration.extrinsic_given, &found.time_known, &found.rotation_known, &found.contradicted})
    visit(*flag);
  visit(found.observed_rotation_axes);
  for (auto* time : {&calibration.clock_corrected, &calibration.axes_corrected}) visit(*time);
}

Json json_of(const SO3d& rotation) {
  const auto& q = rotation.quaternion();
  return {q.w(), q.x(), q.y(), q.z()};
}

SO3d rotation_of(const Json& json) {
  return SO3d::from_quaternion(Eigen::Quaterniond(json.at(0), json.at(1), json.at(2), json.at(3)));
}

struct WriteNumber {
  Json& numbers;
  template <class Number>
  void operator()(const Number& number) const {
    numbers.push_back(number);
  }
  void operator()(const std::optional<double>& number) const { numbers.push_back(number ? Json(*number) : Json()); }
};

struct ReadNumber {
  Json::const_iterator& at;
  template <class Number>
  void operator()(Number& number) const {
    number = (at++)->template get<Number>();
  }
  void operator()(std::optional<double>& number) const {
    const Json& json = *at++;
    if (!json.is_null()) number = json.get<double>();
  }
};

Json json_of(const support::ImuCalibration& calibration) {
  Json numbers = Json::array();
  visit_numbers(calibration, WriteNumber{numbers});
  const Eigen::Vector3d& p = calibration.T_body_lidar.translation();
  return {{"numbers", numbers},
          {"R_body_lidar", json_of(calibration.T_body_lidar.rotation())},
          {"p_body_lidar", {p.x(), p.y(), p.z()}},
          {"found", json_of(calibration.found.R_body_lidar)},
          {"applied", json_of(calibration.applied.R_body_imu)}};
}

support::ImuCalibration calibration_of(const Json& json) {
  support::ImuCalibration calibration{};
  Json::const_iterator number = json.at("numbers").begin();
  visit_numbers(calibration, ReadNumber{number});
  const Json& p = json.at("p_body_lidar");
  calibration.T_body_lidar = SE3d(rotation_of(json.at("R_body_lidar")), Eigen::Vector3d(p.at(0), p.at(1), p.at(2)));
  calibration.found.R_body_lidar = rotation_of(json.at("found"));
  calibration.applied.R_body_imu = rotation_of(json.at("applied"));
  return calibration;
}

}  // namespace

tasks::Bytes bytes_of(const SessionTask& task) {
  return line_of({{"data", task.data},
                  {"set", task.set.string()},
                  {"configuration", task.configuration},
                  {"input", task.input},
                  {"max_scans", task.max_scans},
                  {"threads", task.threads},
                  {"max_memory", task.max_memory}});
}

SessionTask task_of(const tasks::Bytes& bytes) {
  const Json json = Json::parse(bytes);
  return {.data = json.at("data"),
          .set = json.at("set").get<std::string>(),
          .configuration = json.at("configuration"),
          .input = json.at("input"),
          .max_scans = json.at("max_scans"),
          .threads = json.at("threads"),
          .max_memory = json.at("max_memory")};
}

tasks::Bytes bytes_of(const SessionResult& result) {
  Json json = {{"session", result.run.name}, {"scans", result.run.scans},   {"frames", result.frames},
               {"notes", result.run.notes},  {"warnings", result.warnings}, {"imu", Json::array()}};
  for (const auto count : imu_counts) json["imu"].push_back(result.run.imu.*count);
  if (result.run.calibration) json["calibration"] = json_of(*result.run.calibration);
  if (result.run.failure) json["failure"] = json_of(*result.run.failure);
  return line_of(json);
}

SessionResult result_of(const tasks::Bytes& bytes) {
  const Json json = Json::parse(bytes);
  SessionResult result;
  result.run.name = json.at("session");
  result.run.scans = json.at("scans");
  result.frames = json.at("frames");
  result.run.notes = json.at("notes").get<std::vector<std::string>>();
  result.warnings = json.at("warnings").get<std::vector<std::string>>();
  std::size_t i = 0;
  for (const auto count : imu_counts) result.run.imu.*count = json.at("imu").at(i++);
  if (json.contains("calibration")) result.run.calibration = calibration_of(json["calibration"]);
  if (json.contains("failure")) result.run.failure = error_of_json(json["failure"]);
  return result;
}

tasks::Bytes bytes_of(const IoError& error) { return line_of(json_of(error)); }

std::optional<IoError> error_of(const tasks::Bytes& bytes) {
  const Json json = Json::parse(bytes, nullptr, false);
  if (!json.is_object() || !json.contains("kind")) return std::nullopt;
  return error_of_json(json);
}

}  // namespace chainslam::mpi
