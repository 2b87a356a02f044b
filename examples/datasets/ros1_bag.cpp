#include <array>
#include <cstring>
#include <map>
#include <string_view>
#include <utility>

#include "chainslam/io/input_file.hpp"
#include "datasets/chunk_codec.hpp"
#include "datasets/ros_recording.hpp"

// ROS 1 bag 2.0 (wiki.ros.org/Bags/Format/2.0): after a line of text, records of a header of fields `name=value` and of
// data, each behind its length. Messages and the connections that they belong to lie in chunks; the index at the
// file's end is not needed, so that a recording which was interrupted is read as well.

namespace chainslam::datasets {
namespace {

constexpr std::string_view bag_magic = "#ROSBAG V2.0\n";
constexpr std::uint32_t longest_bag_header = 1U << 20;

enum Op : std::uint8_t { message_op = 2, bag_op = 3, index_op = 4, chunk_op = 5, chunk_info_op = 6, connection_op = 7 };

using Bytes = std::span<const std::byte>;

/// A record's header: fields `name=value`, each behind its length.
class BagHeader {
 public:
  explicit BagHeader(Bytes bytes) : bytes_(bytes) {}

  /// A field's value; nothing if there is no such field, or the header is damaged before it.
  [[nodiscard]] std::optional<Bytes> value(std::string_view name) const {
    for (Bytes rest = bytes_; rest.size() >= 4;) {
      const auto size = load_as<std::uint32_t>(rest.data());
      if (size > rest.size() - 4) return std::nullopt;
      const Bytes field = rest.subspan(4, size);
      rest = rest.subspan(4 + size);
      if (field.size() > name.size() && std::memcmp(field.data(), name.data(), name.size()) == 0 &&
          field[name.size()] == std::byte{'='})
        return field.subspan(name.size() + 1);
    }
    return std::nullopt;
  }

  template <class T>
  [[nodiscard]] std::optional<T> number(std::string_view name) const {
    const auto bytes = value(name);
    return bytes && bytes->size() == sizeof(T) ? std::optional(load_as<T>(bytes->data())) : std::nullopt;
  }

  [[nodiscard]] std::string text(std::string_view name) const {
    const auto bytes = value(name);
    return bytes ? std::string(reinterpret_cast<const char*>(bytes->data()), bytes->size()) : std::string();
  }

 private:
  Bytes bytes_;
};

struct BagRecord {
  Bytes header, data;
};

/// Takes a record from the front of `rest`; nothing if it does not hold a whole one.
std::optional<BagRecord> take_record(Bytes& rest) {
  std::array<Bytes, 2> parts;
  Bytes left = rest;
  for (Bytes& part : parts) {
    if (left.size() < 4) return std::nullopt;
    const auto size = load_as<std::uint32_t>(left.data());
    if (size > left.size() - 4) return std::nullopt;
    part = left.subspan(4, size);
    left = left.subspan(4 + size);
  }
  rest = left;
  return BagRecord{parts[0], parts[1]};
}

class Ros1Bag final : public RosRecording {
 public:
  explicit Ros1Bag(const std::filesystem::path& path) : file_(path) {
    file_.require(0, "records");
    std::array<std::byte, bag_magic.size()> start{};
    if (file_.read_some(start) < start.size() || std::memcmp(start.data(), bag_magic.data(), bag_magic.size()) != 0)
      file_.fail("byte 0", "no line `#ROSBAG V2.0`",
                 "only ROS 1 bags of version 2.0 are read: convert an older one with `rosbag fix`");
  }

  std::optional<RosMessage> next() override {
    do {
      while (!rest_.empty()) {
        const auto record = take_record(rest_);
        if (!record) {
          if (!cut_)
            lose("byte " + std::to_string(at_) + ": the chunk's last " + std::to_string(rest_.size()) +
                 " bytes are no whole record");
          rest_ = {};
        } else if (auto message = take(*record)) {
          return message;
        }
      }
    } while (next_chunk());
    return std::nullopt;
  }

 private:
  [[nodiscard]] std::uint64_t left() const { return *file_.size() - file_.offset(); }

  bool end(const std::string& what) {
    lose("byte " + std::to_string(at_) + ": " + what + "; what comes before is used");
    ended_ = true;
    return false;
  }

  /// Reads the file's next record; its messages are then in `rest_`. False at the end of what can be read.
  bool next_chunk() {
    if (ended_) return false;
    at_ = file_.offset();
    if (left() == 0) {
      if (index_at_ > at_) return end("the file ends before its index: it was cut short");
      ended_ = true;
      return false;
    }
    std::array<std::byte, 4> size{};
    if (left() < 8) return end("the file ends within a record");
    file_.read(size, "a record's header");
    const auto header_size = load_as<std::uint32_t>(size.data());
    if (header_size > longest_bag_header)
      return end("a record's header of " + std::to_string(header_size) + " bytes: the file is damaged here");
    if (left() < std::uint64_t{header_size} + 4) return end("the file ends within a record's header");
    header_.resize(header_size);
    file_.read(header_, "a record's header");
    file_.read(size, "a record's data");
    const std::uint64_t data_size = load_as<std::uint32_t>(size.data());
    const auto op = BagHeader(header_).number<std::uint8_t>("op");
    if (!op || *op < message_op || *op > connection_op)
      return end("a record of no known kind: the file is damaged here");
    cut_ = data_size > left();
    if (cut_)
      end("the file ends after " + std::to_string(left()) + " of a record's " + std::to_string(data_size) + " bytes");
    return take(*op, std::min(data_size, left()));
  }

  /// Takes the data of a record of the file, or what is left of it.
  bool take(std::uint8_t op, std::uint64_t data_size) {
    if (op == bag_op) index_at_ = BagHeader(header_).number<std::uint64_t>("index_pos").value_or(0);
    if (op == bag_op || op == index_op || op == chunk_info_op) {
      file_.skip(data_size, "a record's data");
      return !ended_;
    }
    std::vector<std::byte> data(static_cast<std::size_t>(data_size));
    file_.read(data, "a record's data");
    if (op == chunk_op)
      unpack_chunk(std::move(data));
    else if (!cut_)
      make_chunk(data);
    return true;
  }

  /// A message or a connection outside of the chunks becomes a chunk of one record.
  void make_chunk(const std::vector<std::byte>& data) {
    chunk_.clear();
    append_bytes(chunk_, static_cast<std::uint32_t>(header_.size()));
    chunk_.insert(chunk_.end(), header_.begin(), header_.end());
    append_bytes(chunk_, static_cast<std::uint32_t>(data.size()));
    chunk_.insert(chunk_.end(), data.begin(), data.end());
    rest_ = chunk_;
  }

  void unpack_chunk(std::vector<std::byte> data) {
    const BagHeader header(header_);
    const auto compression = compression_of(header.text("compression"));
    const auto size = header.number<std::uint32_t>("size");
    rest_ = {};
    if (!compression || *compression == Compression::zstd || !size) {
      lose("byte " + std::to_string(at_) + ": a chunk packed as \"" + header.text("compression") +
           "\", which is not known; it is left out");
      return;
    }
    if (*compression == Compression::none) {
      chunk_ = std::move(data);
    } else {
      Unpacked unpacked = unpacker_.unpack(*compression, data, *size);
      if (!unpacked.fault.empty() && !cut_) {  // what came out before the fault may be wrong, too
        lose("byte " + std::to_string(at_) + ": a chunk that does not unpack (" + unpacked.fault + "); it is left out");
        return;
      }
      chunk_ = std::move(unpacked.bytes);
    }
    rest_ = chunk_;
  }

  /// A message, if the record is one; keeps what a connection says.
  std::optional<RosMessage> take(const BagRecord& record) {
    const BagHeader header(record.header);
    const auto op = header.number<std::uint8_t>("op");
    const auto connection = header.number<std::uint32_t>("conn");
    if (op == connection_op && connection) {
      const BagHeader about(record.data);
      topics_.try_emplace(*connection, RosTopic{header.text("topic"), about.text("type"), MessageEncoding::ros1});
      return std::nullopt;
    }
    const auto time = header.value("time");
    if (op != message_op || !connection || !time || time->size() != 8) return std::nullopt;
    const auto topic = topics_.find(*connection);
    if (topic == topics_.end()) {
      lose("byte " + std::to_string(at_) + ": messages of connection " + std::to_string(*connection) +
           ", which is not described; they are left out");
      topics_.try_emplace(*connection, RosTopic{"", "", MessageEncoding::ros1});
      return std::nullopt;
    }
    if (topic->second.name.empty()) return std::nullopt;
    return RosMessage{
        .topic = &topic->second,
        .time = Timestamp::from_nanoseconds(std::int64_t{load_as<std::uint32_t>(time->data())} * 1'000'000'000 +
                                            load_as<std::uint32_t>(time->data() + 4)),
        .data = record.data,
        .unit = "byte",
        .at = at_};
  }

  InputFile file_;
  std::map<std::uint32_t, RosTopic> topics_;
  ChunkUnpacker unpacker_;
  std::vector<std::byte> header_, chunk_;
  Bytes rest_;                  ///< of the chunk, not yet read
  std::uint64_t index_at_ = 0;  ///< where the bag's header says that its index is; 0 if it was never closed
  std::uint64_t at_ = 0;        ///< where the record that is being read starts
  bool cut_ = false;            ///< whether that record is not whole
  bool ended_ = false;
};

}  // namespace

std::unique_ptr<RosRecording> open_ros1_bag(const std::filesystem::path& path) {
  return std::make_unique<Ros1Bag>(path);
}

}  // namespace chainslam::datasets
