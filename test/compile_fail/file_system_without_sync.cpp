// expect: BasicAtomicFile: System needs create, write, sync, close, rename, rename_new, link, sync_directory and remove
// expect: see chainslam/io/file_system.hpp
// A file system that cannot make the disk keep what was written.
#include "chainslam/io/atomic_file.hpp"

#ifdef CHAINSLAM_RIGHT
using MySystem = chainslam::RealFileSystem;
#else
struct MySystem {
  int create(const std::filesystem::path& path);
  std::ptrdiff_t write(int file, const std::byte* data, std::size_t size);
};
#endif

void save() { chainslam::BasicAtomicFile<MySystem> file("map"); }
