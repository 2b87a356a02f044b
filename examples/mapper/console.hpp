#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "options.hpp"
#include "results.hpp"
#include "support/summary.hpp"

namespace chainslam::mapper {

/// What verbs that run odometry say on the console.
/// @{

/// To the error stream, each after `mark`: "note:" or "warning:".
void print_notes(const char* mark, const std::vector<std::string>& notes);

/// The first lines and the last: whether the result is what was asked for, and where it is not to be trusted.
void print_verdict(const support::Verdict& verdict, OdometrySourceKind source);

/// What of the IMU odometry relied on, and what the scans say of its clock and axes.
void print_imu(const support::RunSummary& summary);

/// That a run ended since it needed more memory than it may have, to the error stream.
/// @param remedy  what to do.
void print_memory_error(std::uint64_t max_memory, const std::string& remedy);

/// Against the truth, if that is known.
void print_errors(const RunOutcome& outcome);
/// @}

}  // namespace chainslam::mapper
