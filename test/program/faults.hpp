#pragma once

#include <filesystem>
#include <set>
#include <string>

#include "program/run_program.hpp"

namespace chainslam::test {

/// What makes the program fail at one operation on files: see faults/faults.cpp.
inline std::string with_fault(const std::string& fault, const fs::path& log = {}) {
  return "LD_PRELOAD=" CHAINSLAM_FAULTS " CHAINSLAM_FAULT='" + fault + "'" +
         (log.empty() ? "" : " CHAINSLAM_FAULT_LOG=" + quoted(log));
}

inline std::set<std::string> names_in(const fs::path& folder) {
  std::set<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder)) names.insert(entry.path().filename().string());
  return names;
}

/// Whether errors are what they should be: what and where, what was found, what to do.
inline bool three_lines(const std::string& errors) {
  return contains(errors, "error: ") && contains(errors, "\n  found: ") && contains(errors, "\n  do: ");
}

}  // namespace chainslam::test
