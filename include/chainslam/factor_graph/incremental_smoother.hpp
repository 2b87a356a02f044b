#pragma once

// `IncrementalSmoother`: its class, what can be asked of it, how it updates and converges, gives up variables, and is
// saved.
#include "chainslam/factor_graph/detail/incremental_smoother_archive.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_class.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_converge.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_marginalize.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_queries.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_update.hpp"
