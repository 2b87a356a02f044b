#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/io/detail/chunk_writer.hpp"
#include "chainslam/io/detail/frame_file.hpp"
#include "chainslam/io/loaded_map.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// What a map file holds besides the map, and what becomes of one that has the name.
struct MapArchiveOptions {
  bool overwrite = false;               ///< what has the name is then kept as NAME~1
  std::string parameters{};             ///< text of the configuration that made the map
  std::vector<UnknownChunk> unknown{};  ///< as `load_map` found them
  /// Scans and frames that were committed are read from the file again, scans through this, and their copies in memory
  /// go; null: the map's stay where they are. It concerns all copies of them, whichever map has them.
  std::shared_ptr<ScanCache> scan_cache{};
};

/// Writes a map to a file while it grows, so that a crash at any moment loses nothing that was committed.
///
/// The file grows as NAME.partial; `finish` gives it its name. Without `finish`, NAME.partial stays with all that was
/// committed, for `load_map` with `recover`; if nothing was, it is removed. The map's vectors may only grow; of what
/// was written, poses, sessions and the verdicts of closures may change. The same calls give the same bytes. After an
/// IoError the journal takes nothing more. Format: map_archive.hpp.
template <class Files = RealFileSystem>
class MapJournal {
  static_assert(JournalFileSystem<Files>,
                "MapJournal: Files needs `int sync_data(int file)` and `int lock(int file)` beside what "
                "BasicAtomicFile's System has, as RealFileSystem has them; see chainslam/io/file_system.hpp");

 public:
  /// @throws IoError if NAME exists and may not be overwritten, if another process writes it (named by its number), if
  /// a run that did not finish left NAME.partial, or if it cannot be made.
  explicit MapJournal(std::filesystem::path path, MapArchiveOptions options = {}, Files files = {})
      : options_(std::move(options)), writer_(std::move(path), options_.overwrite, std::move(files)) {
    for (const UnknownChunk& chunk : options_.unknown)
      if (detail::is_known_chunk(chunk.type) || (chunk.type & detail::critical) != 0)
        throw std::invalid_argument("MapJournal: an unknown chunk of a kind that is known, or critical");
  }

  /// Appends what is new since the last call and commits: once it has returned, a crash or a loss of power keeps it.
  ///
  /// Written: new sessions and those whose frame or prior changed; new keyframes with their scans; GNSS fixes of new
  /// keyframes and of the 256 before; new measurements and frames. Poses are written whole when an eighth more
  /// keyframes have come or a session was merged, so that the file does not grow with the square of the map, and with
  /// them closures that were decided otherwise; on recovery, later keyframes are placed by odometry. Calls without news
  /// write nothing.
  /// @throws std::invalid_argument, before anything is written, if a record breaks the format's rules or the map
  /// shrank.
  /// @throws IoError if the disk fails; what had been committed stays.
  void update(const SlamMap& map) {
    append(map);
    if (!unsynced_) return;
    in_doubt_ = true;
    writer_.file().sync();
    keep(map);
    in_doubt_ = unsynced_ = false;
  }

  /// The same, but until the next `update` a loss of power may lose it; a crash of the program alone does not.
  /// @throws as `update`.
  void append(const SlamMap& map) {
    const Index fresh = counts_.keyframes;
    const Index first_gnss = std::max(Index{0}, fresh - gnss_window);
    const bool all_poses = has_merged(map) || std::int64_t{count(map.keyframes)} * 8 >= std::int64_t{posed_} * 9;
    check(map, first_gnss, all_poses ? 0 : fresh);
    in_doubt_ = true;
    if (append_new(map, first_gnss, all_poses)) {
      if (all_poses)
        append_poses(map, 0, count(map.keyframes));
      else
        append_first_poses(map, fresh);
      writer_.append_commit(counts_);
      writer_.file().flush();
      unsynced_ = true;
    }
    in_doubt_ = false;
  }

  /// Appends what is left, all poses, the index and the end, and gives the file its name. Nothing can follow.
  /// @throws as `update`.
  void finish(const SlamMap& map) {
    check(map, 0, 0);
    in_doubt_ = true;
    append_new(map, 0, true);
    for (const UnknownChunk& unknown : options_.unknown)
      writer_.append({.type = unknown.type,
                      .version = unknown.version,
                      .codec = unknown.codec,
                      .count = unknown.count,
                      .raw_bytes = unknown.raw_bytes},
                     unknown.stored);
    append_poses(map, 0, count(map.keyframes));
    writer_.append_commit(counts_);
    writer_.append_index_and_end();
    writer_.file().finish();
    keep(map);
  }

  /// Ends the journal without a map and deletes its file.
  void remove() { writer_.file().remove(); }

  /// Where the file grows until it is finished.
  [[nodiscard]] const std::filesystem::path& partial_path() const { return writer_.file().partial(); }
  /// Bytes written so far.
  [[nodiscard]] std::uint64_t size() const { return writer_.file().size(); }

 private:
  using Type = detail::ChunkType;
  static constexpr Index gnss_window = 256;

  static Index count(const auto& records) { return to_index(records.size(), "map"); }
  template <class T>
  static const T& at(const std::vector<T>& records, Index i) {
    return records[static_cast<std::size_t>(i)];
  }

  // ---- checks ----

  [[noreturn]] static void refuse(const char* what, Index i, const detail::Fault& fault) {
    throw std::invalid_argument("MapJournal: " + std::string(what) + " " + std::to_string(i) + ", " + fault.field +
                                ": " + fault.found);
  }

  /// Checks all that is to be written: what is new, fixes and poses from the keyframes given on.
  void check(const SlamMap& map, Index first_gnss, Index first_pose) const {
    if (!writer_.file().writable() || in_doubt_)
      throw std::invalid_argument("MapJournal: the file is finished, or writing it failed before");
    const detail::MapCounts counts = {count(map.sessions), count(map.keyframes), 0,
                                      count(map.odometry), count(map.closures),  count(map.refusals)};
    if (counts.sessions < counts_.sessions || counts.keyframes < counts_.keyframes ||
        counts.odometry < counts_.odometry || counts.closures < counts_.closures ||
        counts.refusals < counts_.refusals || count(map.frames) < frames_)
      throw std::invalid_argument("MapJournal: the map has fewer records than at the last call");
    check_sessions(map);
    for (Index i = counts_.keyframes; i < counts.keyframes; ++i) check_keyframe(map, i);
    for (Index i = first_pose; i < counts.keyframes; ++i)
      if (auto fault = detail::fault_of("T_map_body", at(map.keyframes, i).T_map_body)) refuse("keyframe", i, *fault);
    for (Index i = first_gnss; i < counts.keyframes; ++i)
      if (at(map.keyframes, i).gnss)
        if (auto fault = detail::first_fault({detail::fault_of(*at(map.keyframes, i).gnss),
                                              detail::fault_of_arrival(at(map.keyframes, i), counts.keyframes)}))
          refuse("GNSS fix of keyframe", i, *fault);
    for (Index i = counts_.odometry; i < counts.odometry; ++i)
      if (auto fault = detail::fault_of(at(map.odometry, i), counts.keyframes)) refuse("odometry", i, *fault);
    for (Index i = counts_.closures; i < counts.closures; ++i)
      if (auto fault = detail::fault_of(at(map.closures, i), counts)) refuse("closure", i, *fault);
    for (Index i = counts_.refusals; i < counts.refusals; ++i)
      if (auto fault = detail::fault_of(at(map.refusals, i), counts)) refuse("refusal", i, *fault);
    check_frames(map);
  }

  void check_frames(const SlamMap& map) const {
    std::optional<FrameRecord> before;
    if (frames_ > 0) before = map.frames[static_cast<std::size_t>(frames_ - 1)];
    for (Index i = frames_; i < count(map.frames); ++i) {
      const FrameRecord frame = map.frames[static_cast<std::size_t>(i)];
      if (auto fault = detail::fault_of(frame, before ? &*before : nullptr, count(map.sessions)))
        refuse("frame", i, *fault);
      before = frame;
    }
  }

  static void check_sessions(const SlamMap& map) {
    Index keyframes = 0;
    for (Index i = 0; i < count(map.sessions); ++i) {
      const Session& session = at(map.sessions, i);
      if (auto fault = detail::fault_of(session)) refuse("session", i, *fault);
      if (session.id.value != i) refuse("session", i, {"id", std::to_string(session.id.value)});
      if (session.first_keyframe != keyframes || session.keyframes < 0)
        refuse("session", i, {"first keyframe", std::to_string(session.first_keyframe)});
      if (auto fault = detail::fault_of_number("frame", session.frame.value, -1, count(map.sessions), "sessions"))
        refuse("session", i, *fault);
      keyframes += session.keyframes;
    }
    if (keyframes != count(map.keyframes))
      throw std::invalid_argument("MapJournal: the sessions have " + std::to_string(keyframes) +
                                  " keyframes, the map " + std::to_string(map.keyframes.size()));
  }

  /// Whether a session that had been written is in another frame now.
  [[nodiscard]] bool has_merged(const SlamMap& map) const {
    return !std::equal(sessions_.begin(), sessions_.begin() + std::min(std::ssize(sessions_), std::ssize(map.sessions)),
                       map.sessions.begin(), [](const Session& a, const Session& b) { return a.frame == b.frame; });
  }

  static void check_keyframe(const SlamMap& map, Index i) {
    const Keyframe& keyframe = at(map.keyframes, i);
    const Keyframe* before = i > 0 ? &at(map.keyframes, i - 1) : nullptr;
    if (keyframe.id.value != i) refuse("keyframe", i, {"id", std::to_string(keyframe.id.value)});
    if (auto fault = detail::fault_of(keyframe, before, count(map.sessions))) refuse("keyframe", i, *fault);
    const Session& session = at(map.sessions, keyframe.session.value);
    if (i < session.first_keyframe || i >= session.end_keyframe())
      refuse("keyframe", i, {"session", "one whose range does not hold it"});
    if (keyframe.cloud.size() > detail::most_scan_points)
      refuse("keyframe", i, {"scan", std::to_string(keyframe.cloud.size()) + " points"});
    const KeyframeScan::Cloud cloud = keyframe.cloud.place().cloud;
    if (!cloud) return;  // what was read from a file can be written to one
    for (const std::size_t length : {cloud->normals.size(), cloud->time_offsets.size(), cloud->intensities.size()})
      if (length != 0 && length != cloud->size()) refuse("keyframe", i, {"scan", "columns of different lengths"});
  }

  // ---- what is new ----

  /// @param decided  whether closures are written again that were decided otherwise.
  /// @returns whether anything was.
  bool append_new(const SlamMap& map, Index first_gnss, bool decided) {
    const std::uint64_t before = writer_.chunks();
    if (writer_.chunks() == 0) append_start(map);
    append_sessions(map);
    const Index fresh = std::exchange(counts_.keyframes, count(map.keyframes));
    writer_.append_records(Type::keyframes, detail::keyframe_bytes, fresh, counts_.keyframes,
                           [&](auto& out, Index i) { detail::append_keyframe(out, at(map.keyframes, i)); });
    append_gnss(map, first_gnss);
    const Index odometry = std::exchange(counts_.odometry, count(map.odometry));
    writer_.append_records(Type::odometry, detail::odometry_bytes, odometry, counts_.odometry,
                           [&](auto& out, Index i) { detail::append_odometry(out, at(map.odometry, i)); });
    if (decided) append_decided(map);
    append_closures(map, counts_.closures, count(map.closures));
    counts_.closures = count(map.closures);
    const Index refusals = std::exchange(counts_.refusals, count(map.refusals));
    writer_.append_records(Type::refusals, detail::closure_bytes, refusals, counts_.refusals,
                           [&](auto& out, Index i) { detail::append_closure(out, at(map.refusals, i)); });
    const Index frames = std::exchange(frames_, count(map.frames));
    writer_.append_records(
        Type::frames, detail::frame_bytes, frames, frames_,
        [&](auto& out, Index i) { detail::append_frame(out, map.frames[static_cast<std::size_t>(i)]); },
        [&](std::span<const std::byte> payload, std::uint64_t offset) {
          if (frame_file_) frame_file_->add(payload, offset);
        });
    for (Index i = fresh; i < counts_.keyframes; ++i)
      if (const Keyframe& keyframe = at(map.keyframes, i); keyframe.cloud) {
        unkept_scans_.push_back({keyframe.id, writer_.append_scan(keyframe.id, keyframe.cloud)});
        ++counts_.scans;
      }
    return writer_.chunks() != before;
  }

  /// What the disk has taken is read from the file from now on.
  void keep(const SlamMap& map) {
    const auto scans = std::exchange(unkept_scans_, {});
    if (!scan_file_) return;
    for (const detail::ScanFile::Place& place : scans)
      scan_file_->take(at(map.keyframes, place.keyframe.value).cloud, place);
    kept_frames_ = map.frames.keep_in(frame_file_, kept_frames_, static_cast<std::size_t>(frames_));
  }

  /// The file's header and its parameters. The file's id comes from these and the map's beginning, so that the same run
  /// gives the same file.
  void append_start(const SlamMap& map) {
    std::vector<std::byte> beginning = parameters();
    for (const Session& session : map.sessions) detail::append_session(beginning, session);
    for (Index i = 0; i < std::min(count(map.keyframes), detail::ChunkWriter<Files>::most_records); ++i)
      detail::append_keyframe(beginning, at(map.keyframes, i));
    writer_.start(detail::hash_of(beginning), parameters());
    if (!options_.scan_cache) return;
    const auto& file = writer_.file();
    scan_file_ = std::make_shared<detail::ScanFile>(file.target(), file.open_to_read(), options_.scan_cache);
    frame_file_ = std::make_shared<detail::FrameFile>(file.target(), file.open_to_read());
  }

  [[nodiscard]] std::vector<std::byte> parameters() const {
    const auto bytes = std::as_bytes(std::span(options_.parameters));
    return {bytes.begin(), bytes.end()};
  }

  void append_sessions(const SlamMap& map) {
    for (Index i = 0; i < count(map.sessions); ++i) {
      const Session& session = at(map.sessions, i);
      if (i < counts_.sessions && same(at(sessions_, i), session)) continue;
      std::vector<std::byte> payload;
      detail::append_session(payload, session);
      writer_.append(Type::session, 1, std::move(payload));
    }
    sessions_ = map.sessions;
    counts_.sessions = count(map.sessions);
  }

  /// Whether two records of a session are stored as the same bytes: all but the number of its keyframes.
  static bool same(const Session& a, const Session& b) {
    return a.first_keyframe == b.first_keyframe && a.frame == b.frame && a.name == b.name && a.prior == b.prior &&
           a.prior_sqrt_information == b.prior_sqrt_information;
  }

  void append_gnss(const SlamMap& map, Index first) {
    has_gnss_.resize(map.keyframes.size());
    std::vector<Index> fixed;
    for (Index i = first; i < count(map.keyframes); ++i)
      if (at(map.keyframes, i).gnss && !has_gnss_[static_cast<std::size_t>(i)]) fixed.push_back(i);
    writer_.append_records(Type::gnss, detail::gnss_bytes, 0, count(fixed), [&](auto& out, Index i) {
      const Keyframe& keyframe = at(map.keyframes, at(fixed, i));
      detail::append_gnss(out, keyframe.id, *keyframe.gnss, keyframe.gnss_arrival);
      has_gnss_[static_cast<std::size_t>(keyframe.id.value)] = true;
    });
  }

  void append_closures(const SlamMap& map, Index first, Index end) {
    writer_.append_records(Type::closures, detail::closure_bytes, first, end,
                           [&](auto& out, Index i) { detail::append_closure(out, at(map.closures, i)); });
    verdicts_.resize(static_cast<std::size_t>(std::max(end, count(verdicts_))));
    for (Index i = first; i < end; ++i) verdicts_[static_cast<std::size_t>(i)] = at(map.closures, i).verdict;
  }

  /// Closures whose verdicts in the file are no longer the map's, as many in one block as follow one another.
  void append_decided(const SlamMap& map) {
    const auto differs = [&](Index i) { return at(map.closures, i).verdict != at(verdicts_, i); };
    for (Index i = 0; i < counts_.closures; ++i) {
      if (!differs(i)) continue;
      const Index first = i;
      while (i < counts_.closures && differs(i)) ++i;
      append_closures(map, first, i);
    }
  }

  void append_poses(const SlamMap& map, Index first, Index end) {
    writer_.append_records(Type::poses, detail::pose_bytes, first, end,
                           [&](auto& out, Index i) { detail::append_pose(out, at(map.keyframes, i).T_map_body); });
    if (first == 0) posed_ = end;
  }

  /// Where sessions begin cannot be observed by odometry.
  void append_first_poses(const SlamMap& map, Index fresh) {
    for (Index i = std::max(fresh, Index{1}); i < count(map.keyframes); ++i)
      if (at(map.keyframes, i).session != at(map.keyframes, i - 1).session) append_poses(map, i, i + 1);
  }

  MapArchiveOptions options_;
  detail::ChunkWriter<Files> writer_;
  detail::MapCounts counts_;  ///< written so far
  std::vector<Session> sessions_;
  std::vector<ClosureVerdict> verdicts_;  ///< of closures, as written last
  std::vector<bool> has_gnss_;
  std::shared_ptr<detail::ScanFile> scan_file_;        ///< null: scans and frames stay where they are
  std::shared_ptr<detail::FrameFile> frame_file_;      ///< null together with `scan_file_`
  std::vector<detail::ScanFile::Place> unkept_scans_;  ///< written since the last sync
  std::size_t kept_frames_ = 0;                        ///< read from the file
  Index frames_ = 0;                                   ///< written so far
  Index posed_ = 0;                                    ///< keyframes that the last whole set of poses has
  bool in_doubt_ = false;                              ///< a call ended by an exception while it wrote
  bool unsynced_ = false;                              ///< a loss of power may lose what was committed
};

}  // namespace chainslam
