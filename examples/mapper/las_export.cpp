#include "las_export.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/version.hpp"
#include "chainslam/io/las.hpp"
#include "datasets/geodesy.hpp"
#include "placed_points.hpp"

namespace chainslam::mapper {

namespace {

/// Seconds that GPS time is ahead of UTC, from these Unix times on (IERS Bulletin C).
constexpr std::array<std::pair<std::int64_t, int>, 6> leap_seconds = {
    {{915148800, 13}, {1136073600, 14}, {1230768000, 15}, {1341100800, 16}, {1435708800, 17}, {1483228800, 18}}};
constexpr std::int64_t gps_epoch = 315964800;  // 1980-01-06, Unix time

/// Whether all times can be Unix times: a clock of its own begins with its power.
bool is_utc(const SlamMap& map) {
  return std::ranges::all_of(map.keyframes, [](const Keyframe& keyframe) {
    return keyframe.time.nanoseconds() / 1'000'000'000 >= leap_seconds.front().first;
  });
}

/// Seconds, exact to a microsecond: as GPS time minus 1e9, or as they are.
double las_time(Timestamp time, bool utc) {
  const std::int64_t whole = time.nanoseconds() / 1'000'000'000, rest = time.nanoseconds() % 1'000'000'000;
  if (!utc) return time.to_seconds();
  int ahead = 0;
  for (const auto& [since, leap] : leap_seconds)
    if (whole >= since) ahead = leap;
  return static_cast<double>(whole - gps_epoch + ahead - 1'000'000'000) + 1e-9 * static_cast<double>(rest);
}

/// Where the frame of some sessions lies on the Earth: T_ecef_frame.
std::optional<SE3d> on_earth(const SlamMap& map, const std::vector<SessionId>& sessions,
                             const GnssFactorOptions& options) {
  std::vector<FixedPosition> fixes;
  for (const Keyframe& keyframe : map.keyframes)
    if (keyframe.gnss && is_usable(*keyframe.gnss, options) &&
        std::ranges::find(sessions, keyframe.session) != sessions.end())
      fixes.push_back({keyframe.T_map_body * options.antenna, keyframe.gnss->position_ecef});
  const std::optional<SE3d> T_frame_ecef = georeference(fixes, options);
  return T_frame_ecef ? std::optional(T_frame_ecef->inverse()) : std::nullopt;
}

/// Puts points of a frame into the file's coordinate system.
class FileFrame {
 public:
  FileFrame(const SlamMap& map, const std::vector<SessionId>& sessions, const GnssFactorOptions& options)
      : T_ecef_frame_(on_earth(map, sessions, options)) {
    if (T_ecef_frame_) zone_ = datasets::utm_zone(T_ecef_frame_->translation());
  }

  [[nodiscard]] Eigen::Vector3d operator()(const Eigen::Vector3d& point) const {
    return T_ecef_frame_ ? datasets::utm(*zone_, *T_ecef_frame_ * point) : point;
  }
  [[nodiscard]] std::string wkt() const { return zone_ ? datasets::wkt_of(*zone_) : ""; }
  [[nodiscard]] std::string account() const {
    if (!zone_)
      return "georeference none: fewer fixes than a frame needs, or all along one line: coordinates of the map's frame";
    return "georeference UTM zone " + std::to_string(zone_->number) + (zone_->north ? "N" : "S") + ", EPSG " +
           std::to_string(datasets::epsg_of(*zone_)) + "; heights above the ellipsoid WGS 84";
  }

 private:
  std::optional<SE3d> T_ecef_frame_;
  std::optional<datasets::UtmZone> zone_;
};

/// A sensor's intensities on the scale of LAS, 0 to 65535.
struct IntensityScale {
  float most = 0;  ///< that there is
  bool any = false;

  void add(const PointCloud<float>& cloud, std::size_t i) {
    if (!cloud.has_intensities()) return;
    any = true;
    if (std::isfinite(cloud.intensities[i])) most = std::max(most, cloud.intensities[i]);
  }
  [[nodiscard]] float factor() const { return most <= 1 ? 65535.0F : most <= 255 ? 257.0F : 1.0F; }
  [[nodiscard]] std::uint16_t operator()(const PointCloud<float>& cloud, std::size_t i) const {
    if (!cloud.has_intensities() || !std::isfinite(cloud.intensities[i])) return 0;
    return static_cast<std::uint16_t>(std::clamp(std::round(cloud.intensities[i] * factor()), 0.0F, 65535.0F));
  }
  [[nodiscard]] std::string account() const {
    if (!any) return "intensity    0: the map has none";
    return "intensity    the sensor's, up to " + std::to_string(most) + ", times " +
           std::to_string(static_cast<int>(factor()));
  }
};

/// Kilometres in the middle of the keyframes, so that coordinates in millimetres fit 32 bits.
Eigen::Vector3d offset_of(const SlamMap& map, const std::vector<SessionId>& sessions, const FileFrame& frame) {
  Eigen::Vector3d lower = Eigen::Vector3d::Constant(1e300), upper = -lower;
  for (const Keyframe& keyframe : map.keyframes) {
    if (std::ranges::find(sessions, keyframe.session) == sessions.end()) continue;
    const Eigen::Vector3d position = frame(keyframe.T_map_body.translation());
    lower = lower.cwiseMin(position);
    upper = upper.cwiseMax(position);
  }
  if (!(lower.x() <= upper.x())) return Eigen::Vector3d::Zero();
  return ((lower + upper).array() / 2000).round().matrix() * 1000;
}

}  // namespace

std::vector<std::string> write_las(const FileTarget& target, const SlamMap& map, const std::vector<SessionId>& sessions,
                                   const LasExport& options) {
  const FileFrame frame(map, sessions, options.earth);
  const bool utc = is_utc(map);
  const LasLayout layout{.offset = offset_of(map, sessions, frame),
                         .adjusted_standard_time = utc,
                         .wkt = frame.wkt(),
                         .software = "chainslam " + std::to_string(CHAINSLAM_VERSION_MAJOR) + "." +
                                     std::to_string(CHAINSLAM_VERSION_MINOR) + "." +
                                     std::to_string(CHAINSLAM_VERSION_PATCH)};
  LasExtent extent(layout);
  IntensityScale intensity;
  for_each_placed_point(map, sessions, options.voxel_size,
                        [&](const Keyframe& keyframe, const PointCloud<float>& cloud, std::size_t i, const auto& p) {
                          if (!extent.add(frame(p.template cast<double>())))
                            throw_output_error(target.path.string(), "keyframe " + std::to_string(keyframe.id.value),
                                               "a point more than 2147 km from the middle of the map",
                                               "export the map as PLY, which holds any coordinates");
                          intensity.add(cloud, i);
                        });
  LasWriter<> writer(target, extent);
  for_each_placed_point(map, sessions, options.voxel_size,
                        [&](const Keyframe& keyframe, const PointCloud<float>& cloud, std::size_t i, const auto& p) {
                          const Duration since =
                              cloud.has_times() ? seconds(double{cloud.time_offsets[i]}) : Duration();
                          writer.add({.position = frame(p.template cast<double>()),
                                      .gps_time = las_time(keyframe.time + since, utc),
                                      .intensity = intensity(cloud, i),
                                      .source = static_cast<std::uint16_t>(keyframe.session.value)});
                        });
  writer.commit();
  return {frame.account(),
          utc ? "GPS time     adjusted standard (GPS seconds minus 1e9), times taken as UTC"
              : "GPS time     seconds of the data set's own clock, which is not UTC",
          intensity.account()};
}

}  // namespace chainslam::mapper
