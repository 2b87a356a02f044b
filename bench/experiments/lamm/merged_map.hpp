#pragma once

#include <string>
#include <vector>

#include "keyframe_sets.hpp"
#include "lamm.hpp"
#include "mapping_result.hpp"

namespace chainslam::lamm {

/// What LAMM made of sets, as a run of the mapper would have left it: its files are then written, and its errors taken,
/// by what writes those of `chainslam map`. Loops within a session are direct closures, those between two sessions are
/// merges, dropped ones are refusals.
[[nodiscard]] mapper::MappingResult mapping_result(std::vector<KeyframeSet> sets, const Result& result,
                                                   const ScanGraphOptions& graph);

/// Figures of LAMM alone, as JSON text.
[[nodiscard]] std::string lamm_json(const Result& result, const Options& options, bool as_released);

}  // namespace chainslam::lamm
