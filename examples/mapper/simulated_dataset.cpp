#include "simulated_dataset.hpp"

#include <charconv>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "recorded_simulation.hpp"
#include "simulator/preset_description.hpp"
#include "simulator/town_drive.hpp"
#include "support/configuration.hpp"
#include "support/nearest_name.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

constexpr std::string_view prefix = "simulate:";

class SimulatedDataset final : public datasets::Dataset {
 public:
  SimulatedDataset(const simulator::Preset& preset, std::uint64_t seed, std::size_t session, std::string name)
      : drive_(preset, seed, session) {
    info_.truth_frame = preset.name + ", seed " + std::to_string(seed);
    info_.name = std::move(name);
    info_.start = drive_.epoch();
    info_.end = drive_.end();
    info_.T_body_lidar = preset.lidar.T_body_lidar;
    info_.p_body_antenna = preset.gnss.antenna_body;
    const std::string lidar(drive_.lidar().model().name);
    info_.sensors = {{lidar, SensorKind::lidar, static_cast<std::size_t>(drive_.scan_count()), "simulated"},
                     {"IMU", SensorKind::imu, drive_.imu().size(), "simulated"},
                     {"GNSS receiver", SensorKind::gnss, std::nullopt, "simulated"}};
    info_.source = "simulated";
    info_.notes = {"simulated while it is read: " + preset.summary,
                   "options of the simulation: " + simulator::options_hash(preset)};
  }

  [[nodiscard]] std::optional<Packet> next() override { return drive_.next(); }
  [[nodiscard]] std::optional<Trajectory> truth() const override { return drive_.truth_at_scan_ends(); }

 private:
  simulator::TownDrive drive_;
};

/// Takes what follows a key off the parts of a name, such as "wind" of the last part "without=wind".
std::optional<std::string> taken(std::vector<std::string_view>& parts, std::string_view key) {
  if (parts.empty() || !parts.back().starts_with(key)) return std::nullopt;
  const std::string value(parts.back().substr(key.size()));
  parts.pop_back();
  return value;
}

std::vector<std::string_view> parts_of(std::string_view text) {
  std::vector<std::string_view> parts;
  for (std::size_t end = 0; end != std::string_view::npos; text.remove_prefix(end + 1)) {
    end = text.find('/');
    parts.push_back(text.substr(0, end));
    if (end == std::string_view::npos) break;
  }
  return parts;
}

std::optional<std::uint64_t> number(std::string_view text) {
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() ? std::optional(value) : std::nullopt;
}

}  // namespace

std::unique_ptr<datasets::Dataset> open_simulation(std::string_view name) {
  if (!name.starts_with(prefix)) return nullptr;
  const auto refuse = [&](const char* what, const std::string& hint = "") -> std::unique_ptr<datasets::Dataset> {
    throw support::ConfigError(
        "map", what, std::string(name) + hint,
        "write simulate:PRESET/SIZE/SESSION[/SEED][/errors=NAMES][/without=NAMES], such as "
        "simulate:nclt-like/medium/1, or simulate:FOLDER with what simulate --trajectory has written");
  };
  if (auto recorded = open_recorded_simulation(name.substr(prefix.size()))) return recorded;
  std::vector<std::string_view> parts = parts_of(name.substr(prefix.size()));
  const std::string without = taken(parts, "without=").value_or("");
  const std::string errors = taken(parts, "errors=").value_or("all");
  if (parts.size() < 3 || parts.size() > 4) return refuse("that names no simulated session");
  const auto size = simulator::preset_size(parts[1]);
  if (!size)
    return refuse("there is no such size", support::suggestion(parts[1], {"small", "medium", "large", "full"}));
  const auto preset = simulator::preset(parts[0], *size);
  if (!preset)
    return refuse("there is no such preset", support::suggestion(parts[0], support::names_of_list(known_presets())));
  const auto session = number(parts[2]);
  const auto seed = parts.size() == 4 ? number(parts[3]) : std::optional<std::uint64_t>(1);
  if (!session || *session < 1 || *session > preset->sessions.size()) return refuse("the preset has no such session");
  if (!seed) return refuse("the seed is no number");
  return std::make_unique<SimulatedDataset>(with_error_sources(*preset, errors, without), *seed,
                                            static_cast<std::size_t>(*session - 1),
                                            preset->name + "-" + std::string(parts[2]));
}

}  // namespace chainslam::mapper
