#pragma once

namespace chainslam::support {

/// The report's style sheet and script. The script reads what `report_html` embeds: `meta` (JSON), `points`,
/// `point-sessions`, `paths` and `closures` (base64).
extern const char* const report_style;
extern const char* const report_script;

}  // namespace chainslam::support
