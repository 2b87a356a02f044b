#include "read_ahead.hpp"

#include <utility>
#include <variant>

namespace chainslam::datasets {

ReadAhead::ReadAhead(std::function<std::optional<Packet>()> read, Index scans)
    : read_(std::move(read)), scans_(scans), thread_([this](const std::stop_token& stop) { run(stop); }) {}

std::optional<Packet> ReadAhead::next() {
  while (next_ == taken_.size()) {
    std::optional<Packets> packets = read_ahead_.pop();
    if (!packets && failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
    if (!packets) return std::nullopt;
    taken_ = std::move(*packets);
    next_ = 0;
  }
  return std::move(taken_[next_++]);
}

void ReadAhead::run(const std::stop_token& stop) {
  for (bool more = true; more;) {
    Packets packets;
    try {
      more = read_to_scan(packets, stop);
    } catch (...) {
      failure_ = std::current_exception();
      more = false;
    }
    if (!read_ahead_.push(std::move(packets), stop)) break;
  }
  read_ahead_.close();
}

bool ReadAhead::read_to_scan(Packets& packets, const std::stop_token& stop) {
  constexpr std::size_t most = 1000;  // where scans are far apart
  while (!stop.stop_requested() && packets.size() < most) {
    std::optional<Packet> packet = read_();
    if (!packet) return false;
    packets.push_back(std::move(*packet));
    if (std::holds_alternative<LidarScan>(packets.back())) return ++read_scans_ != scans_;
  }
  return !stop.stop_requested();
}

}  // namespace chainslam::datasets
