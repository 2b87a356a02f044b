#include <benchmark/benchmark.h>
#include <unistd.h>

#include <filesystem>
#include <stdexcept>
#include <string>

#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "clouds.hpp"

namespace chainslam {
namespace {

/// A folder of this program's own, gone with it.
class TemporaryFolder {
 public:
  TemporaryFolder()
      : path_(std::filesystem::temp_directory_path() / ("chainslam_bench_io_" + std::to_string(getpid()))) {
    std::filesystem::create_directories(path_);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  [[nodiscard]] std::filesystem::path file(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

/// One way of keeping a cloud in a file.
struct Format {
  const char* name;
  void (*write)(const std::filesystem::path&, const PointCloud<float>&);
  PointCloud<float> (*read)(const std::filesystem::path&);
};

constexpr Format pcd{"pcd_binary",
                     [](const std::filesystem::path& path, const PointCloud<float>& cloud) { write_pcd(path, cloud); },
                     read_pcd};
constexpr Format pcd_compressed{"pcd_compressed",
                                [](const std::filesystem::path& path, const PointCloud<float>& cloud) {
                                  write_pcd(path, cloud, PcdEncoding::binary_compressed);
                                },
                                read_pcd};
constexpr Format ply{"ply_binary",
                     [](const std::filesystem::path& path, const PointCloud<float>& cloud) { write_ply(path, cloud); },
                     read_ply};

/// Bytes are those of the points in memory, so that formats compare; `file_MB` is what lies on the disk.
void set_counters(benchmark::State& state, const PointCloud<float>& cloud, const std::filesystem::path& path) {
  const std::size_t values = cloud.positions.size() * 3 + cloud.intensities.size();
  state.SetBytesProcessed(state.iterations() * static_cast<std::int64_t>(values * sizeof(float)));
  state.counters["file_MB"] = 1e-6 * static_cast<double>(std::filesystem::file_size(path));
}

/// To the disk, not to the system's memory: a file counts as written when it would survive a loss of power.
void write(benchmark::State& state, const Format& format, const PointCloud<float>& cloud) {
  const TemporaryFolder folder;
  for (auto _ : state) format.write(folder.file("cloud"), cloud);
  set_counters(state, cloud, folder.file("cloud"));
}

void read(benchmark::State& state, const Format& format, const PointCloud<float>& cloud) {
  const TemporaryFolder folder;
  format.write(folder.file("cloud"), cloud);
  if (format.read(folder.file("cloud")).positions != cloud.positions)
    throw std::runtime_error(std::string(format.name) + ": other points were read than written");
  for (auto _ : state) benchmark::DoNotOptimize(format.read(folder.file("cloud")).positions.data());
  set_counters(state, cloud, folder.file("cloud"));
}

const bool registered = [] {
  const bench::ScanPair& pair = bench::scan_pairs().front();
  for (const Format& format : {pcd, pcd_compressed, ply}) {
    const auto add = [&](const char* way, const auto& run) {
      benchmark::RegisterBenchmark((std::string("io/") + format.name + "/" + way + "_" + pair.name).c_str(),
                                   [format, run, &pair](benchmark::State& state) { run(state, format, pair.first); })
          ->UseRealTime()
          ->Unit(benchmark::kMillisecond);
    };
    add("write", write);
    add("read", read);
  }
  return true;
}();

}  // namespace
}  // namespace chainslam
