#pragma once

#include <memory>
#include <string_view>

#include "datasets/dataset.hpp"

namespace chainslam::mapper {

/// A session that is simulated while it is read, so that nothing is written: `simulate:PRESET/SIZE/SESSION[/SEED]`,
/// sessions counted from 1; for instance `simulate:nclt-like/medium/2`, or with `/errors=NAMES` and `/without=NAMES` at
/// its end (see `error_sources`), `simulate:nclt-hard/medium/2/without=wind`; or a semi-real drive, `simulate:FOLDER`
/// (see `open_recorded_simulation`).
/// @returns nothing if `name` does not begin with `simulate:`.
/// @throws support::ConfigError if it does, and names no session.
[[nodiscard]] std::unique_ptr<datasets::Dataset> open_simulation(std::string_view name);

}  // namespace chainslam::mapper
