#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "chainslam/io/detail/frame_file.hpp"
#include "chainslam/io/detail/map_file_reader.hpp"
#include "chainslam/io/detail/map_records.hpp"
#include "chainslam/io/detail/scan_codec.hpp"
#include "chainslam/io/detail/scan_file.hpp"
#include "chainslam/io/loaded_map.hpp"

namespace chainslam::detail {

/// Builds the map that a file's chunks, up to one of its commits, describe.
class MapDecoder {
 public:
  MapDecoder(const MapFileReader& file, const MapLoadOptions& options, std::size_t commit)
      : file_(file), options_(options), commit_(commit) {}

  /// @returns the number of the first damaged chunk without which the map would be another, nothing if it was built.
  /// @throws IoError if a record breaks the format's rules.
  [[nodiscard]] std::optional<std::size_t> run() {
    loaded_.id = file_.header().file_id;
    for (std::size_t number = 0; number <= commit_; ++number) {
      const ChunkHeader& header = file_.chunks()[number].header;
      if (header.is(ChunkType::scan) && ++scans_ && !options_.scans) continue;
      if (header.is(ChunkType::refusals)) refusals_ += header.count;
      if (apply(number, header)) continue;
      if (!may_be_lost(header)) return number;
      loaded_.report.problems.push_back(file_.place(number) + ": damaged");
      refusals_lost_ |= header.is(ChunkType::refusals);
      frames_lost_ |= header.is(ChunkType::frames);
      scan_lost_ |= header.is(ChunkType::scan);
    }
    finish();
    return std::nullopt;
  }

  [[nodiscard]] LoadedMap take() { return std::move(loaded_); }

 private:
  /// Records of one chunk, each `size` bytes, of which this version knows the first ones.
  struct Block {
    Index first;
    std::size_t size;
    std::span<const std::byte> records;

    [[nodiscard]] ByteReader record(std::size_t i) const { return ByteReader(records.subspan(i * size, size)); }
  };

  static bool may_be_lost(const ChunkHeader& header) {
    return !header.is_critical() || header.is(ChunkType::scan) || header.is(ChunkType::poses) ||
           header.is(ChunkType::gnss);
  }

  [[noreturn]] void fail(std::size_t number, const std::string& field, std::string found) const {
    const bool newer = file_.header().minor > map_minor;
    file_.fail(file_.place(number) + (field.empty() ? "" : ", " + field), std::move(found),
               newer ? "take a newer version of the program: this one may not know all that the file says"
                     : MapFileReader::written_wrongly);
  }

  [[noreturn]] void fail(std::size_t number, std::size_t record, const Fault& fault) const {
    fail(number, "record " + std::to_string(record) + ", " + fault.field, fault.found);
  }

  void check(std::size_t number, std::size_t record, const MaybeFault& fault) const {
    if (fault) fail(number, record, *fault);
  }

  /// False if the payload is damaged.
  bool apply(std::size_t number, const ChunkHeader& header) {
    if (!is_known_chunk(header.type)) return keep_unknown(number, header);
    if (header.is(ChunkType::scan) && options_.scan_cache) return leave_scan(number);
    const auto payload = file_.payload(number);
    if (!payload) return false;
    switch (static_cast<ChunkType>(header.type)) {
      case ChunkType::parameters:
        loaded_.parameters.assign(reinterpret_cast<const char*>(payload->data()), payload->size());
        break;
      case ChunkType::session:
        add_session(number, *payload);
        break;
      case ChunkType::keyframes:
        each(number, *payload, keyframe_bytes, &MapDecoder::add_keyframe);
        break;
      case ChunkType::scan:
        add_scan(number, *payload);
        break;
      case ChunkType::odometry:
        each(number, *payload, odometry_bytes, &MapDecoder::add_odometry);
        break;
      case ChunkType::closures:
        each(number, *payload, closure_bytes, &MapDecoder::add_closure);
        break;
      case ChunkType::refusals:
        each(number, *payload, closure_bytes, &MapDecoder::add_refusal);
        break;
      case ChunkType::poses:
        each(number, *payload, pose_bytes, &MapDecoder::set_pose);
        break;
      case ChunkType::gnss:
        each(number, *payload, gnss_bytes, &MapDecoder::set_gnss, gnss_bytes_before_1_4);
        break;
      case ChunkType::frames:
        each(number, *payload, frame_bytes, &MapDecoder::add_frame, frame_bytes_before_1_3);
        if (options_.scan_cache) leave_frames(number, *payload);
        break;
      case ChunkType::commit:
        check_commit(number, *payload);
        break;
      case ChunkType::fixes:
      case ChunkType::loaded:
        break;  // what a back end was given, which is no part of a map
      case ChunkType::index:
      case ChunkType::end:
        fail(number, "", "the end of the map, with more behind it");
    }
    return true;
  }

  bool keep_unknown(std::size_t number, const ChunkHeader& header) {
    auto stored = file_.stored_payload(number);
    if (!stored) return false;
    ++loaded_.report.unknown_chunks;
    loaded_.unknown.push_back(
        {header.type, header.version, header.codec, header.count, header.raw_bytes, std::move(*stored)});
    return true;
  }

  using AddRecord = void (MapDecoder::*)(std::size_t number, std::size_t i, Index id, ByteReader in);

  /// @param earlier_bytes  what a record had in earlier versions of the format, if it has grown since.
  void each(std::size_t number, std::span<const std::byte> payload, std::size_t known_bytes, AddRecord add,
            std::optional<std::size_t> earlier_bytes = {}) {
    const std::uint64_t count = file_.chunks()[number].header.count;
    if (payload.size() < block_prelude_bytes) fail(number, "payload", std::to_string(payload.size()) + " bytes");
    ByteReader in(payload);
    const Index first = in.take<Index>();
    const std::size_t size = in.take<std::uint32_t>();
    if ((size < known_bytes && size != earlier_bytes) || count * size != payload.size() - block_prelude_bytes)
      fail(number, "record size",
           std::to_string(size) + " bytes, " + std::to_string(count) + " records in " + std::to_string(payload.size()) +
               " bytes");
    if (first < 0 || !std::in_range<Index>(std::int64_t{first} + static_cast<std::int64_t>(count)))
      fail(number, "first record", std::to_string(first));
    loaded_.report.newer_fields |= size > known_bytes;
    const Block block{first, size, payload.subspan(block_prelude_bytes)};
    for (std::size_t i = 0; i < count; ++i) (this->*add)(number, i, first + static_cast<Index>(i), block.record(i));
  }

  [[nodiscard]] SE3d take_pose(std::size_t number, std::size_t i, const char* field, ByteReader& in) const {
    const StoredPose stored = read_pose(in);
    check(number, i, fault_of(field, stored.translation, stored.quaternion));
    return stored.pose();
  }

  void require_next(std::size_t number, std::size_t i, Index id, const auto& records) const {
    if (id != std::ssize(records))
      fail(number, i, {"number", std::to_string(id) + ", after " + std::to_string(records.size()) + " of its kind"});
  }

  void add_session(std::size_t number, std::span<const std::byte> payload) {
    if (payload.size() < session_bytes) fail(number, "payload", std::to_string(payload.size()) + " bytes");
    ByteReader in(payload);
    Session session;
    session.id.value = in.take<Index>();
    session.first_keyframe = in.take<Index>();
    session.frame.value = in.take<Index>();
    const std::size_t name_bytes = in.take<std::uint32_t>();
    session.prior = take_pose(number, 0, "prior", in);
    session.prior_sqrt_information = read_matrix<6>(in);
    if (name_bytes > in.left()) fail(number, "name", "a text of " + std::to_string(name_bytes) + " bytes");
    const auto name = in.take(name_bytes);
    session.name.assign(reinterpret_cast<const char*>(name.data()), name.size());
    loaded_.report.newer_fields |= in.left() > 0;
    check(number, 0, fault_of(session));
    auto& sessions = loaded_.map.sessions;
    const Index count = static_cast<Index>(sessions.size());
    check(number, 0, fault_of_number("id", session.id.value, 0, count + 1, "sessions and a new one"));
    if (session.id.value == count) {
      sessions.push_back(std::move(session));
      return;
    }
    Session& old = sessions[static_cast<std::size_t>(session.id.value)];
    if (old.first_keyframe != session.first_keyframe)
      fail(number, 0, {"first keyframe", std::to_string(session.first_keyframe) + ", which was another before"});
    session.keyframes = old.keyframes;
    old = std::move(session);
  }

  void add_keyframe(std::size_t number, std::size_t i, Index id, ByteReader in) {
    auto& keyframes = loaded_.map.keyframes;
    require_next(number, i, id, keyframes);
    Keyframe keyframe;
    keyframe.id.value = id;
    keyframe.time = Timestamp::from_nanoseconds(in.take<std::int64_t>());
    keyframe.session.value = in.take<Index>();
    const std::uint32_t flags = in.take<std::uint32_t>();
    keyframe.T_odom_body = take_pose(number, i, "T_odom_body", in);
    const Keyframe* before = keyframes.empty() ? nullptr : &keyframes.back();
    check(number, i, fault_of(keyframe, before, static_cast<Index>(loaded_.map.sessions.size())));
    Session& session = loaded_.map.sessions[static_cast<std::size_t>(keyframe.session.value)];
    if (session.end_keyframe() != id)
      fail(number, i, {"session", "one whose next keyframe is " + std::to_string(session.end_keyframe())});
    ++session.keyframes;
    keyframes.push_back(std::move(keyframe));
    wants_scan_.push_back((flags & keyframe_has_scan) != 0);
    has_pose_.push_back(false);
  }

  void add_odometry(std::size_t number, std::size_t i, Index id, ByteReader in) {
    require_next(number, i, id, loaded_.map.odometry);
    OdometryMeasurement step;
    step.from.value = in.take<Index>();
    step.to.value = in.take<Index>();
    step.T_from_to = take_pose(number, i, "T_from_to", in);
    step.sqrt_information = read_matrix<6>(in);
    check(number, i, fault_of(step, keyframes()));
    loaded_.map.odometry.push_back(step);
  }

  void add_closure(std::size_t number, std::size_t i, Index id, ByteReader in) {
    auto& closures = loaded_.map.closures;
    if (id >= std::ssize(closures)) require_next(number, i, id, closures);
    const LoopClosure closure = read_closure(number, i, in);
    if (id == std::ssize(closures))
      closures.push_back(closure);
    else  // it was decided otherwise since
      closures[static_cast<std::size_t>(id)] = closure;
  }
  void add_refusal(std::size_t number, std::size_t i, Index id, ByteReader in) {
    if (!refusals_lost_) require_next(number, i, id, loaded_.map.refusals);
    loaded_.map.refusals.push_back(read_closure(number, i, in));
  }

  [[nodiscard]] LoopClosure read_closure(std::size_t number, std::size_t i, ByteReader& in) const {
    LoopClosure closure;
    closure.from.value = in.take<Index>();
    closure.to.value = in.take<Index>();
    closure.kind = static_cast<ClosureKind>(in.take<std::uint16_t>());
    closure.verdict = static_cast<ClosureVerdict>(in.take<std::uint16_t>());
    closure.cause = in.take<Index>();
    closure.T_from_to = take_pose(number, i, "T_from_to", in);
    closure.sqrt_information = read_matrix<6>(in);
    closure.mean_squared_error = in.take<double>();
    closure.inlier_ratio = in.take<double>();
    MapCounts counts;
    counts.keyframes = keyframes();
    counts.closures = std::numeric_limits<Index>::max();  // causes are checked when all closures are there
    check(number, i, fault_of(closure, counts));
    return closure;
  }

  void set_pose(std::size_t number, std::size_t i, Index id, ByteReader in) {
    check(number, i, fault_of_number("keyframe", id, 0, keyframes(), "keyframes"));
    loaded_.map.keyframes[static_cast<std::size_t>(id)].T_map_body = take_pose(number, i, "T_map_body", in);
    has_pose_[static_cast<std::size_t>(id)] = true;
  }

  void set_gnss(std::size_t number, std::size_t i, Index, ByteReader in) {
    const Index id = in.take<Index>();
    check(number, i, fault_of_number("keyframe", id, 0, keyframes(), "keyframes"));
    const GnssFix fix = read_gnss(in);
    check(number, i, fault_of(fix));
    Keyframe& keyframe = loaded_.map.keyframes[static_cast<std::size_t>(id)];
    keyframe.gnss = fix;
    keyframe.gnss_arrival = read_gnss_arrival(in);
    check(number, i, fault_of_arrival(keyframe, keyframes()));
  }

  void add_frame(std::size_t number, std::size_t i, Index id, ByteReader in) {
    auto& frames = loaded_.map.frames;
    if (!frames_lost_) require_next(number, i, id, frames);
    const FrameRecord frame = read_frame(in, [&] { return take_pose(number, i, "T_odom_body", in); });
    const FrameRecord* const before = frames.empty() ? nullptr : &frames.back();
    check(number, i, fault_of(frame, before, static_cast<Index>(loaded_.map.sessions.size())));
    frames.push_back(frame);
  }

  /// Leaves frames that the map has in the file.
  void leave_frames(std::size_t number, std::span<const std::byte> payload) {
    if (!frame_file_) frame_file_ = std::make_shared<FrameFile>(file_.path(), file_.duplicate());
    frame_file_->add(payload, file_.chunks()[number].offset + map_header_bytes);
    const FrameRecords& frames = loaded_.map.frames;
    frames_left_ = frames.keep_in(frame_file_, frames_left_, frames.size());
  }

  void add_scan(std::size_t number, std::span<const std::byte> payload) {
    const ChunkHeader& header = file_.chunks()[number].header;
    if (header.version != 1) fail(number, "version", std::to_string(header.version) + ", where 1 is known");
    if (payload.size() < scan_head_bytes) fail(number, "payload", std::to_string(payload.size()) + " bytes");
    ByteReader in(payload);
    const ScanHead head = read_scan_head(in);
    check(number, 0, fault_of_number("keyframe", head.keyframe.value, 0, keyframes(), "keyframes"));
    if (const auto fault = fault_of(head, header.count, in.left())) fail(number, fault->field, fault->found);
    const std::size_t id = static_cast<std::size_t>(head.keyframe.value);
    if (!wants_scan_[id]) fail(number, "keyframe", std::to_string(id) + ", which has no scan or has it already");
    wants_scan_[id] = false;
    loaded_.map.keyframes[id].cloud = std::make_shared<const PointCloud<float>>(read_scan_body(head, in));
  }

  /// Leaves a scan in the file; false if its payload is damaged. Only the packed payload names its keyframe: it is
  /// taken to be the next that has a scan, which reading checks.
  bool leave_scan(std::size_t number) {
    const PlacedChunk& chunk = file_.chunks()[number];
    if (chunk.header.version != 1) fail(number, "version", std::to_string(chunk.header.version) + ", where 1 is known");
    while (next_scan_ < wants_scan_.size() && !wants_scan_[next_scan_]) ++next_scan_;
    if (next_scan_ == wants_scan_.size()) fail(number, "keyframe", "none that has a scan is left");
    const std::size_t id = next_scan_++;
    if (!file_.stored_payload(number)) return false;
    if (!scan_file_) scan_file_ = std::make_shared<ScanFile>(file_.path(), file_.duplicate(), options_.scan_cache);
    wants_scan_[id] = false;
    Keyframe& keyframe = loaded_.map.keyframes[id];
    keyframe.cloud = scan_file_->scan({keyframe.id, chunk});
    return true;
  }

  void check_commit(std::size_t number, std::span<const std::byte> payload) {
    constexpr std::size_t commit_bytes = 32;
    if (payload.size() < commit_bytes) fail(number, "payload", std::to_string(payload.size()) + " bytes");
    ByteReader in(payload);
    MapCounts stated;
    for (Index* count :
         {&stated.sessions, &stated.keyframes, &stated.scans, &stated.odometry, &stated.closures, &stated.refusals})
      *count = in.take<Index>();
    const auto size = [](const auto& records) { return static_cast<Index>(records.size()); };
    const SlamMap& map = loaded_.map;
    const auto compare = [&](const char* what, Index claimed, std::int64_t found) {
      if (claimed != found)
        fail(number, what, std::to_string(claimed) + ", where " + std::to_string(found) + " were before it");
    };
    compare("sessions", stated.sessions, size(map.sessions));
    compare("keyframes", stated.keyframes, size(map.keyframes));
    compare("scans", stated.scans, scans_);
    compare("odometry", stated.odometry, size(map.odometry));
    compare("closures", stated.closures, size(map.closures));
    compare("refusals", stated.refusals, refusals_);
    ++loaded_.report.commits;
  }

  /// What can only be checked or filled in when all is there.
  void finish() {
    SlamMap& map = loaded_.map;
    const Index sessions = static_cast<Index>(map.sessions.size()), closures = static_cast<Index>(map.closures.size());
    for (const Session& session : map.sessions)
      if (auto fault = fault_of_number("frame", session.frame.value, -1, sessions, "sessions"))
        fail(commit_, "session " + std::to_string(session.id.value) + ", frame", fault->found);
    for (const auto* list : {&map.closures, &map.refusals})
      for (const LoopClosure& closure : *list)
        if (auto fault = fault_of_number("cause", closure.cause, -1, closures, "closures"))
          fail(commit_, "closure to keyframe " + std::to_string(closure.to.value) + ", cause", fault->found);
    for (Keyframe& keyframe : map.keyframes) {
      const std::size_t id = static_cast<std::size_t>(keyframe.id.value);
      if (!has_pose_[id]) place_by_odometry(id);
      if (!options_.scans || !wants_scan_[id]) continue;
      if (!scan_lost_) fail(commit_, "scan of keyframe " + std::to_string(id), "none in the file");
      loaded_.report.scans_lost.push_back(keyframe.id);
    }
  }

  void place_by_odometry(std::size_t id) {
    Keyframe& keyframe = loaded_.map.keyframes[id];
    const Session& session = loaded_.map.sessions[static_cast<std::size_t>(keyframe.session.value)];
    ++loaded_.report.poses_by_odometry;
    if (keyframe.id.value > session.first_keyframe) {
      const Keyframe& before = loaded_.map.keyframes[id - 1];
      keyframe.T_map_body = before.T_map_body * (before.T_odom_body.inverse() * keyframe.T_odom_body);
    } else {
      keyframe.T_map_body = session.prior_sqrt_information.isZero(0) ? keyframe.T_odom_body : session.prior;
    }
  }

  [[nodiscard]] Index keyframes() const { return static_cast<Index>(loaded_.map.keyframes.size()); }

  const MapFileReader& file_;
  const MapLoadOptions& options_;
  std::size_t commit_;
  LoadedMap loaded_;
  std::vector<bool> wants_scan_, has_pose_;
  std::shared_ptr<ScanFile> scan_file_;  ///< null while no scan is left in the file
  std::size_t next_scan_ = 0;            ///< keyframe that the next scan left there belongs to, at the earliest
  std::shared_ptr<FrameFile> frame_file_;
  std::size_t frames_left_ = 0;  ///< in the file
  std::int64_t scans_ = 0, refusals_ = 0;
  bool scan_lost_ = false, refusals_lost_ = false, frames_lost_ = false;
};

}  // namespace chainslam::detail
