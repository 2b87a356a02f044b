#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "datasets/dataset.hpp"
#include "mapping_result.hpp"
#include "tasks/task_queue.hpp"

namespace chainslam::mpi {

/// Odometry of one session, recorded into a folder that all machines see.
struct SessionTask {
  std::string data;              ///< absolute path, or simulate:...
  std::filesystem::path set;     ///< absolute path of the recording
  std::string configuration;     ///< settings, as a file
  std::string input;             ///< all that the recording depends on: it is used again only for the same
  Index max_scans = 0;           ///< 0: all
  Index threads = 0;             ///< 0: the machine's cores, shared by the processes on it
  std::uint64_t max_memory = 0;  ///< bytes
};

/// What the recording of a session does not say.
struct SessionResult {
  mapper::SessionRun run;             ///< without odometry and truth
  std::vector<std::string> warnings;  ///< met while the data were read
  Index frames = 0;
};

/// What it is that a recording depends on: program, settings, number of scans, and the data's files by number, size and
/// date.
[[nodiscard]] std::string input_of(const std::string& data, const std::string& configuration, Index max_scans);
/// A name for the recording of `data`, another one for each input.
[[nodiscard]] std::string name_of_set(const std::string& session, const std::string& input);

/// @name Tasks, results and errors as they are sent and saved.
/// @{
[[nodiscard]] tasks::Bytes bytes_of(const SessionTask& task);
[[nodiscard]] SessionTask task_of(const tasks::Bytes& bytes);
[[nodiscard]] tasks::Bytes bytes_of(const SessionResult& result);
[[nodiscard]] SessionResult result_of(const tasks::Bytes& bytes);
[[nodiscard]] tasks::Bytes bytes_of(const IoError& error);
/// @returns nothing if the bytes are no such error, but a sentence.
[[nodiscard]] std::optional<IoError> error_of(const tasks::Bytes& bytes);
/// @}

/// The result of a recording of all data that was made of this input, whoever made it; else nothing.
[[nodiscard]] std::optional<SessionResult> finished_session(const std::filesystem::path& set, const std::string& input);

/// Opens the data and records odometry. @param show  called after each scan with how many were read, and of how many.
/// @throws IoError for data that cannot be read at all, and for a disk that cannot be written to.
[[nodiscard]] SessionResult record_session(const SessionTask& task, const std::function<void(Index, Index)>& show);

/// Opens what `map` takes for a session. @throws IoError, support::ConfigError
[[nodiscard]] std::unique_ptr<datasets::Dataset> open_session(const std::string& data,
                                                              const datasets::DatasetOptions& options);

}  // namespace chainslam::mpi
