#include <benchmark/benchmark.h>
#include <unistd.h>

#include <filesystem>
#include <memory>
#include <stdexcept>
#include <string>

#include "chainslam/cloud/quantize.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/io/map_archive.hpp"
#include "clouds.hpp"
#include "versus.hpp"

namespace chainslam {
namespace {

/// A scan as a keyframe holds it.
PointCloud<float> kept_scan(double voxel_size) {
  const PointCloud<float>& scan = bench::scan_pairs().front().first;
  return quantized(voxel_size > 0 ? voxel_downsample(scan, voxel_size) : scan);
}

std::vector<std::byte> encoded(const PointCloud<float>& cloud) {
  std::vector<std::byte> raw;
  detail::append_scan(raw, KeyframeId{0}, cloud);
  return detail::ZstdCodec{}.compress(raw);
}

PointCloud<float> decoded(const std::vector<std::byte>& packed, std::size_t raw_bytes) {
  std::vector<std::byte> raw(raw_bytes);
  if (!detail::ZstdCodec{}.decompress(packed, raw)) throw std::runtime_error("a scan that does not unpack");
  detail::ByteReader in(raw);
  const detail::ScanHead head = detail::read_scan_head(in);
  return detail::read_scan_body(head, in);
}

void set_counters(benchmark::State& state, const PointCloud<float>& cloud, const std::vector<std::byte>& packed,
                  const std::vector<std::byte>& floats) {
  const auto points = static_cast<double>(cloud.size());
  state.counters["bytes_per_point"] = static_cast<double>(packed.size()) / points;
  state.counters["zstd_floats_bytes_per_point"] = static_cast<double>(floats.size()) / points;
  // As MB of points in memory, 12 bytes each, so that the ways compare.
  state.SetBytesProcessed(state.iterations() * static_cast<std::int64_t>(cloud.size() * sizeof(Eigen::Vector3f)));
}

/// Ours against Zstandard over the floats as they lie in memory.
void encode(benchmark::State& state) {
  const PointCloud<float> cloud = kept_scan(1e-2 * static_cast<double>(state.range(0)));
  const auto floats = std::as_bytes(std::span(cloud.positions));
  bench::versus(
      state, "zstd_floats", [&] { return encoded(cloud).size(); },
      [&] { return detail::ZstdCodec{}.compress(floats).size(); });
  set_counters(state, cloud, encoded(cloud), detail::ZstdCodec{}.compress(floats));
}

void decode(benchmark::State& state) {
  const PointCloud<float> cloud = kept_scan(1e-2 * static_cast<double>(state.range(0)));
  const std::vector<std::byte> packed = encoded(cloud),
                               floats = detail::ZstdCodec{}.compress(std::as_bytes(std::span(cloud.positions)));
  const std::size_t raw_bytes = detail::scan_head_bytes + 6 * cloud.size();
  if (decoded(packed, raw_bytes).positions != cloud.positions) throw std::runtime_error("other points came back");
  std::vector<Eigen::Vector3f> out(cloud.size());
  bench::versus(
      state, "zstd_floats", [&] { return decoded(packed, raw_bytes).size(); },
      [&] { return detail::ZstdCodec{}.decompress(floats, std::as_writable_bytes(std::span(out))); });
  set_counters(state, cloud, packed, floats);
}

/// A map of 1000 keyframes, each with the scan voxelised at 0.4 m, moved a little so that none is like the other.
SlamMap large_map() {
  constexpr Index count = 1000;
  SlamMap map;
  Session session;
  session.id = session.frame = SessionId{0};
  session.name = "bench";
  session.keyframes = count;
  map.sessions.push_back(session);
  const PointCloud<float> scan = voxel_downsample(bench::scan_pairs().front().first, 0.4);
  for (Index i = 0; i < count; ++i) {
    Keyframe keyframe;
    keyframe.id = KeyframeId{i};
    keyframe.session = SessionId{0};
    keyframe.time = Timestamp::from_nanoseconds(1'000'000'000LL * i);
    keyframe.T_map_body = keyframe.T_odom_body = SE3d(SO3d::exp({0, 0, 0.001 * i}), {1.0 * i, 0, 0});
    PointCloud<float> moved = scan;
    for (Eigen::Vector3f& p : moved.positions) p += Eigen::Vector3f(0.0137F, 0.0071F, 0.0003F) * static_cast<float>(i);
    keyframe.cloud = std::make_shared<const PointCloud<float>>(quantized(moved));
    if (i > 0)
      map.odometry.push_back({KeyframeId{i - 1}, KeyframeId{i}, SE3d(), SqrtInformation<6>(Matrix6d::Identity())});
    map.keyframes.push_back(std::move(keyframe));
  }
  return map;
}

class TemporaryFile {
 public:
  TemporaryFile()
      : path_(std::filesystem::temp_directory_path() / ("chainslam_bench_map_" + std::to_string(::getpid()))) {}
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  ~TemporaryFile() { remove(); }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  void remove() const {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }

 private:
  std::filesystem::path path_;
};

void set_file_counters(benchmark::State& state, const TemporaryFile& file) {
  const auto bytes = std::filesystem::file_size(file.path());
  state.counters["file_MB"] = 1e-6 * static_cast<double>(bytes);
  state.SetBytesProcessed(state.iterations() * static_cast<std::int64_t>(bytes));
}

/// To the disk, not to the system's memory.
void save(benchmark::State& state) {
  const SlamMap map = large_map();
  const TemporaryFile file;
  for (auto _ : state) {
    file.remove();
    save_map(file.path(), map);
  }
  set_file_counters(state, file);
}

/// As a mapper does: a commit for each keyframe.
void journal(benchmark::State& state) {
  const SlamMap map = large_map();
  const TemporaryFile file;
  for (auto _ : state) {
    file.remove();
    SlamMap growing;
    growing.sessions = map.sessions;
    growing.sessions[0].keyframes = 0;
    MapJournal<> journal(file.path());
    for (std::size_t i = 0; i < map.keyframes.size(); ++i) {
      growing.keyframes.push_back(map.keyframes[i]);
      if (i > 0) growing.odometry.push_back(map.odometry[i - 1]);
      ++growing.sessions[0].keyframes;
      journal.update(growing);
    }
    journal.finish(growing);
  }
  set_file_counters(state, file);
}

void load(benchmark::State& state) {
  const TemporaryFile file;
  save_map(file.path(), large_map());
  for (auto _ : state) benchmark::DoNotOptimize(load_map(file.path()).map.keyframes.size());
  set_file_counters(state, file);
}

/// The scans stay in the file.
void open_only(benchmark::State& state) {
  const TemporaryFile file;
  save_map(file.path(), large_map());
  const MapLoadOptions options{.scan_cache = std::make_shared<ScanCache>()};
  for (auto _ : state) benchmark::DoNotOptimize(load_map(file.path(), options).map.keyframes.size());
  set_file_counters(state, file);
}

/// Every scan in turn, from a cache that has none of them or all.
void read_scans(benchmark::State& state, std::size_t cache_bytes) {
  const TemporaryFile file;
  save_map(file.path(), large_map());
  const LoadedMap loaded = load_map(file.path(), {.scan_cache = std::make_shared<ScanCache>(cache_bytes)});
  std::size_t points = 0;
  for (const Keyframe& keyframe : loaded.map.keyframes) points += keyframe.cloud.load()->size();
  for (auto _ : state)
    for (const Keyframe& keyframe : loaded.map.keyframes) benchmark::DoNotOptimize(keyframe.cloud.load()->size());
  state.SetItemsProcessed(state.iterations() * std::ssize(loaded.map.keyframes));
  state.SetBytesProcessed(state.iterations() * static_cast<std::int64_t>(points * sizeof(Eigen::Vector3f)));
}

BENCHMARK(encode)->Name("io/map_archive/encode")->ArgName("voxel_cm")->Arg(0)->Arg(40)->UseManualTime();
BENCHMARK(decode)->Name("io/map_archive/decode")->ArgName("voxel_cm")->Arg(0)->Arg(40)->UseManualTime();
BENCHMARK(save)->Name("io/map_archive/save_1000_keyframes")->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK(journal)->Name("io/map_archive/journal_1000_keyframes")->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK(load)->Name("io/map_archive/load_1000_keyframes")->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK(open_only)->Name("io/map_archive/open_1000_keyframes")->UseRealTime()->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(read_scans, from_file, std::size_t{0})
    ->Name("io/scan_file/read_1000_scans")
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(read_scans, from_cache, std::size_t{1} << 40)
    ->Name("io/scan_file/read_1000_cached_scans")
    ->UseRealTime()
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace chainslam
