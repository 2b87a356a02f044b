#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <doctest/doctest.h>
#include <filesystem>
#include <string>
#include <vector>
