// expect: MapJournal: Files needs `int sync_data(int file)` and `int lock(int file)` beside what BasicAtomicFile's
// System has A file system that cannot keep two writers apart.
#include "chainslam/io/map_journal.hpp"

#ifdef CHAINSLAM_RIGHT
using MySystem = chainslam::RealFileSystem;
#else
struct MySystem {
  int create(const std::filesystem::path& path);
  std::ptrdiff_t write(int file, const std::byte* data, std::size_t size);
  int sync(int file);
  int close(int file);
  int rename(const std::filesystem::path& from, const std::filesystem::path& to);
  int sync_directory(const std::filesystem::path& path);
  int remove(const std::filesystem::path& path);
};
#endif

void save(const chainslam::SlamMap& map) { chainslam::MapJournal<MySystem>("map").finish(map); }
