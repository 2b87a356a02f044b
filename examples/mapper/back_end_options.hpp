#pragma once

#include "presets.hpp"
#include "support/configuration.hpp"

namespace chainslam::mapper {

/// Binds the keys of closures, chain, merge and graph to `parts`, which must outlive the configuration.
void add_back_end(support::Configuration& configuration, BackEndParts& parts);

}  // namespace chainslam::mapper
