#include "chainslam/io/detail/frame_file.hpp"

#include <doctest/doctest.h>
#include <unistd.h>

#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "chainslam/io/map_archive.hpp"
#include "io/maps.hpp"
#include "support/files.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

constexpr std::size_t block_of_frames = FrameRecords::block_records;

/// A random map whose last session has so many frames more.
SlamMap map_with_frames(std::uint64_t seed, std::size_t more) {
  SlamMap map = random_map(seed, 8);
  Rng rng(seed);
  FrameRecord frame = map.frames.back();
  for (std::size_t i = 0; i < more; ++i) {
    frame.time = frame.time + Duration(1 + rng.uniform_index(1000));
    frame.T_odom_body = random_pose(rng);
    frame.health.residual_rms = rng.uniform(0.0, 1.0);
    frame.delta_velocity = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).cast<float>();
    map.frames.push_back(frame);
  }
  return map;
}

MapLoadOptions left_in_file() { return {.scan_cache = std::make_shared<ScanCache>()}; }

/// Numbers of a file's chunks of frames.
std::vector<std::size_t> frame_chunks(const chainslam::detail::MapFileReader& file) {
  std::vector<std::size_t> numbers;
  for (std::size_t i = 0; i < file.chunks().size(); ++i)
    if (file.chunks()[i].header.is(chainslam::detail::ChunkType::frames)) numbers.push_back(i);
  return numbers;
}

}  // namespace

TEST_SUITE("io/frame_file") {
  TEST_CASE("a map whose frames are left in its file is the same, and gives the same file") {
    for_all(8, [](Rng& rng, int) {
      const TemporaryFolder folder;
      const SlamMap map = map_with_frames(rng.bits(), static_cast<std::size_t>(rng.uniform_index(9000)));
      save_map(folder / "a", map, {}, UnsyncedFiles{});
      const LoadedMap loaded = load_map(folder / "a", left_in_file());
      CHECK(same_map(loaded.map, map));
      save_map(folder / "b", loaded, false, UnsyncedFiles{});
      CHECK(read_bytes(folder / "a") == read_bytes(folder / "b"));
    });
  }

  TEST_CASE("frames in many small chunks leave memory as a journal commits them") {
    const TemporaryFolder folder;
    const SlamMap map = map_with_frames(4, 5000);
    for (const bool left : {false, true}) {
      SlamMap growing = map;
      growing.frames = {};
      MapJournal<UnsyncedFiles> journal(folder / (left ? "b" : "a"),
                                        {.scan_cache = left ? std::make_shared<ScanCache>() : nullptr});
      Rng rng(5);
      for (const FrameRecord& frame : map.frames) {
        growing.frames.push_back(frame);
        if (rng.uniform_index(30) == 0) journal.update(growing);
      }
      journal.finish(growing);
      CHECK(same_map(growing, map));
      // What is read now comes from the file: cut off, it is missed.
      REQUIRE(::truncate((folder / (left ? "b" : "a")).c_str(), 20'000) == 0);
      if (left)
        CHECK(says(io_error([&] { return growing.frames[100]; }), "the end of the file, which was longer before"));
      else
        CHECK(growing.frames[100].time == map.frames[100].time);
      CHECK(growing.frames.back().time == map.frames.back().time);
    }
  }

  TEST_CASE("frames of a loaded map that were written to another file are read from that") {
    const TemporaryFolder folder;
    const SlamMap map = map_with_frames(6, 4000);
    save_map(folder / "a", map, {}, UnsyncedFiles{});
    const LoadedMap loaded = load_map(folder / "a", left_in_file());
    MapJournal<UnsyncedFiles> journal(folder / "b", {.scan_cache = std::make_shared<ScanCache>()});
    journal.update(loaded.map);
    REQUIRE(::truncate((folder / "a").c_str(), 0) == 0);
    CHECK(same_records(loaded.map.frames, map.frames));
  }

  TEST_CASE("frames that were changed since they were opened are never taken for whole") {
    const TemporaryFolder folder;
    save_map(folder / "a", map_with_frames(7, 4000), {}, UnsyncedFiles{});
    const LoadedMap loaded = load_map(folder / "a", left_in_file());
    const chainslam::detail::MapFileReader file(folder / "a");
    const std::uint64_t first = file.chunks()[frame_chunks(file).front()].offset + 80;
    std::string bytes = read_bytes(folder / "a");
    bytes[first + 184 * (block_of_frames + 3) + 40] ^= 1;
    std::ofstream(folder / "a", std::ios::binary | std::ios::in) << bytes;
    CHECK(loaded.map.frames[block_of_frames - 1].session == SessionId{1});
    const std::string error = io_error([&] { return loaded.map.frames[block_of_frames]; });
    CHECK(says(error, "a, frames at byte " + std::to_string(first + 184 * block_of_frames) +
                          "\n  found: bytes that have changed since they were read or written\n  do: check the disk"));
    CHECK(says(io_error([&] { return save_map(folder / "b", loaded), 0; }), "bytes that have changed"));
    CHECK_FALSE(std::filesystem::exists(folder / "b"));
    CHECK(loaded.map.frames[2 * block_of_frames].session == SessionId{1});
  }

  TEST_CASE("damaged chunks lose only their frames, whether they are read now or left") {
    const TemporaryFolder folder;
    {
      const SlamMap map = map_with_frames(8, 6000);
      SlamMap growing = map;
      growing.frames = {};
      MapJournal<UnsyncedFiles> journal(folder / "a", {});
      for (const FrameRecord& frame : map.frames) {
        growing.frames.push_back(frame);
        if (growing.frames.size() % 700 == 0) journal.update(growing);
      }
      journal.finish(growing);
    }
    const chainslam::detail::MapFileReader file(folder / "a");
    const std::vector<std::size_t> numbers = frame_chunks(file);
    REQUIRE(numbers.size() >= 8);
    std::string bytes = read_bytes(folder / "a");
    for (const std::size_t which : {std::size_t{1}, std::size_t{4}})
      bytes[file.chunks()[numbers[which]].offset + 300] ^= 1;
    write_bytes(folder / "b", bytes);
    CHECK(says(io_error([&] { return load_map(folder / "b", left_in_file()); }), "(frames)"));
    MapLoadOptions options = left_in_file();
    options.recover = true;
    const LoadedMap left = load_map(folder / "b", options);
    const LoadedMap read = load_map(folder / "b", {.recover = true});
    CHECK(left.report.problems == read.report.problems);
    CHECK(left.report.problems.size() == 2);
    CHECK(read.map.frames.size() + 1400 == load_map(folder / "a").map.frames.size());
    CHECK(same_map(left.map, read.map));
  }
}

}  // namespace chainslam::test
