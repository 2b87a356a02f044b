#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/slam/keyframe_scan.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// A chunk of a kind that this version does not know, kept as it was so that a rewritten map still has it.
struct UnknownChunk {
  std::uint16_t type = 0;                                                      ///< kind of chunk
  std::uint16_t version = 1;                                                   ///< version of its layout
  std::uint32_t codec = 0;                                                     ///< how it is compressed
  std::uint32_t count = 0;                                                     ///< records in it
  std::uint64_t raw_bytes = 0;                                                 ///< bytes, unpacked
  std::vector<std::byte> stored;                                               ///< as it lies in the file
  friend bool operator==(const UnknownChunk&, const UnknownChunk&) = default;  ///< whether all members are equal
};

/// How a map file is to be read.
struct MapLoadOptions {
  /// Reads the intact part of an unfinished or damaged file, and reports what was lost. Otherwise such a file is
  /// refused.
  bool recover = false;
  bool scans = true;             ///< false: keyframes come without clouds, which are then not read at all
  std::uint64_t max_memory = 0;  ///< bytes that the map may take, by what the file says; 0: any
  /// Scans and frames stay in the file, which stays open, and are read when they are asked for, scans through this;
  /// null: all are read now, and the map does not need the file any more. Damaged ones are found now in either case.
  std::shared_ptr<ScanCache> scan_cache{};
};

/// One kind of chunk in a map file.
struct MapFileShare {
  std::string kind;             ///< name of the kind
  Index chunks = 0;             ///< chunks of this kind
  std::uint64_t records = 0;    ///< records in them
  std::uint64_t bytes = 0;      ///< in the file, with headers and padding
  std::uint64_t raw_bytes = 0;  ///< unpacked
};

/// What reading a map file found out about the file.
struct MapFileReport {
  bool complete = false;               ///< finished, and every checksum right
  std::uint16_t format_major = 0;      ///< version of the format
  std::uint16_t format_minor = 0;      ///< version of the format
  std::uint64_t file_bytes = 0;        ///< size of the file
  std::uint64_t ignored_bytes = 0;     ///< at the end, after the last commit that could be used
  Index commits = 0;                   ///< used
  Index keyframes_lost = 0;            ///< after the last commit that could be used, by the chunks' headers
  std::vector<KeyframeId> scans_lost;  ///< keyframes that are there, but whose scan was damaged
  Index poses_by_odometry = 0;         ///< T_map_body not as optimized last: later keyframes, placed by odometry
  Index unknown_chunks = 0;            ///< kept in LoadedMap::unknown
  bool newer_fields = false;           ///< records have fields that this version does not know; rewriting loses them
  std::vector<std::string> problems;   ///< what was damaged and where, a sentence each
  std::vector<MapFileShare> shares;    ///< by kind of chunk
};

/// A map and what its file says besides.
struct LoadedMap {
  SlamMap map;                        ///< what was mapped
  std::string parameters;             ///< the text of the configuration that made it
  std::uint64_t id = 0;               ///< of the file, from its content
  std::vector<UnknownChunk> unknown;  ///< for `save_map`
  MapFileReport report;               ///< what reading found out
};

}  // namespace chainslam
