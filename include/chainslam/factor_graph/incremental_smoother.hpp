#pragma once

// `IncrementalSmoother`: its class, what can be asked of it, and how it updates and converges.
#include "chainslam/factor_graph/detail/incremental_smoother_class.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_converge.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_queries.hpp"
#include "chainslam/factor_graph/detail/incremental_smoother_update.hpp"
