#pragma once

// What nearly every verb includes, and what takes longest to read.
#include <nlohmann/json.hpp>

#include "../precompiled.hpp"
#include "options.hpp"
