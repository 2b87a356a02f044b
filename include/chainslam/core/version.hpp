#pragma once

/// Version of the library: semantic versioning, and the single source that CMake reads.
#define CHAINSLAM_VERSION_MAJOR 0
#define CHAINSLAM_VERSION_MINOR 1
#define CHAINSLAM_VERSION_PATCH 0
