#include <sqlite3.h>

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <map>
#include <utility>

#include "chainslam/core/error.hpp"
#include "datasets/ros_recording.hpp"

// rosbag2's SQLite files: tables topics(id, name, type, serialization_format, ...) and messages(id, topic_id, timestamp
// in ns, data), in the order of their recording. metadata.yaml beside them is not needed.

namespace chainslam::datasets {
namespace {

struct CloseDatabase {
  void operator()(sqlite3* database) const { sqlite3_close(database); }
};
struct FinishStatement {
  void operator()(sqlite3_stmt* statement) const { sqlite3_finalize(statement); }
};
using Statement = std::unique_ptr<sqlite3_stmt, FinishStatement>;

class Db3 final : public RosRecording {
 public:
  explicit Db3(const std::filesystem::path& path) : path_(path) {
    sqlite3* database = nullptr;
    const int opened = sqlite3_open_v2(path.c_str(), &database, SQLITE_OPEN_READONLY, nullptr);
    database_.reset(database);
    if (opened != SQLITE_OK) fail();
    // The file is data: it may define no function, view or trigger that runs, and no value of more than 256 MiB.
    for (const int option :
         {SQLITE_DBCONFIG_ENABLE_VIEW, SQLITE_DBCONFIG_ENABLE_TRIGGER, SQLITE_DBCONFIG_TRUSTED_SCHEMA})
      sqlite3_db_config(database, option, 0, nullptr);
    bytes_left_ = static_cast<std::int64_t>(std::filesystem::file_size(path));
    sqlite3_limit(database, SQLITE_LIMIT_LENGTH, static_cast<int>(std::min<std::int64_t>(bytes_left_ + 1, 256 << 20)));
    // Pages that point to each other in circles hold rows without end: a row takes some ten steps, and bytes of its
    // own.
    steps_left_ = 100'000 + bytes_left_;
    sqlite3_progress_handler(database, steps_at_once, count_steps, this);
    // Lets a file be read whose last pages are missing: what they held ends the reading.
    sqlite3_exec(database, "PRAGMA writable_schema = ON", nullptr, nullptr, nullptr);
    read_topics();
    messages_ = prepare("SELECT id, topic_id, timestamp, data FROM messages ORDER BY id");
  }

  std::optional<RosMessage> next() override {
    while (messages_) {
      const int step = sqlite3_step(messages_.get());
      if (step != SQLITE_ROW) {
        if (step != SQLITE_DONE)
          lose("after row " + std::to_string(row_) + ": " + sqlite3_errmsg(database_.get()) +
               "; what comes before is used");
        messages_.reset();
        return std::nullopt;
      }
      row_ = static_cast<std::uint64_t>(sqlite3_column_int64(messages_.get(), 0));
      const auto topic = topics_.find(sqlite3_column_int64(messages_.get(), 1));
      const std::int64_t time = sqlite3_column_int64(messages_.get(), 2);
      const void* data = sqlite3_column_blob(messages_.get(), 3);
      const int size = sqlite3_column_bytes(messages_.get(), 3);
      if ((bytes_left_ -= size) < 0) {
        lose("row " + std::to_string(row_) +
             ": the rows so far are larger than the file, which is damaged; what comes "
             "before is used");
        messages_.reset();
        return std::nullopt;
      }
      if (topic == topics_.end() || time < 0 || time > latest_nanoseconds || data == nullptr || size <= 0) {
        lose("row " + std::to_string(row_) + ": no topic, no time or no data; it is left out");
        continue;
      }
      return RosMessage{.topic = &topic->second,
                        .time = Timestamp::from_nanoseconds(time),
                        .data = {static_cast<const std::byte*>(data), static_cast<std::size_t>(size)},
                        .unit = "row",
                        .at = row_};
    }
    return std::nullopt;
  }

 private:
  static constexpr int steps_at_once = 1000;

  /// What SQLite calls on its way. @returns whether to stop.
  static int count_steps(void* self) { return (static_cast<Db3*>(self)->steps_left_ -= steps_at_once) < 0 ? 1 : 0; }

  [[noreturn]] void fail() const {
    throw_input_error(path_.string(), "",
                      std::string("no readable rosbag2 database: ") + sqlite3_errmsg(database_.get()),
                      "copy it again, or repair it with `sqlite3 FILE .recover`");
  }

  Statement prepare(const char* query) const {
    sqlite3_stmt* statement = nullptr;
    if (sqlite3_prepare_v2(database_.get(), query, -1, &statement, nullptr) != SQLITE_OK) fail();
    return Statement(statement);
  }

  void read_topics() {
    const Statement rows = prepare("SELECT id, name, type, serialization_format FROM topics");
    int step = SQLITE_ROW;
    while ((step = sqlite3_step(rows.get())) == SQLITE_ROW) {
      const auto text = [&](int column) {
        const auto* bytes = reinterpret_cast<const char*>(sqlite3_column_text(rows.get(), column));
        return std::string(bytes == nullptr ? "" : bytes);
      };
      if ((bytes_left_ -= sqlite3_column_bytes(rows.get(), 1) + sqlite3_column_bytes(rows.get(), 2)) < 0)
        throw_input_error(path_.string(), "", "a table of topics that is larger than the file",
                          "the file is damaged: copy it again, or repair it with `sqlite3 FILE .recover`");
      RosTopic topic{.name = text(1), .type = text(2), .encoding = MessageEncoding::cdr};
      if (text(3) != "cdr") topic.type += " as " + text(3);  // which is then no type that we read
      topics_.try_emplace(sqlite3_column_int64(rows.get(), 0), std::move(topic));
    }
    if (step != SQLITE_DONE) fail();
  }

  std::filesystem::path path_;
  std::unique_ptr<sqlite3, CloseDatabase> database_;
  std::map<std::int64_t, RosTopic> topics_;
  Statement messages_;
  std::uint64_t row_ = 0;
  std::int64_t bytes_left_ = 0;  ///< that rows may still hold: no more than the file does
  std::int64_t steps_left_ = 0;  ///< of SQLite's virtual machine
};

}  // namespace

std::unique_ptr<RosRecording> open_db3(const std::filesystem::path& path) { return std::make_unique<Db3>(path); }

}  // namespace chainslam::datasets
