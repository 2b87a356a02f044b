#include <cstdio>
#include <functional>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "program/faults.hpp"
#include "program/keyframe_data.hpp"
#include "program/running.hpp"

#include <doctest/doctest.h>

namespace {

using namespace chainslam;
using namespace chainslam::test;

/// Times of keyframes and of the IMU, seconds, and what comes of them.
struct TimeFault {
  std::string name;
  std::function<std::string(int)> time;  ///< of a scan's or a sample's number
};

std::string decimal(double value) {
  char text[48];
  std::snprintf(text, sizeof text, "%.3f", value);
  return text;
}

std::vector<TimeFault> time_faults(double step) {
  return {{"a jump forward by 1e9 s", [=](int i) { return decimal(100 + step * i + (i >= 10 ? 1e9 : 0)); }},
          {"a jump back by 50 s", [=](int i) { return decimal(1000 + step * i - (i >= 10 ? 50 : 0)); }},
          {"a jump back by 1e9 s", [=](int i) { return decimal(2e9 + step * i - (i >= 10 ? 1e9 : 0)); }},
          {"each time twice", [=](int i) { return decimal(100 + step * (i / 2)); }},
          {"two clocks in turn", [=](int i) { return decimal(100 + step * i + (i % 2 == 1 ? 1000 : 0)); }},
          {"zeros", [](int) { return std::string("0"); }},
          {"zeros in between", [=](int i) { return i % 3 == 2 ? std::string("0") : decimal(100 + step * i); }},
          {"the year 2106", [=](int i) { return decimal(4294967290.0 + step * i); }},
          {"NaN", [=](int i) { return i == 10 ? std::string("nan") : decimal(100 + step * i); }},
          {"the end of time", [=](int i) { return i >= 10 ? "9223372036.854775807" : decimal(100 + step * i); }}};
}

/// Clouds of a place that the sensor stands in, with times and an IMU at rest.
void write_clouds(const fs::path& folder, int scans) {
  fs::create_directories(folder / "scans");
  Rng rng(1);
  for (int i = 0; i < scans; ++i) {
    PointCloud<float> cloud;
    for (int k = 0; k < 900; ++k) {
      const float along = static_cast<float>(rng.uniform(-10, 10)), height = static_cast<float>(rng.uniform(-1.5, 3));
      cloud.positions.emplace_back(k % 3 == 0 ? Eigen::Vector3f(along, 10, height)
                                   : k % 3 == 1
                                       ? Eigen::Vector3f(-10, along, height)
                                       : Eigen::Vector3f(along, static_cast<float>(rng.uniform(-10, 10)), -1.5F));
    }
    char name[32];
    std::snprintf(name, sizeof name, "%06d.pcd", i);
    write_pcd(folder / "scans" / name, cloud);
  }
}

}  // namespace

TEST_SUITE("program/time faults") {
  TEST_CASE("whatever the times of keyframes, scans and the IMU, the work is bounded, and what is left out is said") {
    const ScratchFolder scratch("times");
    const fs::path root = scratch.path(), keyframes = root / "keyframes", clouds = root / "clouds";
    write_keyframes(keyframes, 20, false, 5, 20);
    write_clouds(clouds, 20);
    int refused = 0, told = 0, runs = 0;
    const auto run = [&](const fs::path& data, const std::string& name) {
      CAPTURE(name);
      CAPTURE(data.filename().string());
      const auto begin = Clock::now();
      const ProgramResult result =
          run_program(root, "map " + quoted(data) + " --out " + quoted(root / "out"), "timeout -s KILL 20");
      CAPTURE(result.errors);
      CHECK(seconds_since(begin) < 8);
      CHECK((result.exit_code == 0 || result.exit_code == 3 || result.exit_code == 5));
      ++runs;
      if (result.exit_code == 0 || result.exit_code == 5) {
        const auto summary = summary_of(root / "out");
        CHECK(summary["keyframes"].get<int>() > 0);
        told += contains(result.errors, "note: ") || contains(result.errors, "warning: ");
        const SlamMap map = load_map(root / "out/map.cslam").map;
        for (std::size_t i = 1; i < map.keyframes.size(); ++i) CHECK(map.keyframes[i].time > map.keyframes[i - 1].time);
        for (const Keyframe& keyframe : map.keyframes) CHECK(keyframe.T_map_body.translation().norm() < 1000);
      } else {
        CHECK(three_lines(result.errors));
        CHECK(contains(result.errors, ", line "));
        ++refused;
      }
      fs::remove_all(root / "out");
      return result;
    };
    for (const TimeFault& fault : time_faults(1.5)) {
      std::string times;
      for (int i = 0; i < 20; ++i) times += fault.time(i) + "\n";
      write_text(keyframes / "times.txt", times);
      run(keyframes, fault.name);
    }
    const auto imu_of = [](const std::function<std::string(int)>& time) {
      std::string rows = "timestamp,gx,gy,gz,ax,ay,az\n";
      for (int i = 0; i < 240; ++i)
        rows += time(i) + ",0.001," + std::to_string(0.001 * (i % 3)) + ",0,0,0.01," +
                std::to_string(9.8 + 0.01 * (i % 5)) + "\n";
      return rows;
    };
    const auto fault_of_scans = time_faults(0.1), fault_of_samples = time_faults(0.01);
    for (std::size_t i = 0; i < fault_of_scans.size(); ++i) {
      std::string times, good_times;
      for (int k = 0; k < 20; ++k) {
        times += fault_of_scans[i].time(k) + "\n";
        good_times += decimal(100 + 0.1 * k) + "\n";
      }
      write_text(clouds / "times.txt", times);
      write_text(clouds / "imu.csv", imu_of([&](int k) { return decimal(100 + 0.01 * k); }));
      run(clouds, "scans: " + fault_of_scans[i].name);
      if (!full() && i % 2 == 1) continue;
      write_text(clouds / "times.txt", good_times);
      write_text(clouds / "imu.csv", imu_of(fault_of_samples[i].time));
      run(clouds, "IMU: " + fault_of_samples[i].name);
    }
    std::printf("FIGURE times that cannot be: %d runs, %d refused by file and line, %d mapped with a note\n", runs,
                refused, told);
  }
}
