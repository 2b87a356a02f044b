#pragma once

// `IncrementalCholesky`: its class, and how it brings factor and solution up to date.
#include "chainslam/sparse/detail/incremental_cholesky_class.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_update.hpp"
