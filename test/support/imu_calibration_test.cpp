#include "support/imu_calibration.hpp"

#include <doctest/doctest.h>

#include <numbers>
#include <string>

#include "support/summary.hpp"

namespace chainslam::support {
namespace {

constexpr double degree = std::numbers::pi / 180;

bool tells(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

/// A session whose data show clock and axes to 3 ms and 0.3 deg, and agree with what was given.
ImuCalibration agreeing() {
  ImuCalibration calibration;
  calibration.T_body_lidar = SE3d(SO3d::exp({0, 0, 0.1}), {1, 2, 3});
  ImuAlignmentEstimate& found = calibration.found;
  found.time_offset_deviation = 0.003;
  found.R_body_lidar = calibration.T_body_lidar.rotation();
  found.rotation_covariance = Eigen::Vector3d(0.3, 0.1, 0.2).cwiseAbs2().asDiagonal();
  found.rotation_covariance *= degree * degree;
  found.time_known = found.rotation_known = true;
  found.observed_rotation_axes = 3;
  found.seconds_used = 42;
  return calibration;
}

}  // namespace

TEST_SUITE("support/imu_calibration") {
  TEST_CASE("what was given and is right needs no word") {
    const ImuCalibration calibration = agreeing();
    CHECK(calibration_notes(calibration).empty());
    CHECK(contradictions(calibration).empty());
    CHECK(rotation_deviation(calibration.found) == doctest::Approx(0.3 * degree));
    CHECK(time_offset_text(calibration) == "0.000 s (+- 0.003)");
    CHECK(rotation_text(calibration) == "roll 0.0, pitch 0.0, yaw 5.7 deg (+- 0.3)");
  }

  TEST_CASE("angles are those that dataset.T_body_lidar takes: about z, then the new y, then the new x") {
    const SO3d R = SO3d::exp({0, 0, 30 * degree}) * SO3d::exp({0, -20 * degree, 0}) * SO3d::exp({10 * degree, 0, 0});
    const Eigen::Vector3d angles = roll_pitch_yaw_deg(R);
    CHECK((angles - Eigen::Vector3d(10, -20, 30)).norm() < 1e-9);
  }

  TEST_CASE("stamps that are late ask for a negative imu.time_offset, on top of the one that was set") {
    ImuCalibration calibration = agreeing();
    calibration.found.time_offset = 0.0671;
    calibration.follow({.time_offset = 0.064, .R_body_imu = {}}, 8);
    calibration.follow({.time_offset = 0.067, .R_body_imu = {}}, 20);  // refined: since 8 s it is about right
    REQUIRE(calibration_notes(calibration).size() == 1);
    CHECK(calibration_notes(calibration)[0] ==
          "IMU stamps are 67 ms late (+- 3): corrected from 8.0 s on; set imu.time_offset = -0.067 to start with the "
          "right one");
    CHECK(contradictions(calibration)[0] ==
          "IMU stamps are 67 ms late (+- 3): set imu.time_offset = -0.067 to start with the right one");
    calibration.time_offset = 0.02;
    CHECK(calibration.found_time_offset() == doctest::Approx(-0.0471));
    CHECK(tells(calibration_notes(calibration)[0], "with imu.time_offset = 0.020, IMU stamps are still 67 ms late"));
    CHECK(tells(calibration_notes(calibration)[0], "set imu.time_offset = -0.047"));
    calibration.found.time_offset = 0.009;  // what undistorted scans leave
    CHECK(contradictions(calibration).empty());
    calibration.found.time_offset = -0.05;
    calibration.follow({.time_offset = -0.05, .R_body_imu = {}}, 30);
    CHECK(tells(calibration_notes(calibration)[0], "50 ms early (+- 3): corrected from 30.0 s on"));
  }

  TEST_CASE("turned axes: the setting that is named has the effect of the correction") {
    ImuCalibration calibration = agreeing();
    const SO3d R_body_imu = SO3d::exp({0, 0, 90 * degree});
    calibration.found.R_body_lidar = R_body_imu.inverse() * calibration.T_body_lidar.rotation();
    calibration.found.contradicted = true;
    calibration.follow({.time_offset = 0, .R_body_imu = R_body_imu}, 12.3);
    const std::vector<std::string> notes = calibration_notes(calibration);
    REQUIRE(notes.size() == 1);
    CHECK(tells(notes[0],
                "the IMU's axes are turned by 90.0 deg (+- 0.3) about (0.00 0.00 1.00) against the given "
                "T_body_lidar: corrected from 12.3 s on; set dataset.T_body_lidar = [2.000, -1.000, 3.000, "));
    REQUIRE(contradictions(calibration).size() == 1);
    CHECK(tells(contradictions(calibration)[0], "set dataset.T_body_lidar = [2.000, -1.000, 3.000, "));
    // A point of the LiDAR seen from the IMU's own axes.
    const Eigen::Vector3d p(4, 5, 6);
    CHECK((calibration.applied_T_body_lidar() * p - R_body_imu.inverse() * (calibration.T_body_lidar * p)).norm() <
          1e-12);
    CHECK(calibration.applied_T_body_lidar().rotation().local(calibration.found.R_body_lidar).norm() < 1e-12);
    calibration.extrinsic_given = false;
    CHECK(tells(calibration_notes(calibration)[0], "(no T_body_lidar is given)"));
  }

  TEST_CASE("a correction of the axes that later data do not bear out names no setting") {
    ImuCalibration calibration = agreeing();
    calibration.follow({.time_offset = 0, .R_body_imu = SO3d::exp({0, 0, 3.5 * degree})}, 27.5);
    const std::vector<std::string> notes = calibration_notes(calibration);
    REQUIRE(notes.size() == 1);
    CHECK(tells(notes[0],
                "taken to be turned by 3.5 deg: corrected from 27.5 s on; by all of the data T_body_lidar is "
                "right to 0.0 deg (+- 0.3)"));
    CHECK_FALSE(tells(notes[0], "set dataset.T_body_lidar"));
  }

  TEST_CASE("a contradiction that the motion does not fully show is told, but not corrected") {
    ImuCalibration calibration = agreeing();
    calibration.found.contradicted = true;
    calibration.found.contradiction_angle = 10 * degree;
    calibration.found.rotation_covariance = Eigen::Vector3d(0.1, 0.01, 0.1).cwiseAbs2().asDiagonal();  // rad^2
    calibration.found.rotation_known = false;
    calibration.found.observed_rotation_axes = 1;
    for (const auto& sentences : {calibration_notes(calibration), contradictions(calibration)}) {
      REQUIRE(sentences.size() == 1);
      CHECK(tells(sentences[0], "by at least 10.0 deg against the given T_body_lidar: the motion does not show all"));
    }
    CHECK(tells(rotation_text(calibration), "1 of 3 axes well shown"));
    calibration.found = {};
    CHECK(tells(time_offset_text(calibration), "the motion does not show it"));
  }

  TEST_CASE("summary.json has offset and rotation as the settings take them, with deviations") {
    ImuCalibration calibration = agreeing();
    calibration.time_offset = 0.01;
    calibration.found.time_offset = 0.05;
    calibration.follow({.time_offset = 0.048, .R_body_imu = SO3d::exp({0, 0, 0.2})}, 7.5);
    RunSummary summary;
    summary.sessions = {{.name = "drive", .calibration = calibration}};
    const std::string json = summary_json(summary);
    for (const char* part :
         {"\"time_offset\": -0.04", "\"time_offset_deviation\": 0.003", "\"time_offset_known\": true",
          "\"time_offset_applied\": -0.038", "\"time_offset_applied_from_s\": 7.5", "\"roll_pitch_yaw_deg\"",
          "\"deviation_deg\": 0.3", "\"rotation_contradicted\": false", "\"rotation_applied_from_s\": 7.5",
          "\"seconds_used\": 42.0"})
      CHECK_MESSAGE(tells(json, part), part, " in ", json);
  }
}

}  // namespace chainslam::support
