#pragma once

#include <filesystem>
#include <stop_token>

#include "support/interrupt.hpp"

namespace chainslam::mapper {

/// While it lives, Ctrl-C, SIGTERM and SIGHUP end the program at once with exit code 130, whatever it is doing: for
/// verbs whose result is either whole or of no use. What was begun of a file result is deleted; results that have their
/// name stay.
class EndOnInterrupt {
 public:
  /// @param result   what the verb writes, if anything.
  /// @param message  shown at the signal; must outlive all signals.
  explicit EndOnInterrupt(std::filesystem::path result = {}, const char* message = "\ninterrupted\n");

 private:
  struct End {
    std::filesystem::path result;
    void operator()() const;
  };
  support::Interrupt interrupt_;
  std::stop_callback<End> end_;
};

}  // namespace chainslam::mapper
