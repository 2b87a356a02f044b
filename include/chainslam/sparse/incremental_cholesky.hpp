#pragma once

// `IncrementalCholesky`: its class, how it brings factor and solution up to date, some fronts at the same time, how it
// takes changes back, and how it is saved.
#include "chainslam/sparse/detail/incremental_cholesky_archive.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_class.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_compute.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_rollback.hpp"
#include "chainslam/sparse/detail/incremental_cholesky_update.hpp"
