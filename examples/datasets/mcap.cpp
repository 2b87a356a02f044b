#include <algorithm>
#include <array>
#include <cstring>
#include <map>
#include <string_view>
#include <utility>

#include "chainslam/io/input_file.hpp"
#include "datasets/chunk_codec.hpp"
#include "datasets/ros_recording.hpp"

// MCAP (mcap.dev/spec): between two magic numbers, records of a byte that says what they are, a length and a content.
// Messages, and the schemas and channels that they belong to, lie in chunks or side by side with them. The summary at
// the file's end is not needed, so that a recording which was interrupted is read as well.

namespace chainslam::datasets {
namespace {

constexpr std::string_view mcap_magic{"\x89MCAP0\r\n", 8};
constexpr std::size_t mcap_prefix = 9;  ///< a record's kind and length

enum McapOp : std::uint8_t {
  mcap_footer = 2,
  mcap_schema = 3,
  mcap_channel = 4,
  mcap_message = 5,
  mcap_chunk = 6,
  mcap_data_end = 15
};

/// CRC-32 as in zip, of which MCAP's chunks carry one.
std::uint32_t crc32(std::span<const std::byte> bytes) {
  constexpr auto table = [] {
    std::array<std::uint32_t, 256> values{};
    for (std::uint32_t i = 0; i < 256; ++i) {
      std::uint32_t value = i;
      for (int k = 0; k < 8; ++k) value = (value >> 1) ^ ((value & 1U) != 0 ? 0xEDB88320U : 0U);
      values[i] = value;
    }
    return values;
  }();
  std::uint32_t value = 0xFFFFFFFFU;
  for (const std::byte byte : bytes) value = table[(value ^ static_cast<std::uint8_t>(byte)) & 0xFFU] ^ (value >> 8);
  return ~value;
}

class Mcap final : public RosRecording {
 public:
  explicit Mcap(const std::filesystem::path& path) : file_(path) {
    file_.require(0, "records");
    std::array<std::byte, mcap_magic.size()> start{};
    if (file_.read_some(start) < start.size() || std::memcmp(start.data(), mcap_magic.data(), start.size()) != 0)
      file_.fail("byte 0", "no MCAP magic number", "give an .mcap file that is neither packed nor damaged");
  }

  std::optional<RosMessage> next() override {
    do {
      while (!rest_.empty()) {
        const std::uint64_t size = rest_.size() < mcap_prefix ? 0 : load_as<std::uint64_t>(rest_.data() + 1);
        if (rest_.size() < mcap_prefix || size > rest_.size() - mcap_prefix) {
          if (!cut_) lose(place() + "the chunk's last " + std::to_string(rest_.size()) + " bytes are no whole record");
          rest_ = {};
          break;
        }
        const auto op = static_cast<std::uint8_t>(rest_[0]);
        const auto content = rest_.subspan(mcap_prefix, static_cast<std::size_t>(size));
        rest_ = rest_.subspan(mcap_prefix + content.size());
        if (auto message = take(op, content)) return message;
      }
    } while (next_record());
    return std::nullopt;
  }

 private:
  [[nodiscard]] std::string place() const { return "byte " + std::to_string(at_) + ": "; }
  [[nodiscard]] std::uint64_t left() const { return *file_.size() - file_.offset(); }

  bool end(const std::string& what) {
    lose(place() + what + "; what comes before is used");
    ended_ = true;
    return false;
  }

  /// Reads the file's next record; its messages are then in `rest_`. False at the end of what can be read.
  bool next_record() {
    if (ended_) return false;
    at_ = file_.offset();
    if (left() < mcap_prefix) return end("the file ends before its footer: it was cut short, or the recording was");
    chunk_.resize(mcap_prefix);
    file_.read(chunk_, "a record's length");
    const auto op = static_cast<std::uint8_t>(chunk_[0]);
    const auto size = load_as<std::uint64_t>(chunk_.data() + 1);
    if (op == mcap_data_end || op == mcap_footer) {
      ended_ = true;
      return false;
    }
    if (op == 0) return end("a record of the kind 0: the file is damaged here");
    cut_ = size > left();
    if (cut_)
      end("the file ends after " + std::to_string(left()) + " of a record's " + std::to_string(size) + " bytes");
    const std::uint64_t there = std::min(size, left());
    if (op != mcap_schema && op != mcap_channel && op != mcap_message && op != mcap_chunk) {
      file_.skip(there, "a record");
      return !ended_;
    }
    chunk_.resize(mcap_prefix + static_cast<std::size_t>(there));
    file_.read(std::span(chunk_).subspan(mcap_prefix), "a record");
    rest_ = chunk_;
    if (op == mcap_chunk) open_chunk();
    return true;
  }

  void open_chunk() {
    rest_ = {};
    try {
      MessageReader fields(std::span<const std::byte>(chunk_).subspan(mcap_prefix), MessageEncoding::ros1);
      static_cast<void>(fields.take(16, "times"));
      const auto size = fields.number<std::uint64_t>("size");
      const auto crc = fields.number<std::uint32_t>("CRC");
      const std::string name = fields.text("compression");
      const auto packed_size = fields.number<std::uint64_t>("length");
      const std::size_t there = static_cast<std::size_t>(std::min<std::uint64_t>(packed_size, fields.left()));
      unpack_chunk(name, fields.take(there, "records"), size, there == packed_size ? crc : 0);
    } catch (const MessageError& error) {
      if (!cut_) lose(place() + "a damaged chunk (" + error.what() + "); it is left out");
    }
  }

  void unpack_chunk(const std::string& name, std::span<const std::byte> packed, std::uint64_t size, std::uint32_t crc) {
    const auto compression = compression_of(name);
    if (!compression || *compression == Compression::bz2) {
      lose(place() + "a chunk packed as \"" + name + "\", which is not known; it is left out");
      return;
    }
    Unpacked unpacked = unpacker_.unpack(*compression, packed, size);
    if (unpacked.fault.empty() && crc != 0 && crc32(unpacked.bytes) != crc) unpacked.fault = "its CRC is another";
    if (!unpacked.fault.empty() && !cut_) {
      lose(place() + "a chunk that does not unpack (" + unpacked.fault + "); it is left out");
      return;
    }
    chunk_ = std::move(unpacked.bytes);
    rest_ = chunk_;
  }

  /// A message, if the record is one; keeps what schemas and channels say.
  std::optional<RosMessage> take(std::uint8_t op, std::span<const std::byte> content) {
    try {
      MessageReader fields(content, MessageEncoding::ros1);  // packed, as ROS 1 packs
      if (op == mcap_schema) {
        const auto id = fields.number<std::uint16_t>("schema");
        schemas_[id] = fields.text("schema's name");
      } else if (op == mcap_channel) {
        add_channel(fields);
      } else if (op == mcap_message) {
        return message(fields);
      }
    } catch (const MessageError& error) {
      if (!cut_) lose(place() + "a damaged record (" + error.what() + "); it is left out");
    }
    return std::nullopt;
  }

  void add_channel(MessageReader& fields) {
    const auto id = fields.number<std::uint16_t>("channel");
    const auto schema = fields.number<std::uint16_t>("channel's schema");
    RosTopic topic{.name = fields.text("topic"), .type = schemas_[schema], .encoding = MessageEncoding::cdr};
    const std::string encoding = fields.text("encoding");
    if (encoding == "ros1")
      topic.encoding = MessageEncoding::ros1;
    else if (encoding != "cdr")
      topic.type += " as " + encoding;  // which is then no type that we read
    topics_.try_emplace(id, std::move(topic));
  }

  std::optional<RosMessage> message(MessageReader& fields) {
    const auto channel = fields.number<std::uint16_t>("message's channel");
    static_cast<void>(fields.number<std::uint32_t>("message's number"));
    const auto time = fields.number<std::uint64_t>("message's time");
    static_cast<void>(fields.number<std::uint64_t>("message's time"));
    const auto topic = topics_.find(channel);
    if (topic == topics_.end()) {
      if (unknown_++ == 0)
        lose(place() + "a message of channel " + std::to_string(channel) +
             ", which is not described; such are left out");
      return std::nullopt;
    }
    if (time > static_cast<std::uint64_t>(latest_nanoseconds))
      throw MessageError("the time " + std::to_string(time) + " ns");
    return RosMessage{.topic = &topic->second,
                      .time = Timestamp::from_nanoseconds(static_cast<std::int64_t>(time)),
                      .data = fields.take(fields.left(), "message"),
                      .unit = "byte",
                      .at = at_};
  }

  InputFile file_;
  std::map<std::uint16_t, std::string> schemas_;
  std::map<std::uint16_t, RosTopic> topics_;
  ChunkUnpacker unpacker_;
  std::vector<std::byte> chunk_;
  std::span<const std::byte> rest_;  ///< of the chunk, not yet read
  std::uint64_t at_ = 0;             ///< where the record that is being read starts
  std::size_t unknown_ = 0;          ///< messages of channels that are not described
  bool cut_ = false;                 ///< whether that record is not whole
  bool ended_ = false;
};

}  // namespace

std::unique_ptr<RosRecording> open_mcap(const std::filesystem::path& path) { return std::make_unique<Mcap>(path); }

}  // namespace chainslam::datasets
