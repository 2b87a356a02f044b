#pragma once

// `IncrementalGnc`: its class, and what it tries.
#include "chainslam/factor_graph/detail/incremental_gnc_class.hpp"
#include "chainslam/factor_graph/detail/incremental_gnc_trials.hpp"
