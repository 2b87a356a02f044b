#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "mapping.hpp"
#include "remote_session.hpp"
#include "session_task.hpp"
#include "session_workers.hpp"
#include "tasks/coordinator.hpp"

namespace chainslam::mpi {

/// The odometry of a run's sessions as tasks of a job. Their recordings are in OUT.sessions, next to the run's folder:
/// there they stay until the map is saved, and a run of the same sessions uses those that it finds.
class RecordedSessions final : public mapper::SessionWorkers {
 public:
  /// @param coordinator  of the job, whose processes do `SessionTask`s; must outlive the object.
  explicit RecordedSessions(tasks::Coordinator& coordinator) : coordinator_(coordinator) {}
  /// Says what is left of a run that did not end well.
  ~RecordedSessions() override;

  void begin(std::vector<std::unique_ptr<datasets::Dataset>>& datasets, std::span<const std::filesystem::path> given,
             const mapper::MappingRun& run, const std::filesystem::path& out) override;
  void complete(std::size_t session, mapper::SessionRun& run) override;
  void map_saved() override;

 private:
  struct Session {
    SessionTask task;
    std::string name;
    Index number = -1;                      ///< of its task; -1: nothing has to be done
    Index scans = 0;                        ///< expected; 0 if that is not known
    std::optional<SessionResult> result{};  ///< once it is known
  };
  [[nodiscard]] Session described(const datasets::Dataset& dataset, const std::filesystem::path& given,
                                  const mapper::MappingRun& run) const;
  void make_folder(const std::filesystem::path& out);
  [[nodiscard]] std::optional<RemoteSession::Recorded> await(Session& session, const mapper::MappingRun& run);
  void show_progress(const mapper::MappingRun& run);
  [[nodiscard]] std::size_t finished() const;

  tasks::Coordinator& coordinator_;
  std::filesystem::path folder_;
  int lock_ = -1;
  std::vector<std::unique_ptr<Session>> sessions_;  ///< of the run, in order; none for those that have odometry
};

}  // namespace chainslam::mpi
