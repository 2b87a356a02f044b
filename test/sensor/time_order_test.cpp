#include "chainslam/sensor/time_order.hpp"

#include <doctest/doctest.h>

#include <string>
#include <vector>

using namespace chainslam;

namespace {

Timestamp at(double time) { return Timestamp::from_seconds(time); }
Packet imu(double time) { return ImuSample{.time = at(time)}; }
Packet gnss(double time) { return GnssFix{.time = at(time)}; }
Packet scan(double begin, double end) { return LidarScan{.time = at(begin), .end = at(end), .cloud = {}}; }

std::string name(const Packet& packet) {
  const char* names[] = {"imu ", "scan ", "gnss "};
  return names[packet.index()] + std::to_string(available_at(packet).nanoseconds() / 1'000'000);
}

std::vector<std::string> drain(TimeOrder& order) {
  std::vector<std::string> names;
  while (const auto packet = order.pop()) names.push_back(name(*packet));
  return names;
}

using Names = std::vector<std::string>;

}  // namespace

TEST_SUITE("sensor/time_order") {
  TEST_CASE("nothing in, nothing out") {
    TimeOrder order;
    CHECK_FALSE(order.pop());
    order.finish();
    CHECK_FALSE(order.pop());
  }

  TEST_CASE("sensors merge by the time at which a packet was whole: a scan counts at its end") {
    TimeOrder order;
    order.push(scan(1.00, 1.10));
    order.push(gnss(1.05));
    for (int i = 0; i <= 12; i += 4) order.push(imu(1.0 + 0.01 * i));
    order.finish();
    CHECK(drain(order) == Names{"imu 1000", "imu 1040", "gnss 1050", "imu 1080", "scan 1100", "imu 1120"});
    CHECK(order.report().delivered == std::array<std::size_t, 3>{4, 1, 1});
    CHECK(order.report().late == std::array<std::size_t, 3>{0, 0, 0});
  }

  TEST_CASE("equal times come as IMU, LiDAR, GNSS, and one kind as it came in") {
    TimeOrder order;
    order.push(gnss(1));
    order.push(scan(0.9, 1));
    order.push(imu(1));
    order.push(scan(0.8, 1));
    order.finish();
    CHECK(std::get<ImuSample>(*order.pop()).time == at(1));
    CHECK(std::get<LidarScan>(*order.pop()).time == at(0.9));
    CHECK(std::get<LidarScan>(*order.pop()).time == at(0.8));
    CHECK(std::holds_alternative<GnssFix>(*order.pop()));
    CHECK(order.report().repeated == std::array<std::size_t, 3>{0, 1, 0});
  }

  TEST_CASE("a packet waits for the delay and no longer") {
    TimeOrder order({.delay = std::chrono::milliseconds(100)});
    order.push(imu(1.0));
    order.push(imu(1.099));
    CHECK_FALSE(order.pop());
    order.push(imu(1.1));
    CHECK(drain(order) == Names{"imu 1000"});
    CHECK(order.waiting() == 2);
  }

  TEST_CASE("what comes within the delay is put in place, what comes later is dropped and counted") {
    TimeOrder order({.delay = std::chrono::milliseconds(100)});
    order.push(imu(1.0));
    order.push(imu(1.2));
    CHECK(drain(order) == Names{"imu 1000"});
    order.push(imu(1.1));   // behind imu 1200, ahead of what was delivered
    order.push(gnss(0.9));  // behind what was delivered
    order.finish();
    CHECK(drain(order) == Names{"imu 1100", "imu 1200"});
    CHECK(order.report().reordered == std::array<std::size_t, 3>{1, 0, 0});
    CHECK(order.report().late == std::array<std::size_t, 3>{0, 0, 1});
    CHECK(order.report().breaks.empty());
  }

  TEST_CASE("a full buffer gives its earliest without waiting, and says so") {
    TimeOrder order({.delay = std::chrono::hours(1), .capacity = 3});
    for (int i = 0; i < 5; ++i) order.push(imu(1 + 0.01 * i));
    CHECK(drain(order) == Names{"imu 1000", "imu 1010"});
    CHECK(order.waiting() == 3);
    CHECK(order.report().hurried == 2);
  }

  TEST_CASE("scans whose stamps stand still do not gather") {
    TimeOrder order{{.scan_capacity = 3}};
    std::size_t delivered = 0;
    for (int i = 0; i < 50; ++i) {
      order.push(imu(1.5));
      order.push(scan(1.4, 1.5));
      while (order.pop()) ++delivered;
      CHECK(order.waiting() <= 3 + 50);
    }
    CHECK(order.report().hurried == delivered);
    CHECK(order.report().repeated == std::array<std::size_t, 3>{49, 49, 0});
    CHECK(TimeOrderOptions{}.scan_capacity * 2'000'000 < std::size_t{1} << 30);  // of the usual 2 MB: below 1 GiB
    order.finish();
    while (order.pop()) ++delivered;
    CHECK(delivered == 100);
  }

  TEST_CASE("gaps are reported for each sensor by its own measure, and nothing is lost") {
    TimeOrder order;
    order.push(imu(1));
    order.push(imu(1.5));
    order.push(scan(0, 1));
    order.push(scan(3600, 3601));
    order.push(gnss(1));
    order.push(gnss(9));  // a GNSS may be silent for as long
    order.finish();
    CHECK(drain(order).size() == 6);
    REQUIRE(order.report().breaks.size() == 2);
    const TimeBreak& first = order.report().breaks[0];
    CHECK(first.kind == TimeBreak::Kind::gap);
    CHECK(first.sensor == SensorKind::imu);
    CHECK(first.before == at(1));
    CHECK(first.after == at(1.5));
    CHECK(order.report().breaks[1].sensor == SensorKind::lidar);
    CHECK(order.report().gaps == std::array<std::size_t, 3>{1, 1, 0});
  }

  TEST_CASE("a clock set back 67 s is reported, what waited comes out first, and the order begins anew") {
    TimeOrder order({.delay = std::chrono::milliseconds(50)});
    for (int i = 0; i < 5; ++i) order.push(imu(100 + 0.01 * i));
    CHECK_FALSE(order.pop());
    order.push(imu(33));
    order.push(imu(33.01));
    CHECK(drain(order) == Names{"imu 100000", "imu 100010", "imu 100020", "imu 100030", "imu 100040"});
    order.push(imu(33.07));
    CHECK(drain(order) == Names{"imu 33000", "imu 33010"});
    REQUIRE(order.report().breaks.size() == 1);
    CHECK(order.report().breaks[0].kind == TimeBreak::Kind::backward_jump);
    CHECK(order.report().breaks[0].before == at(100.04));
    CHECK(order.report().breaks[0].after == at(33));
    CHECK(order.report().late == std::array<std::size_t, 3>{0, 0, 0});
  }

  TEST_CASE("when two sensors' clocks are set back one after the other, the order recovers with the second") {
    TimeOrder order({.delay = std::chrono::milliseconds(50)});
    std::size_t delivered = 0;
    const auto send = [&](Packet packet) {
      order.push(std::move(packet));
      delivered += drain(order).size();
    };
    for (int i = 0; i < 100; ++i) {
      const double time = 0.01 * i;
      send(imu(i < 40 ? 100 + time : 33 + time));
      if (i % 10 == 9) send(scan((i < 60 ? 100 : 33) + time - 0.09, (i < 60 ? 100 : 33) + time));
    }
    order.finish();
    delivered += drain(order).size();
    CHECK(order.report().backward_jumps == std::array<std::size_t, 3>{1, 1, 0});
    CHECK(order.report().late[1] == 0);
    CHECK(order.report().late[0] < 20);  // between the two jumps only
    CHECK(delivered + order.report().late[0] == 110);
  }

  TEST_CASE("one stamp an hour ahead costs nothing else") {
    TimeOrder order({.delay = std::chrono::milliseconds(50)});
    for (int i = 0; i < 10; ++i) order.push(imu(i == 5 ? 3700 : 100 + 0.01 * i));
    order.finish();
    CHECK(drain(order).size() == 10);
    CHECK(order.report().gaps[0] == 1);
    CHECK(order.report().backward_jumps[0] == 1);
  }

  TEST_CASE("two sensors of one kind are watched apart") {
    TimeOrder order;
    for (int i = 0; i < 4; ++i) {
      order.push(scan(i, i + 0.1), 0);
      order.push(scan(i + 0.5, i + 0.6), 1);
    }
    order.push(scan(5, 5.1), 1);
    CHECK(order.report().gaps[1] == 1);
    CHECK(order.report().breaks[0].number == 1);
  }

  TEST_CASE("breaks beyond those kept are still counted") {
    TimeOrder order({.kept_breaks = 2});
    for (int i = 0; i < 10; ++i) order.push(imu(i));
    CHECK(order.report().breaks.size() == 2);
    CHECK(order.report().gaps[0] == 9);
  }

  TEST_CASE("a caller's mistakes are refused") {
    TimeOrder order;
    CHECK_THROWS_AS(order.push(scan(2, 1)), std::invalid_argument);
    order.finish();
    CHECK_THROWS_AS(order.push(imu(1)), std::invalid_argument);
  }
}
