#include "datasets/imu_table.hpp"

#include <algorithm>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "chainslam/core/types.hpp"
#include "chainslam/io/input_file.hpp"
#include "datasets/files.hpp"
#include "datasets/number_rows.hpp"

namespace chainslam::datasets {
namespace {

/// "#w_RS_S_x [rad s^-1]" becomes "w_rs_s_x".
std::string plain_name(std::string_view text) {
  std::string name;
  for (const char c : text.substr(0, text.find_first_of("[("))) {
    if (c >= 'A' && c <= 'Z')
      name += static_cast<char>(c + 32);
    else if (std::string_view(" \t#%\"").find(c) == std::string_view::npos)
      name += c;
  }
  return name;
}

bool is_one_of(std::string_view name, std::initializer_list<std::string_view> names) {
  return std::ranges::find(names, name) != names.end();
}

enum class Quantity { other, gyro, accel };

Quantity quantity_of(std::string_view name) {
  const auto has = [&](std::string_view part) { return name.find(part) != std::string_view::npos; };
  const auto is_short = [&](char letter) { return name[0] == letter && (name.size() == 2 || name[1] == '_'); };
  const bool rate = has("gyr") || has("angular") || has("ang_vel") || has("omega") || is_short('w') || is_short('g');
  const bool accel = has("acc") || is_short('a');
  if (rate == accel) return Quantity::other;  // neither, or an angular acceleration
  return rate ? Quantity::gyro : Quantity::accel;
}

std::vector<std::string> names_in(const InputFile& file, std::string_view header) {
  std::vector<std::string> names;
  for (LineFields fields(file, header, ','); fields.more();) names.push_back(plain_name(fields.text("name")));
  return names;
}

/// The columns, if all are named.
std::optional<ImuColumns> columns_named(const std::vector<std::string>& names) {
  std::optional<std::size_t> time;
  std::array<std::optional<std::size_t>, 6> axes;
  ImuColumns columns;
  for (std::size_t i = 0; i < names.size(); ++i) {
    const std::string_view name = names[i];
    if (!time && is_one_of(name, {"timestamp", "time", "t", "stamp", "utime", "sec", "secs"})) time = i;
    if (is_one_of(name, {"nsec", "nsecs", "nanosec"})) columns.nanoseconds = i;
    if (name.empty() || name.back() < 'x' || name.back() > 'z') continue;
    const auto axis = static_cast<std::size_t>(name.back() - 'x');
    const Quantity quantity = quantity_of(name);
    if (quantity == Quantity::other) continue;
    auto& place = axes[axis + (quantity == Quantity::accel ? 3 : 0)];
    if (!place) place = i;
  }
  if (!time || std::ranges::any_of(axes, [](const auto& place) { return !place; })) return std::nullopt;
  columns.time = *time;
  columns.named = names.size();
  for (std::size_t axis = 0; axis < 3; ++axis) {
    columns.gyro[axis] = *axes[axis];
    columns.accel[axis] = *axes[axis + 3];
  }
  return columns;
}

class ImuTable {
 public:
  ImuTable(const std::filesystem::path& path, const ImuColumns& columns) : file_(path), columns_(columns) {
    last_ = std::max({columns.time, columns.nanoseconds.value_or(0), std::ranges::max(columns.gyro),
                      std::ranges::max(columns.accel)});
  }

  std::optional<ImuSample> next(std::size_t& skipped) {
    while (const auto line = file_.read_line()) {
      const std::string_view text = detail::trimmed(*line);
      if (text.empty() || text.starts_with('#')) continue;
      LineFields fields(file_, text, ',');
      if (std::exchange(first_, false) && !detail::parse_double(fields.text("first"))) continue;  // names
      try {
        if (const auto sample = take(LineFields(file_, text, ','))) return sample;
        ++skipped;
      } catch (const IoError& error) {
        if (file_.line_ended()) throw;
        cut_ = cut_line(file_, error);
      }
    }
    return std::nullopt;
  }

  [[nodiscard]] const std::string& cut() const { return cut_; }

 private:
  std::optional<ImuSample> take(LineFields fields) {
    ImuSample sample;
    std::int64_t nanoseconds = 0;
    for (std::size_t i = 0; i <= last_; ++i) {
      const auto place_in = [&](const std::array<std::size_t, 3>& columns) {
        return static_cast<Eigen::Index>(std::ranges::find(columns, i) - columns.begin());
      };
      if (i == columns_.time) {
        const auto time = time_of(fields);
        if (!time) return std::nullopt;
        sample.time = *time;
      } else if (i == columns_.nanoseconds) {
        LineFields again = fields;
        nanoseconds = fields.integer("nanoseconds");
        if (nanoseconds < 0 || nanoseconds >= 1'000'000'000)
          again.fail("nanoseconds", std::to_string(nanoseconds), "write what is beyond the whole second, below 1e9");
      } else if (const auto axis = place_in(columns_.gyro); axis < 3) {
        sample.gyro[axis] = fields.number_or_nan("rate");
      } else if (const auto other = place_in(columns_.accel); other < 3) {
        sample.accel[other] = fields.number_or_nan("acceleration");
      } else {
        static_cast<void>(fields.text("field"));
      }
    }
    sample.time = sample.time + Duration(nanoseconds);
    if (columns_.named > 0) {
      for (std::size_t i = last_ + 1; i < columns_.named && fields.more(); ++i) static_cast<void>(fields.text("field"));
      fields.end("as many fields as the header names");
    }
    if (!is_finite(sample.gyro) || !is_finite(sample.accel)) return std::nullopt;
    return sample;
  }

  /// Whole numbers are nanoseconds or microseconds by their size, unless a column of their own counts nanoseconds.
  /// @returns nothing for a number that is no time.
  std::optional<Timestamp> time_of(LineFields& fields) const {
    LineFields again = fields;
    const std::string_view text = fields.text("time");
    const auto whole = detail::parse_integer(text);
    if (whole && !columns_.nanoseconds)
      if (const auto time = time_of_whole(*whole)) return time;
    if (detail::parse_double(text) && !detail::parse_seconds(text)) return std::nullopt;
    return again.time_in_seconds("time");
  }

  InputFile file_;
  ImuColumns columns_;
  std::size_t last_ = 0;  ///< column that is read
  bool first_ = true;     ///< whether no row has been read
  std::string cut_;
};

}  // namespace

ImuColumns imu_columns(const std::filesystem::path& path) {
  InputFile file(path);
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty()) continue;
    LineFields fields(file, text, ',');
    if (!text.starts_with('#') && detail::parse_double(fields.text("first"))) break;  // rows: there is no header
    if (const auto columns = columns_named(names_in(file, text))) return *columns;
    if (text.starts_with('#')) continue;  // a remark
    file.fail(file.place_of_line(), detail::shown(text),
              "name the columns: timestamp, gyro_x, gyro_y, gyro_z, acc_x, acc_y, acc_z");
  }
  return {};
}

void add_imu_table(ScanFiles& parts, const DatasetOptions& options, const std::filesystem::path& path,
                   const ImuColumns& columns) {
  const auto skipped = std::make_shared<std::size_t>(0);
  const auto reading = std::make_shared<std::shared_ptr<ImuTable>>();
  const std::string name = path.filename().string();
  add_imu(parts, options, name, [=] {
    *skipped = 0;
    *reading = std::make_shared<ImuTable>(path, columns);
    return [table = *reading, skipped] { return table->next(*skipped); };
  });
  parts.end.push_back([=] { return (*reading)->cut(); });
  parts.end.push_back([=] {
    return *skipped > 0 ? std::to_string(*skipped) + " rows of " + name + " skipped that hold no number, or no time"
                        : std::string();
  });
}

std::filesystem::path find_imu_table(const std::filesystem::path& folder) {
  for (const char* name : {"imu.csv", "imu_data.csv", "imu0/data.csv", "imu/imu.csv", "imu/data.csv", "ouster_imu.csv",
                           "ouster_imu/ouster_imu.csv", "ouster_imu/imu.csv"})
    if (std::filesystem::is_regular_file(folder / name)) return folder / name;
  return {};
}

}  // namespace chainslam::datasets
