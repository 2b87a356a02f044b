#pragma once

#include <functional>

#include "datasets/dataset.hpp"
#include "datasets/odometry_recording.hpp"
#include "mapping.hpp"
#include "mapping_result.hpp"
#include "options.hpp"
#include "support/progress.hpp"

namespace chainslam::mapper {

/// Called after each scan.
using ShowProgress = std::function<void(const support::ProgressState&)>;

/// Runs odometry on a data set and records it, to the end of the data or until the run is to stop.
/// @param show  where that is shown; if empty, as the run's progress.
/// @returns the session, and a map of it without scans and closures. @throws IoError
[[nodiscard]] MappingResult record_odometry(datasets::Dataset& dataset, const MappingRun& run,
                                            datasets::OdometryRecording& recording, const ShowProgress& show = {});

/// The description of a session's recording, for its `odometry.json`.
[[nodiscard]] datasets::RecordingInfo recording_info(const datasets::DatasetInfo& dataset, const SessionRun& session,
                                                     const MapperOptions& options);

}  // namespace chainslam::mapper
