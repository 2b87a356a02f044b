#pragma once

#include <string>

#include "options.hpp"
#include "results.hpp"

namespace chainslam::mapper {

/// Fills `outcome.summary` from the rest of it, all but times and memory, and judges the goals.
void summarize(RunOutcome& outcome, const std::string& dataset, const Goals& goals);

}  // namespace chainslam::mapper
