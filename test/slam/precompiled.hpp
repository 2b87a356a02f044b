#pragma once

#include "../precompiled.hpp"

#include "chainslam/slam/back_end.hpp"
