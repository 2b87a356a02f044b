#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/io/detail/chunk_writer.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// A map file that a back end was given before all else, named by the run and identified by its content.
struct LoadedReference {
  std::string path;                                                                  ///< name of the map file
  std::uint64_t content = 0;                                                         ///< as `content_of`
  friend bool operator==(const LoadedReference&, const LoadedReference&) = default;  ///< whether all members are equal
};

/// Identifies a map file: a hash of all its chunks' headers, each of which has its payload's hash.
/// @throws IoError if it cannot be read.
[[nodiscard]] inline std::uint64_t content_of(const std::filesystem::path& path) {
  const detail::MapFileReader file(path);
  std::vector<std::byte> headers;
  for (const detail::PlacedChunk& chunk : file.chunks()) detail::append_chunk_header(headers, chunk.header);
  return detail::hash_of(headers);
}

/// A write-ahead journal: what a back end is to be given is in it first, so that a crash loses nothing of what still
/// waits, and the back end's work can be done again bit-identically (`read_input_journal`).
///
/// The file is NAME.partial, in the format of map files (map_archive.hpp); it stays when the journal goes without
/// `remove`, if anything was committed. After an IoError the journal takes nothing more.
template <class Files = RealFileSystem>
class InputJournal {
  static_assert(JournalFileSystem<Files>,
                "InputJournal: Files needs `int sync_data(int file)` and `int lock(int file)` beside what "
                "BasicAtomicFile's System has, as RealFileSystem has them; see chainslam/io/file_system.hpp");

 public:
  /// @param parameters  text of the configuration that the back end has.
  /// @param loaded      maps that it was given first.
  /// @throws IoError as `MapJournal`.
  explicit InputJournal(std::filesystem::path path, std::string parameters = {},
                        std::vector<LoadedReference> loaded = {}, Files files = {})
      : parameters_(std::move(parameters)),
        loaded_(std::move(loaded)),
        writer_(std::move(path), false, std::move(files)) {}

  /// Writes one input behind those before; a crash may lose it until `commit` has returned.
  /// @throws std::invalid_argument, before anything is written, for what no map can take: numbers that are not finite,
  /// times that do not ascend; IoError if the disk fails.
  void append(const MapInput& input) {
    std::visit([&](const auto& one) { add(one); }, input);
  }

  /// Makes the disk keep what was written: from then on, no crash and no loss of power loses it. @throws IoError
  void commit() {
    if (writer_.chunks() == committed_) return;
    writer_.append_commit(counts_);
    writer_.file().sync();
    committed_ = writer_.chunks();
  }

  /// Ends the journal and deletes its file: for when the map is finished, or nothing came of it.
  void remove() { writer_.file().remove(); }

  [[nodiscard]] Index keyframes() const { return counts_.keyframes; }  ///< keyframes written so far
  /// Where the file grows until it is finished.
  [[nodiscard]] const std::filesystem::path& path() const { return writer_.file().partial(); }

 private:
  using Type = detail::ChunkType;

  [[noreturn]] static void refuse(const char* what, const detail::Fault& fault) {
    throw std::invalid_argument("InputJournal: " + std::string(what) + ", " + fault.field + ": " + fault.found);
  }

  void add(const SessionStart& start) {
    const SessionId id{counts_.sessions};
    Session session;
    session.id = session.frame = id;
    session.name = start.name;
    session.first_keyframe = counts_.keyframes;
    if (auto fault = detail::fault_of(session)) refuse("session", *fault);
    std::vector<std::byte> payload;
    detail::append_session(payload, session);
    if (writer_.chunks() == 0) begin(payload);
    writer_.append(Type::session, 1, std::move(payload));
    ++counts_.sessions;
  }

  void add(Keyframe keyframe) {
    keyframe.id = KeyframeId{counts_.keyframes};
    keyframe.session = require_session();
    if (auto fault = detail::fault_of(keyframe, last_ ? &*last_ : nullptr, counts_.sessions))
      refuse("keyframe", *fault);
    if (keyframe.gnss)
      if (auto fault = detail::fault_of(*keyframe.gnss)) refuse("GNSS fix of a keyframe", *fault);
    const Index number = counts_.keyframes++;
    writer_.append_records(Type::keyframes, detail::keyframe_bytes, number, number + 1,
                           [&](auto& out, Index) { detail::append_keyframe(out, keyframe); });
    if (keyframe.gnss) add_fix(Type::gnss, keyframe.id, *keyframe.gnss);
    if (keyframe.cloud) {
      writer_.append_scan(keyframe.id, keyframe.cloud);
      ++counts_.scans;
    }
    last_ = std::move(keyframe);
  }

  /// A fix that no map takes is none: the back end leaves it out as well.
  void add(const GnssFix& fix) {
    if (detail::fault_of(fix) || fix.quality == GnssQuality::none) return;
    static_cast<void>(require_session());
    add_fix(Type::fixes, KeyframeId{-1}, fix);
  }

  void add(const std::vector<FrameRecord>& frames) {
    const SessionId session = require_session();
    std::vector<FrameRecord> records = frames;
    for (FrameRecord& frame : records) {
      frame.session = session;
      if (auto fault = detail::fault_of(frame, last_frame_ ? &*last_frame_ : nullptr, counts_.sessions))
        refuse("frame", *fault);
      last_frame_ = frame;
    }
    writer_.append_records(
        Type::frames, detail::frame_bytes, frames_, frames_ + to_index(records.size()),
        [&](auto& out, Index i) { detail::append_frame(out, records[static_cast<std::size_t>(i - frames_)]); });
    frames_ += to_index(records.size());
  }

  void add_fix(Type type, KeyframeId keyframe, const GnssFix& fix) {
    writer_.append_records(type, detail::gnss_bytes, 0, 1,
                           [&](auto& out, Index) { detail::append_gnss(out, keyframe, fix); });
  }

  [[nodiscard]] SessionId require_session() {
    if (counts_.sessions == 0) add(SessionStart{});
    return SessionId{counts_.sessions - 1};
  }

  /// @param first  what the file begins with, for its id.
  void begin(std::vector<std::byte> first) {
    const auto bytes_of = [](const std::string& text) {
      const auto bytes = std::as_bytes(std::span(text));
      return std::vector<std::byte>(bytes.begin(), bytes.end());
    };
    const std::vector<std::byte> parameters = bytes_of(parameters_);
    first.insert(first.end(), parameters.begin(), parameters.end());
    writer_.start(detail::hash_of(first), parameters);
    for (const LoadedReference& reference : loaded_) {
      std::vector<std::byte> payload;
      append_bytes(payload, reference.content);
      const std::vector<std::byte> path = bytes_of(reference.path);
      payload.insert(payload.end(), path.begin(), path.end());
      writer_.append(Type::loaded, 1, std::move(payload));
    }
  }

  std::string parameters_;
  std::vector<LoadedReference> loaded_;
  detail::ChunkWriter<Files> writer_;
  std::uint64_t committed_ = 0;  ///< chunks
  detail::MapCounts counts_;
  Index frames_ = 0;
  std::optional<Keyframe> last_;
  std::optional<FrameRecord> last_frame_;
};

/// What an `InputJournal` holds.
struct JournaledInput {
  std::vector<MapInput> inputs;         ///< in the order in which they were written
  std::string parameters;               ///< text of the configuration that made it
  std::vector<LoadedReference> loaded;  ///< maps that were loaded before
  Index keyframes = 0;                  ///< keyframes in it
  std::uint64_t ignored_bytes = 0;      ///< at the end, after the last commit that could be used
  std::vector<std::string> problems;    ///< what was damaged and where, a sentence each
};

namespace detail {

inline GnssFix read_fix(const MapFileReader& file, std::size_t number) {
  const std::vector<std::byte> payload = file.payload(number).value();
  if (payload.size() < block_prelude_bytes + gnss_bytes_before_1_4 || file.chunks()[number].header.count != 1)
    file.fail(file.place(number), std::to_string(payload.size()) + " bytes", MapFileReader::written_wrongly);
  ByteReader in(std::span<const std::byte>(payload).subspan(block_prelude_bytes));
  static_cast<void>(in.take<Index>());
  const GnssFix fix = read_gnss(in);
  if (const auto fault = fault_of(fix))
    file.fail(file.place(number) + ", " + fault->field, fault->found, MapFileReader::written_wrongly);
  return fix;
}

/// The inputs that the chunks up to a commit hold; `map` is what they say as a map.
/// @throws IoError if a map's chunks stand where a journal of inputs has none: sessions, for one, are stated again
/// there.
inline JournaledInput inputs_of(const MapFileReader& file, std::size_t commit, SlamMap map) {
  JournaledInput recorded;
  std::size_t sessions = 0, keyframes = 0, frames = 0;
  const auto require = [&](std::size_t number, std::size_t used, std::size_t wanted, std::size_t all,
                           const char* what) {
    if (wanted > all - used)
      file.fail(file.place(number), std::string(what) + " that the journal had already",
                "this is no journal of inputs: give map.cslam.partial to `chainslam recover` if it is a map's");
  };
  for (std::size_t number = 0; number <= commit; ++number) {
    const ChunkHeader& header = file.chunks()[number].header;
    if (header.is(ChunkType::session)) {
      require(number, sessions, 1, map.sessions.size(), "a session");
      recorded.inputs.emplace_back(SessionStart{map.sessions[sessions++].name});
    } else if (header.is(ChunkType::keyframes)) {
      require(number, keyframes, header.count, map.keyframes.size(), "keyframes");
      for (std::uint32_t i = 0; i < header.count; ++i)
        recorded.inputs.emplace_back(std::move(map.keyframes[keyframes++]));
    } else if (header.is(ChunkType::frames)) {
      require(number, frames, header.count, map.frames.size(), "frames");
      recorded.inputs.emplace_back(map.frames.copy(frames, frames + header.count));
      frames += header.count;
    } else if (header.is(ChunkType::fixes)) {
      recorded.inputs.emplace_back(read_fix(file, number));
    } else if (header.is(ChunkType::loaded)) {
      const std::vector<std::byte> payload = file.payload(number).value();
      if (payload.size() < sizeof(std::uint64_t))
        file.fail(file.place(number), std::to_string(payload.size()) + " bytes", MapFileReader::written_wrongly);
      const char* path = reinterpret_cast<const char*>(payload.data()) + sizeof(std::uint64_t);
      recorded.loaded.push_back(
          {std::string(path, payload.size() - sizeof(std::uint64_t)), load_as<std::uint64_t>(payload.data())});
    }
  }
  recorded.keyframes = to_index(keyframes);
  return recorded;
}

}  // namespace detail

/// Reads what an `InputJournal` had committed, up to the first damage.
/// @param scan_cache  as that of `MapLoadOptions`.
/// @throws IoError if the file cannot be read, breaks the format's rules, or nothing was committed.
[[nodiscard]] inline JournaledInput read_input_journal(const std::filesystem::path& path,
                                                       std::shared_ptr<ScanCache> scan_cache = {}) {
  const detail::MapFileReader file(path);
  std::size_t sound = 0;
  while (sound < file.chunks().size() && file.stored_payload(sound)) ++sound;
  const auto commit = detail::last_commit_before(file, sound);
  if (!commit) file.fail("", "no complete commit", "there is nothing to save in it: make the map again");
  const MapLoadOptions options{.recover = true, .scan_cache = std::move(scan_cache)};
  detail::MapDecoder decoder(file, options, *commit);
  if (decoder.run()) file.fail("", "damage that comes and goes", "check the disk");
  LoadedMap loaded = decoder.take();
  JournaledInput recorded = detail::inputs_of(file, *commit, std::move(loaded.map));
  recorded.parameters = std::move(loaded.parameters);
  recorded.ignored_bytes = file.size() - file.chunks()[*commit].end();
  if (sound < file.chunks().size()) recorded.problems.push_back(file.place(sound) + ": damaged");
  return recorded;
}

}  // namespace chainslam
