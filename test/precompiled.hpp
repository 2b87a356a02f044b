#pragma once

#include <doctest/doctest.h>
#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <filesystem>
#include <string>
#include <vector>

#ifdef CHAINSLAM_TERSE_CHECKS
#include "support/terse_checks.hpp"
#endif
