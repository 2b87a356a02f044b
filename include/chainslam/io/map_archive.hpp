#pragma once

// Map files (.cslam), format 1.4.
//
// All numbers are little-endian; i and u are whole numbers, f is IEEE 754, the figure is their bits. Lengths are
// metres, times are nanoseconds of the data set's clock. Poses are 7 f64: translation x y z, unit quaternion x y z w
// (length 1 within 1e-6), p_a = R p_b + t for T_a_b. An information root is 36 f64, the rows of the 6x6 matrix R with
// R^T R = information of the tangent [translation; rotation], right perturbation; any rank. "hash" is XXH3, 64 bits,
// seed 0.
//
// File  = file header, chunk, chunk, ...          Chunk = chunk header, payload, zeros up to a multiple of 64 bytes
//
// File header, 64 bytes
//    0  89 43 53 4C 41 4D 0D 0A   mark ("\x89CSLAM\r\n": shows transfers that change line ends)
//    8  u16 major   another major cannot be read
//   10  u16 minor   a higher minor can: see "Later versions"
//   12  u32 64      bytes of this header
//   16  u64 id      hash of the parameters' text and the records of the first sessions and keyframes: every chunk
//                   repeats it, so that what an older file left on the disk is not taken for this one's
//   24  u64 flags   0
//   32  24 zeros
//   56  u64 hash of bytes 0 to 55
//
// Chunk header, 64 bytes
//    0  u32 4B4E4843   "CHNK"
//    4  u16 type       bit 15: a reader that does not know the type must not read the map
//    6  u16 version    of the payload's layout, 1
//    8  u32 codec      0: as it is; 1: one Zstandard frame that states its size (scans only)
//   12  u32 count      records, or points of a scan
//   16  u64 stored bytes   of the payload, without padding
//   24  u64 raw bytes      of the payload unpacked: the same for codec 0; at most 2^28, and at most 6 times the stored
//                          bytes for codec 1, so that the file's size bounds the memory that it takes
//   32  u64 sequence   0, 1, 2, ... through the file
//   40  u64 id         the file header's
//   48  u64 hash of the stored payload and its padding
//   56  u64 hash of bytes 0 to 55
//
// Payloads, unpacked. Chunks marked * are blocks: 16 bytes {i32 number of the first record, u32 bytes of a record,
// u64 0}, then `count` records of that size. Numbers of keyframes, sessions, closures count from 0 through the map.
//   8001 parameters   the text of the configuration, UTF-8; the first chunk
//   8002 session      i32 number, i32 first keyframe, i32 session whose start defines the frame of its poses (-1: not
//                     stated), u32 bytes of the name, pose: where the graph expects the first keyframe, information
//                     root of that, the name (UTF-8). A later one of the same number replaces the earlier one.
//   8003 keyframes *  72 bytes: i64 time, i32 session, u32 flags (1: a scan belongs to it), pose T_odom_body. Sessions
//                     are ranges of keyframes, one after the other; times increase in each.
//   8004 scan         i32 keyframe, u32 encoding, u32 points n, u32 columns (1 normals, 2 time offsets, 4 intensities),
//                     f64 step, u64 0; then x, y, z of all points, body frame. Encoding 1: coordinate = f32(number *
//                     step), the product in f64; each axis is n differences to the number before (0 before the first),
//                     modulo 2^16, zigzag coded: (d << 1) ^ (d >> 15), as u16; first the n low bytes, then the n high
//                     ones. Encoding 0: each axis is n f32 as four planes of n bytes, lowest first. Then the columns
//                     that there are, as planes: normals x, y, z; time offsets (seconds); intensities. At most one scan
//                     for each keyframe, in their order; the order of the points has no meaning but is kept.
//   8005 odometry *   352 bytes: i32 from, i32 to, pose T_from_to, information root
//   8006 closures *   376 bytes: i32 from, i32 to, u16 kind (0 direct, 1 chained, 2 merge), u16 verdict (0 accepted,
//                     1 not converged, 2 too few inliers, 3 high residual, 4 implausible, 5 low fitness,
//                     6 inconsistent, 7 unconfirmed, since 1.2 8 reverted, 9 against the fixes), i32 number of the
//                     closure that led to it (-1: none), pose T_from_to, information root, f64 mean squared error
//                     (m^2), f64 inlier ratio. Since 1.2, later ones of the same number replace earlier ones: what was
//                     decided otherwise.
//   0007 refusals *   as closures: tried and refused
//   8008 poses *      56 bytes: T_map_body of consecutive keyframes; later ones replace earlier ones
//   8009 gnss *       120 bytes: i32 keyframe, u32 quality (0 none, 1 2-D, 2 3-D, 3 differential, 4 RTK float, 5 RTK
//                     fixed), i64 time, 3 f64 position, 9 f64 covariance (m^2), Earth-centred, WGS 84; since 1.4 (112
//                     bytes before) i32 newest keyframe when the fix came (-1: it came with its own, or not stated),
//                     u32 flags (1: it came together with that of the keyframe before). The number of the first record
//                     has no meaning.
//   000D frames *     184 bytes, since 1.1: every frame of odometry, keyframe or not: i64 time, i32 session, u8 status
//                     (0 good, 1 degenerate, 2 lost), u8 flags (1: the local map was restarted here, 2: no frame for
//                     long before, 4: the accelerometer is left out by the settings), u8 use of the IMU (0 all, 1
//                     gyroscope, 2 gyroscope with more noise, 3 none, 255: not stated), u8 0, i32 points, i32 matches,
//                     i32 iterations, f32 residual (m), pose T_odom_body, 21 f32 covariance of it: the upper triangle,
//                     row by row, tangent [translation; rotation], since 1.3 (172 bytes before) 3 f32 integral of the
//                     specific force since the frame before (m/s, body frame at `time`; three NaN: not measured).
//                     Sessions follow one another; times increase in each.
//   000E fixes *      as gnss, keyframes -1: one measured fix. In input journals only, as the next.
//   000F loaded       u64 hash of a map file's chunk headers, then its path (UTF-8): a map that the back end was given
//                     before all else
//   800A commit       i32 sessions, keyframes, scans, odometry, closures, refusals before it; u64 0
//   000B index        16 bytes for each chunk before: u64 offset, u16 type, u16 version, u32 count
//   800C end          u64 offset of the index, u64 bytes of the whole file; the file's last 128 bytes
//
// Reading. The map is what the chunks up to a commit say; a whole file ends with commit, index, end. Of any other file
// the last commit counts: the walk stops at the first header that is not there, whose hash is wrong, or whose id or
// sequence does not fit, or whose payload would pass the file's end. A damaged payload (hash) of a scan, refusals,
// poses, gnss, frames, the index or an unknown chunk loses only that; of another chunk, all from the last commit before
// it on. Keyframes without a pose are placed by odometry from the keyframe before.
//
// Input journals (input_journal.hpp) are files of this format without poses, measurements and closures: what a back end
// is given, in that order, each session, keyframe (with its gnss and scan behind it), fix and batch of frames in a
// chunk of its own. They never get an end. As a map, they have every keyframe at its place by odometry.
//
// Writing is appending only: commit, then fdatasync. A file grows as NAME.partial and is renamed when it has its end.
//
// Later versions. Records may grow at their end: readers take the size from the block. Unknown chunks without bit 15
// are skipped, and kept when the map is rewritten. Whatever would make an older reader's map wrong gets bit 15 or a new
// major.

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/io/detail/map_decoder.hpp"
#include "chainslam/io/detail/map_file_reader.hpp"
#include "chainslam/io/loaded_map.hpp"
#include "chainslam/io/map_journal.hpp"

namespace chainslam {

/// Writes a whole map. The file appears whole or not at all; what had its name is kept as NAME~1 if `overwrite` is set.
/// @throws std::invalid_argument if a record breaks the format's rules; IoError if it cannot be written.
template <JournalFileSystem Files = RealFileSystem>
void save_map(const std::filesystem::path& path, const SlamMap& map, MapArchiveOptions options = {}, Files files = {}) {
  MapJournal<Files> journal(path, std::move(options), std::move(files));
  journal.finish(map);
}

/// Writes a map that was loaded, with its parameters and the chunks that this version does not know.
/// @copydetails save_map
template <JournalFileSystem Files = RealFileSystem>
void save_map(const std::filesystem::path& path, const LoadedMap& loaded, bool overwrite = false, Files files = {}) {
  save_map(path, loaded.map, {.overwrite = overwrite, .parameters = loaded.parameters, .unknown = loaded.unknown},
           std::move(files));
}

namespace detail {

/// How much of the file each kind of chunk takes.
inline std::vector<MapFileShare> shares_of(const MapFileReader& file) {
  std::map<std::uint16_t, MapFileShare> shares;
  for (const PlacedChunk& chunk : file.chunks()) {
    MapFileShare& share = shares[static_cast<std::uint16_t>(chunk.header.type & ~critical)];
    share.kind = chunk_name(chunk.header.type);
    ++share.chunks;
    share.records += chunk.header.count;
    share.bytes += chunk.end() - chunk.offset;
    share.raw_bytes += chunk.header.raw_bytes;
  }
  std::vector<MapFileShare> result;
  for (auto& [type, share] : shares) result.push_back(std::move(share));
  return result;
}

/// What keeps a file from being whole; nothing if it ends as a finished one does.
inline std::optional<std::string> unfinished(const MapFileReader& file) {
  const auto& chunks = file.chunks();
  if (!file.stop().empty()) return file.stop();
  if (chunks.size() < 3 || !chunks.back().header.is(ChunkType::end) ||
      !chunks[chunks.size() - 2].header.is(ChunkType::index))
    return "no end: the run that wrote it did not finish";
  const std::size_t index_number = chunks.size() - 2;
  const auto index = file.payload(index_number), end = file.payload(index_number + 1);
  if (!index) return file.place(index_number) + ": damaged";
  if (!end) return file.place(index_number + 1) + ": damaged";
  bool agrees = end->size() >= 16 && index->size() == 16 * index_number;
  if (agrees) {
    ByteReader in(*end);
    agrees = in.take<std::uint64_t>() == chunks[index_number].offset && in.take<std::uint64_t>() == file.size();
  }
  ByteReader in(*index);
  for (std::size_t i = 0; agrees && i < index_number; ++i) {
    const ChunkHeader& header = chunks[i].header;
    agrees = in.take<std::uint64_t>() == chunks[i].offset && in.take<std::uint16_t>() == header.type &&
             in.take<std::uint16_t>() == header.version && in.take<std::uint32_t>() == header.count;
  }
  if (!agrees) file.fail(file.place(index_number), "an index that is not of this file", MapFileReader::written_wrongly);
  return std::nullopt;
}

inline std::optional<std::size_t> last_commit_before(const MapFileReader& file, std::size_t end) {
  while (end-- > 0)
    if (file.chunks()[end].header.is(ChunkType::commit)) return end;
  return std::nullopt;
}

/// Bytes that the chunks up to a commit take in memory, roughly, by what their headers say.
inline std::uint64_t memory_of(const MapFileReader& file, std::size_t commit, const MapLoadOptions& options) {
  std::uint64_t bytes = 0;
  for (std::size_t i = 0; i <= commit; ++i) {
    const ChunkHeader& header = file.chunks()[i].header;
    if (header.is(ChunkType::frames) && options.scan_cache) continue;  // left in the file
    if (header.is(ChunkType::scan))
      bytes += !options.scans ? 0 : options.scan_cache ? 256 : 2 * header.raw_bytes + 256;
    else
      bytes += header.is(ChunkType::keyframes) ? 4 * header.raw_bytes : header.raw_bytes;
  }
  return bytes;
}

}  // namespace detail

/// Reads a map file. Takes at most 64 MiB and 20 times the file's size of memory, whatever the file claims.
///
/// Scans, measurements, sessions and fixes come back bit for bit, T_map_body as it was when the file was finished. With
/// `recover`, an unfinished or damaged file gives what was committed and is whole; `report` says what was lost.
/// @throws IoError naming chunk, record and field: the file is unfinished or damaged (without `recover`), has no
/// commit, breaks the format's rules, needs a newer version, or asks for more than `max_memory`.
[[nodiscard]] inline LoadedMap load_map(const std::filesystem::path& path, const MapLoadOptions& options = {}) {
  const detail::MapFileReader file(path);
  const auto refuse = [&](const std::string& what) {
    if (!options.recover) file.fail("", what, "`chainslam recover` recovers the intact part in a new file");
  };
  std::vector<std::string> problems;
  const std::optional<std::string> unfinished = detail::unfinished(file);
  if (unfinished) {
    refuse(*unfinished);
    problems.push_back(*unfinished);
  }
  std::optional<std::size_t> commit = detail::last_commit_before(file, file.chunks().size());
  for (;;) {
    if (!commit) file.fail("", "no complete commit", "there is nothing to save in it: make the map again");
    if (const std::uint64_t bytes = detail::memory_of(file, *commit, options);
        options.max_memory > 0 && bytes > options.max_memory)
      file.fail("",
                "a map that takes " + std::to_string(bytes) + " bytes of memory, where " +
                    std::to_string(options.max_memory) + " are allowed",
                "raise the limit, or load it on a larger machine");
    detail::MapDecoder decoder(file, options, *commit);
    const std::optional<std::size_t> damaged = decoder.run();
    if (damaged) {
      refuse(file.place(*damaged) + ": damaged");
      problems.push_back(file.place(*damaged) + ": damaged, and with it all from the last commit before it on");
      commit = detail::last_commit_before(file, *damaged);
      continue;
    }
    LoadedMap loaded = decoder.take();
    MapFileReport& report = loaded.report;
    if (!report.problems.empty()) refuse(report.problems.front());
    report.problems.insert(report.problems.begin(), problems.begin(), problems.end());
    const bool to_the_end = !unfinished && *commit + 3 == file.chunks().size();
    report.complete = to_the_end && report.problems.empty();
    report.format_major = file.header().major;
    report.format_minor = file.header().minor;
    report.file_bytes = file.size();
    report.ignored_bytes = to_the_end ? 0 : file.size() - file.chunks()[*commit].end();
    for (std::size_t i = *commit; i < file.chunks().size(); ++i)
      if (file.chunks()[i].header.is(detail::ChunkType::keyframes))
        report.keyframes_lost += static_cast<Index>(file.chunks()[i].header.count);
    report.shares = detail::shares_of(file);
    return loaded;
  }
}

}  // namespace chainslam
